"""The crossings of line segments with the lines of the pixel grid."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import take
from ._items import Items


class GridCrossings(eqx.Module):
    """Crossings of segments with grid lines, on which x or y is an integer.

    - `segment`: (n,), the index of the segment, or -1 for no crossing.
    - `axis`: (n,), 0 if x is an integer on the line, 1 if y is.
    - `line`: (n,), that integer.
    """

    segment: Int[Array, " n"]
    axis: Int[Array, " n"]
    line: Int[Array, " n"]


def count_crossings(start: Float[Array, "s 2"], end: Float[Array, "s 2"], used: Bool[Array, " s"]) -> Int[Array, "s 2"]:
    """The number of grid lines of each axis that each segment crosses, from `start` to `end` in pixels. 0 if not
    `used`.

    A line through a segment's lower end does not count, and a line through its upper end does. A chain of segments that
    turns back on a line therefore crosses it twice or not at all.
    """
    low, high = jnp.floor(jnp.minimum(start, end)), jnp.floor(jnp.maximum(start, end))
    return jnp.where(used[:, None], (high - low).astype(jnp.int32), 0)


def grid_crossings(
    start: Float[Array, "s 2"], end: Float[Array, "s 2"], counts: Int[Array, "s 2"], capacity: int
) -> GridCrossings:
    """All crossings of segments from `start` to `end`, in pixels.

    **Arguments:**

    - `counts`: (s, 2), from `count_crossings`.
    - `capacity`: the maximum number of crossings. Further crossings are left out.
    """
    each = counts.reshape(-1)
    owner, number, exists = Items.of(each).chunk(0, capacity)
    segment, axis = owner // 2, owner % 2
    low = jnp.floor(jnp.minimum(start, end)).astype(jnp.int32).reshape(-1)
    line = take(low, owner) + 1 + number
    return GridCrossings(jnp.where(exists, segment, -1), axis, line)
