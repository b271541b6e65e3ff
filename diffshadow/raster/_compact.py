"""Gathers the elements of each class."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

# Elements are counted in runs of this length, so that the count of a class in a run fits into 5 bits, and the counts of
# six classes into one integer.
_RUN = 16
_BITS = 5
_MOST_CLASSES = 6


class Ranks(NamedTuple):
    """`rank` (n,) is each element's index among those of its class; `counts` (c,) is the size of each class."""

    rank: Int[Array, " n"]
    counts: Int[Array, " c"]


def rank_in_class(classes: Int[Array, " n"], number: int) -> Ranks:
    """The rank of each element within its class, for classes 0 to `number - 1`, at most six.

    The order within a class is fixed, but differs from that of the elements. The rank of an element without a class is
    meaningless.

    A prefix sum over all elements for each class would take most of a frame. Here one prefix sum over short runs serves
    all classes. Runs are laid out across memory so that it vectorizes, and only the runs' totals are summed further.
    """
    assert number <= _MOST_CLASSES
    n = classes.shape[0]
    runs = jnp.pad(classes, (0, -n % _RUN), constant_values=-1).reshape(_RUN, -1)

    def count(packed: Array, own: Array) -> tuple[Array, Array]:
        shift = jnp.maximum(own, 0) * _BITS
        return packed + jnp.where(own >= 0, 1 << shift, 0), packed >> shift & (1 << _BITS) - 1

    packed, within = lax.scan(count, jnp.zeros_like(runs[0]), runs)
    totals = packed >> jnp.arange(number, dtype=jnp.int32)[:, None] * _BITS & (1 << _BITS) - 1
    through = jnp.cumsum(totals, axis=1, dtype=jnp.int32)
    before = lax.optimization_barrier(through - totals)
    rank = within + sum(jnp.where(runs == k, before[k], 0) for k in range(number))
    return Ranks(rank.reshape(-1)[:n], through[:, -1])


def members(classes: Int[Array, " n"], ranks: Ranks, capacities: Sequence[int]) -> Int[Array, " capacity"]:
    """Indices of the elements of class 0, then 1 and so on, each class padded with -1 to its capacity.

    Elements beyond their class's capacity are left out: check `ranks.counts`.
    """
    total = sum(capacities)
    place = jnp.full_like(ranks.rank, total)
    for k, capacity in enumerate(capacities):
        if not capacity:
            continue
        place = jnp.where((classes == k) & (ranks.rank < capacity), sum(capacities[:k]) + ranks.rank, place)
    indices = jnp.arange(classes.shape[0], dtype=jnp.int32)
    # Elements beyond the capacity go to an extra slot that is cut off, so that no index is out of bounds.
    found = jnp.full(total + 1, -1, jnp.int32).at[place].set(indices, mode="promise_in_bounds")
    return found[:total]


def compact(mask: Array, capacity: int) -> Int[Array, " capacity"]:
    """Indices where `mask` is true, padded with -1 to `capacity`; further ones are left out."""
    classes = jnp.where(mask, 0, -1)
    return members(classes, rank_in_class(classes, 1), (capacity,))
