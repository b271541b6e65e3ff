"""How far triangles reach to the left and to the right between two heights."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._misc import safe_divide
from ._bins import Corners
from ._fixed import MOST_VIRTUAL, SUBPIXEL_BITS, SUBPIXELS, first_centre, last_centre

# A span is this much wider on both sides than it is found to be, in sub-pixels: more than what rounding can lose.
_SLACK = SUBPIXELS // 8


def extent(
    x: Sequence[Float[Array, " n"]], y: Sequence[Float[Array, " n"]], low: Float[Array, " n"], high: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """The least and the greatest x of triangles where y is from `low` to `high`: that of their edges there.

    Infinity and minus infinity where there are none.

    **Arguments:**

    - `x`, `y`: of the three corners, (n,) each.
    """
    left, right = jnp.full_like(low, jnp.inf), jnp.full_like(low, -jnp.inf)
    for k, following in enumerate((1, 2, 0)):
        meets = (jnp.minimum(y[k], y[following]) <= high) & (jnp.maximum(y[k], y[following]) >= low)
        inverse = safe_divide(jnp.ones_like(low), y[following] - y[k])
        for level in (low, high):
            at = x[k] + jnp.clip((level - y[k]) * inverse, 0, 1) * (x[following] - x[k])
            left, right = jnp.where(meets, jnp.minimum(left, at), left), jnp.where(meets, jnp.maximum(right, at), right)
    return left, right


def span(
    corners: Corners, bottom: Int[Array, " n"], top: Int[Array, " n"]
) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """The first and last column of pixels that triangles may cover in the rows from `bottom` to `top`.

    The last column is before the first where there are none.
    """
    x, y = ([at.astype(jnp.float32) for at in along] for along in (corners.x, corners.y))
    low, high = (((row << SUBPIXEL_BITS) + SUBPIXELS // 2).astype(jnp.float32) for row in (bottom, top))
    beyond = 2 * MOST_VIRTUAL * SUBPIXELS
    left, right = (jnp.clip(side, -beyond, beyond).astype(jnp.int32) for side in extent(x, y, low, high))
    return first_centre(left - _SLACK), last_centre(right + _SLACK)
