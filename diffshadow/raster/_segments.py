"""Edges of a mesh in the window of a view."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._types import Resolution
from ._grid_crossings import count_crossings


class Segments(eqx.Module):
    """Edges clipped to the window with a border of one pixel.

    - `start`, `end`: (n, 2), in pixels; `depth`: (n, 2), window depth at both.
    - `used`: (n,), whether a part of the edge lies in the window.
    - `counts`: (n, 2), the numbers of vertical and horizontal grid lines that each edge crosses.
    """

    start: Float[Array, "n 2"]
    end: Float[Array, "n 2"]
    depth: Float[Array, "n 2"]
    used: Bool[Array, " n"]
    counts: Int[Array, "n 2"]

    @classmethod
    def of(cls, ends: Float[Array, "n 2 4"], used: Bool[Array, " n"], resolution: Resolution) -> "Segments":
        """The segments between the `ends` of edges, in clip coordinates. Segments that are not `used` have no
        length."""
        first, last = _clip(lax.stop_gradient(ends), resolution)
        used = used & (first < last)
        edge = ends[:, 1] - ends[:, 0]
        height, width = resolution

        def place(fraction: Float[Array, " n"]) -> tuple[Float[Array, "n 2"], Float[Array, " n"]]:
            """The window positions of edges after this fraction of their length, and the window depth there."""
            # One coordinate at a time, because XLA is slow to add up such short axes in reverse mode.
            x, y, z, w = jnp.moveaxis(ends[:, 0] + fraction[:, None] * edge, -1, 0)
            x, y, z = (of_clip / jnp.where(used, w, 1) * 0.5 + 0.5 for of_clip in (x, y, z))
            return jnp.stack([x * width, y * height], axis=-1), z

        (start, nearest), (end, farthest) = place(first), place(last)
        counts = count_crossings(*lax.stop_gradient((start, end)), used)
        return cls(start, end, jnp.stack([nearest, farthest], axis=-1), used, counts)


def _clip(ends: Float[Array, "n 2 4"], resolution: Resolution) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Clips edges to the window with a border of one pixel (Liang & Barsky 1984). Returns the fractions of each edge at
    which the visible part starts and ends; the first is not less than the last if nothing is visible."""
    x, y, z, w = jnp.moveaxis(ends, -1, 0)
    x, y = x / (1 + 2 / resolution[1]), y / (1 + 2 / resolution[0])
    planes = jnp.stack([x, -x, y, -y, z, -z])
    a, b = jnp.moveaxis(w + planes, -1, 0)
    fraction = a / jnp.where(a == b, 1, a - b)
    first = jnp.max(jnp.where((a < 0) & (b > a), fraction, 0), axis=0)
    last = jnp.min(jnp.where((b < 0) & (a > b), fraction, 1), axis=0)
    return first, jnp.where(jnp.any((a < 0) & (b < 0), axis=0), 0, last)
