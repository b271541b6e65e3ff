"""Groups elements by class."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from .._arithmetic import sums_up_to, take
from .._device import is_on_gpu

# Elements are counted in runs of this length. The count of a class in a run then fits into 5 bits, and six counts fit
# into one integer.
_RUN = 16
_BITS = 5
_MAX_CLASSES = 6


class Groups(NamedTuple):
    """`elements` (n,) are indices ordered by class. `starts` (c,) has the position of each class's first element, and
    `counts` (c,) the sizes."""

    elements: Int[Array, " n"]
    starts: Int[Array, " c"]
    counts: Int[Array, " c"]

    def chunk(
        self, of_class: int | Array, number: Array, length: int
    ) -> tuple[Int[Array, " length"], Bool[Array, " length"]]:
        """The elements of chunk `number` of a class, and a mask of valid entries. The last chunk is padded."""
        rank = number * length + jnp.arange(length, dtype=jnp.int32)
        used = rank < self.counts[of_class]
        return take(self.elements, jnp.where(used, self.starts[of_class] + rank, 0)), used


def group(classes: Int[Array, " n"], number: int) -> Groups:
    """The elements of each class, for classes 0 to `number - 1`, at most six. Elements of class -1 are left out.

    The order within a class is fixed, but differs from the elements' order.

    A prefix sum over all elements for each class would take most of a frame. Here one prefix sum over short runs serves
    all classes. Runs are laid out across memory so that it vectorizes, and only the runs' totals are summed further.
    """
    assert number <= _MAX_CLASSES
    n = classes.shape[0]
    runs = jnp.pad(classes, (0, -n % _RUN), constant_values=-1).reshape(_RUN, -1)

    def count(packed: Array, own: Array) -> tuple[Array, Array]:
        shift = jnp.maximum(own, 0) * _BITS
        return packed + jnp.where(own >= 0, 1 << shift, 0), packed >> shift & (1 << _BITS) - 1

    packed, within = lax.scan(count, jnp.zeros_like(runs[0]), runs, unroll=is_on_gpu())
    totals = packed >> jnp.arange(number, dtype=jnp.int32)[:, None] * _BITS & (1 << _BITS) - 1
    # Over all runs of the first class, then over all of the second, and so on.
    through = sums_up_to(totals.reshape(-1)).reshape(totals.shape)
    before = lax.optimization_barrier(through - totals)
    place = within + sum(jnp.where(runs == k, before[k], 0) for k in range(number))
    # Elements without a class have no place.
    place = jnp.where(runs >= 0, place, n).reshape(-1)[:n]
    indices = jnp.arange(n, dtype=jnp.int32)
    elements = jnp.zeros_like(indices).at[place].set(indices, mode="drop", wrap_negative_indices=False)
    return Groups(elements, before[:, 0], through[:, -1] - before[:, 0])
