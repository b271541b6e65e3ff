"""Where line segments cross the lines of the pixel grid."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._misc import take


class Crossings(eqx.Module):
    """Places where segments cross grid lines, which are those on which one coordinate is a whole number.

    - `segment`: (n,), which segment; -1 where there is no crossing.
    - `axis`: (n,), 0 where it crosses a line on which x is whole, 1 where y is.
    - `line`: (n,), that whole number.
    """

    segment: Int[Array, " n"]
    axis: Int[Array, " n"]
    line: Int[Array, " n"]


def count_crossings(start: Float[Array, "s 2"], end: Float[Array, "s 2"], used: Bool[Array, " s"]) -> Int[Array, "s 2"]:
    """How many grid lines of either axis each segment crosses, from `start` to `end` in pixels; 0 if not `used`.

    A line through a segment's lower end is not crossed, and one through its upper end is: a chain of segments that
    turns on a line crosses it twice or not at all.
    """
    low, high = jnp.floor(jnp.minimum(start, end)), jnp.floor(jnp.maximum(start, end))
    return jnp.where(used[:, None], (high - low).astype(jnp.int32), 0)


def grid_crossings(
    start: Float[Array, "s 2"], end: Float[Array, "s 2"], counts: Int[Array, "s 2"], capacity: int
) -> Crossings:
    """All crossings of segments from `start` to `end`, in pixels.

    **Arguments:**

    - `counts`: (s, 2), by `count_crossings`.
    - `capacity`: the greatest number of crossings; further ones are left out.
    """
    each = counts.reshape(-1)
    last = jnp.cumsum(each, dtype=jnp.int32)
    number = jnp.arange(capacity, dtype=jnp.int32)
    owner = jnp.repeat(jnp.arange(each.shape[0], dtype=jnp.int32), each, total_repeat_length=capacity)
    segment, axis = owner // 2, owner % 2
    low = jnp.floor(jnp.minimum(start, end)).astype(jnp.int32).reshape(-1)
    line = take(low, owner) + 1 + number - take(last - each, owner)
    return Crossings(jnp.where(number < last[-1], segment, -1), axis, line)
