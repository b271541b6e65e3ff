"""The horizontal extent of triangles between two heights."""

import functools
from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._arithmetic import safe_divide
from ..settings.quantities import MAX_VIRTUAL
from ._bins import Corners
from ._fixed import SUBPIXEL_BITS, SUBPIXELS, first_centre, last_centre

# Spans are widened on both sides by this margin, in sub-pixels, which exceeds all rounding errors.
_SLACK = SUBPIXELS // 8


def extent(
    x: Sequence[Float[Array, " n"]], y: Sequence[Float[Array, " n"]], low: Float[Array, " n"], high: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """The minimum and maximum x of triangles for y from `low` to `high`, from the triangles' edges.

    Infinity and minus infinity if there is no such part.

    **Arguments:**

    - `x`, `y`: the coordinates of the three corners, (n,) each.
    """
    (x0, y0), (x1, y1) = ([jnp.stack([at[k] for k in ks]) for at in (x, y)] for ks in ((0, 1, 2), (1, 2, 0)))
    meets = (jnp.minimum(y0, y1) <= high) & (jnp.maximum(y0, y1) >= low)
    inverse = safe_divide(jnp.ones_like(y0), y1 - y0)
    of_edge = lambda values: values[:, None]
    along = jnp.clip((jnp.stack([low, high]) - of_edge(y0)) * of_edge(inverse), 0, 1)
    at = lax.optimization_barrier(of_edge(x0) + along * of_edge(x1 - x0))
    left, right = (jnp.where(of_edge(meets), at, beyond).reshape(6, -1) for beyond in (jnp.inf, -jnp.inf))
    # Written out, because each reduction is a separate kernel.
    return functools.reduce(jnp.minimum, left), functools.reduce(jnp.maximum, right)


def span(
    corners: Corners, bottom: Int[Array, " n"], top: Int[Array, " n"]
) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """The first and last column of pixels that triangles may cover in the rows from `bottom` to `top`.

    The last column is before the first if there are none.
    """
    x, y = ([at.astype(jnp.float32) for at in along] for along in (corners.x, corners.y))
    low, high = (((row << SUBPIXEL_BITS) + SUBPIXELS // 2).astype(jnp.float32) for row in (bottom, top))
    beyond = 2 * MAX_VIRTUAL * SUBPIXELS
    left, right = (jnp.clip(side, -beyond, beyond).astype(jnp.int32) for side in extent(x, y, low, high))
    return first_centre(left - _SLACK), last_centre(right + _SLACK)
