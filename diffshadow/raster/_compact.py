"""Groups elements by class."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int

from .._arithmetic import take
from .._device import is_on_gpu

# Elements are counted in runs of this length. The count of a class in a run then fits into 5 bits, and six counts fit
# into one integer.
_RUN = 16
_BITS = 5
_MAX_CLASSES = 6


class Ranks(NamedTuple):
    """`rank` (n,) is each element's index within its class; `counts` (c,) is the size of each class."""

    rank: Int[Array, " n"]
    counts: Int[Array, " c"]


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


def rank_in_class(classes: Int[Array, " n"], number: int) -> Ranks:
    """The rank of each element within its class, for classes 0 to `number - 1`, at most six.

    The order within a class is fixed, but differs from the elements' order. The rank of an element without a class is
    meaningless.

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
    through = jnp.cumsum(totals, axis=1, dtype=jnp.int32)
    before = lax.optimization_barrier(through - totals)
    rank = within + sum(jnp.where(runs == k, before[k], 0) for k in range(number))
    return Ranks(rank.reshape(-1)[:n], through[:, -1])


def group(classes: Int[Array, " n"], number: int) -> Groups:
    """The elements of each class from 0 to `number - 1`. Elements of class -1 are left out."""
    ranks = rank_in_class(classes, number)
    starts = sums_up_to(ranks.counts) - ranks.counts
    place = sum(jnp.where(classes == k, starts[k] + ranks.rank, 0) for k in range(number))
    # Elements without a class have no position.
    place = jnp.where(classes >= 0, place, classes.shape[0])
    indices = jnp.arange(classes.shape[0], dtype=jnp.int32)
    elements = jnp.zeros_like(indices).at[place].set(indices, mode="drop", wrap_negative_indices=False)
    return Groups(elements, starts, ranks.counts)


def sums_up_to(values: Int[Array, " c"]) -> Int[Array, " c"]:
    """The inclusive prefix sum. Equals `jnp.cumsum`, but takes one kernel instead of several for short arrays."""
    through = np.tri(values.shape[0], dtype=bool)
    return jnp.sum(jnp.where(through, values, 0), axis=1, dtype=jnp.int32)
