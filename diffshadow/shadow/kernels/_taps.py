"""Taps: look-ups in a shadow map at single points."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._types import Mask, Visibility
from ...settings.filters import TapMode
from .._compare import AbstractCompare
from .._lookup import Lookup, rearranged
from .._map import ShadowMap
from ..patterns import Pattern, interleaved_gradient_noise
from ._blocks import Blocks
from ._kernel import AbstractKernel, Footprint, Span
from ._padded_map import pad
from ._sum import sum_over

Radius = Float[Array, "..."] | tuple[Float[Array, "..."], Float[Array, "..."]]

# Half the width of a square that represents a point, in texels.
_POINT = 1 / 512


class Tap(AbstractKernel):
    """A tap at `radius · offset` from the look-up; a step is the offset (x, y).

    A nearest tap compares with the texel that contains it; the result has no derivative with respect to position. If
    the texel has a silhouette, the side of the tap counts. A bilinear tap compares with the four texels around it and
    interpolates the four results (never the depths).

    - `radius`: the radius in texels; or a pair, along the map's x and along its y.
    - `turn`: cosine and sine of the angle by which each look-up rotates its offsets; `None` for no rotation.
    """

    mode: TapMode = eqx.field(static=True)
    radius: Radius | float = 0.0
    turn: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None

    @property
    def radii(self) -> tuple[Any, Any]:
        """Along x and along y."""
        return self.radius if isinstance(self.radius, tuple) else (self.radius, self.radius)

    @property
    def cost(self) -> float:
        return 1.0

    def footprint(self, lookup: Lookup, step: tuple[Array, Array]) -> Footprint:
        x, y = step
        if self.turn is not None:
            cosine, sine = self.turn
            x, y = cosine * x - sine * y, sine * x + cosine * y
        radius_x, radius_y = self.radii
        x, y = radius_x * x, radius_y * y
        if self.mode == "bilinear" or lookup.slope is not None:
            # Without the barrier, some uses of the position round the product, and others fuse it with the sum below.
            x, y = lax.optimization_barrier(x), lax.optimization_barrier(y)
        x, y = lookup.x + x, lookup.y + y
        if self.mode == "nearest":
            column, row = jnp.floor(x), jnp.floor(y)
            at = lambda p: [Span(1.0, jnp.clip(p - _POINT, -0.5, 0.5), jnp.clip(p + _POINT, -0.5, 0.5))]
            return Footprint(column, row, at(x - column - 0.5), at(y - row - 0.5))
        u, v = x - 0.5, y - 0.5
        column, row = jnp.floor(u), jnp.floor(v)
        along = lambda t: [Span(1 - t, -0.5 + t, 0.5), Span(t, -0.5, t - 0.5)]
        return Footprint(column, row, along(u - column), along(v - row))

    def reach(self, lookup: Lookup, steps: Any) -> Float[Array, "..."]:
        x, y = steps
        farthest = jnp.sqrt(jnp.max(x * x + y * y))
        return jnp.maximum(*self.radii) * farthest + (0.5 if self.mode == "bilinear" else 0.0)


def single_tap(shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare, mode: TapMode) -> Visibility:
    """One compare for each look-up, with a `"nearest"` or a `"bilinear"` tap."""
    here = np.zeros(1, lookup.depth.dtype)
    return sum_over(Tap(mode), pad(shadow_map), compare, lookup, (here, here))


def mean_of_taps(
    shadow_map: ShadowMap,
    lookup: Lookup,
    compare: AbstractCompare,
    radius: Radius,
    pattern: Pattern,
    mode: TapMode,
    active: Mask | None = None,
) -> Visibility:
    """The mean of taps at `texel + radius · offset`.

    **Arguments:**

    - `radius`: the radius in texels, a scalar or one for each look-up; or a pair, along the map's x and along its y.
    - `pattern`: the offsets of each look-up, as the pixels of an image.
    - `mode`: `"nearest"` or `"bilinear"` taps. With nearest taps, `radius` and position have no gradient.
    - `active`: the look-ups whose mean is needed, (h, w); by default all. The mean of other look-ups is 0, and mostly
      skipped. Differentiable with respect to everything except `pattern`.
    """
    turn = None
    if pattern.rotated:
        angle = 2 * jnp.pi * interleaved_gradient_noise(lookup.depth.shape).astype(lookup.depth.dtype)
        turn = jnp.cos(angle), jnp.sin(angle)
    blocks = Blocks.of(lookup.depth.shape, pattern.offsets.shape[1])
    some = None if active is None else blocks.cut(active)
    kernel, cut = rearranged((Tap(mode, jax.tree.map(jnp.asarray, radius), turn), lookup), blocks.cut)
    total = sum_over(kernel, pad(shadow_map), compare, cut, _offsets(pattern, blocks), some)
    return blocks.join(total) / pattern.samples


def _offsets(pattern: Pattern, blocks: Blocks) -> tuple[Float[Array, "n p 1 q"], Float[Array, "n p 1 q"]]:
    """The pattern's offsets x and y for each pixel of a block."""
    offsets = lax.stop_gradient(pattern.offsets)
    wide = jnp.tile(offsets, (1, 1, blocks.columns // blocks.rows, 1))[:, :, None]
    # Without the barrier, each tap slices its offset out of the pattern, at every pixel.
    return lax.optimization_barrier((wide[..., 0], wide[..., 1]))
