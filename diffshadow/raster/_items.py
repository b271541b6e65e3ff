"""Items that belong to owners, numbered through: what a loop goes over if its length is known only as it runs."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Int

from .._arithmetic import sums_up_to, take
from .._device import is_on_gpu

# With no more owners than this to an item, a CPU takes less time to mark where each one's items end than to search.
_MAX_MARKS = 8


class Items(NamedTuple):
    """Items of owners: first all of the first owner, then all of the second, and so on.

    - `lengths`: (n,), how many items each owner has.
    - `ends`: (n,), the number of items up to each owner and with it.
    """

    lengths: Int[Array, " n"]
    ends: Int[Array, " n"]

    @classmethod
    def of(cls, lengths: Int[Array, " n"], dtype: DTypeLike = jnp.int32) -> "Items":
        """Items of owners that have so many each; `dtype` is the type of items' numbers."""
        return cls(lengths, sums_up_to(lengths, dtype))

    @property
    def total(self) -> Int[Array, ""]:
        """How many items there are."""
        return self.ends[-1]

    def chunk(
        self, first: Int[Array, ""] | int, length: int
    ) -> tuple[Int[Array, " length"], Int[Array, " length"], Bool[Array, " length"]]:
        """Of the `length` items from number `first`: each one's owner, its place among its owner's items, and whether
        there is such an item. If not, owner and place mean nothing; the owner exists."""
        item = first + jnp.arange(length, dtype=self.ends.dtype)
        exists = item < self.total
        if is_on_gpu():
            # Beyond the last item, the first ones again: otherwise all of these would update the same places.
            item = item % jnp.maximum(self.total, 1)
        # The barrier keeps XLA from searching again for each value that is looked up.
        owner = lax.optimization_barrier(jnp.minimum(self._ended(item), self.ends.shape[0] - 1))
        return owner, item - take(self.ends - self.lengths, owner), exists

    def _ended(self, item: Int[Array, " length"]) -> Int[Array, " length"]:
        """How many owners' items end at or before each of these: the number of its owner. On a CPU they follow one
        another."""
        if is_on_gpu():
            # GPUs are slow to start loops, and CPUs take longer to compile them unrolled.
            return jnp.searchsorted(self.ends, item, side="right", method="scan_unrolled").astype(jnp.int32)
        count = item.shape[0]
        if self.ends.shape[0] > _MAX_MARKS * count:
            return jnp.searchsorted(self.ends, item, side="right").astype(jnp.int32)
        marks = jnp.zeros(count + 1, jnp.int32).at[jnp.clip(self.ends - item[0], 0, count)].add(1)
        return sums_up_to(marks[:-1])
