"""Perspective warps of shadow maps."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar


class Warp(eqx.Module):
    """A perspective along the y axis of a parallel view, which enlarges the lower end of its window (light space
    perspective shadow maps, Wimmer, Scherzer & Purgathofer 2004).

    Let τ in [0, 1] be the height of a point in the window without the warp, and w the strength. The point moves to the
    height `s = (1 + w) τ / (1 + w τ)`, and its distance to the line x = `center` is divided by `1 + w τ`. The lower
    border keeps its width, and `w = 0` changes nothing.

    - `strength`: w, 0 or more: the window's height divided by the distance from its lower border to the centre of
        projection, which lies below the window.
    - `center`: the clip coordinate x of the centre of projection.
    """

    strength: Scalar
    center: Scalar

    def __call__(self, clip: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
        """Warped clip coordinates.

        Window depth is divided by `1 + w τ`. Depths therefore keep their order at each texel, and planes stay planes.
        """
        # x and y move towards the point where all columns meet at infinity, and z towards the near plane.
        away = self.strength * (clip[..., 1] + clip[..., 3]) / 2
        one = jnp.ones_like(self.center)
        return clip + away[..., None] * jnp.stack([self.center, one, -one, one])

    def divisor(self, height: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """`1 + w τ` at `height` s in the window, which is clamped to [0, 1]."""
        return (1 + self.strength) / (1 + self.strength - self.strength * jnp.clip(height, 0, 1))

    def texel_extent(self, extent: Float[Array, "*n 2"], height: Float[Array, "*n"]) -> Float[Array, "*n 2"]:
        """Width and height of a texel at `height` s in the window, given its `extent` without the warp."""
        divisor = self.divisor(height)
        # ∂x'/∂x = 1 / (1 + w τ) and ds/dτ = (1 + w) / (1 + w τ)²
        return extent * jnp.stack([divisor, divisor * divisor / (1 + self.strength)], axis=-1)

    def lean(self, x: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The change of clip x without the warp per unit of clip y, along the column at warped clip `x`.

        Columns are lines through the centre of projection, `x - center = (x' - center) (1 + w τ)`.
        """
        return self.strength / 2 * (x - self.center)
