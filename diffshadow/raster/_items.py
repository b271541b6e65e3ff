"""Consecutively numbered items of several owners, for loops whose length is known only at run time."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Int

from .._arithmetic import sums_up_to, take
from .._device import is_on_gpu

# Up to this number of owners per item, a CPU marks the end of each owner's items faster than it searches.
_MAX_MARKS = 8


class Items(NamedTuple):
    """Items of owners: first all of the first owner, then all of the second, and so on.

    - `lengths`: (n,), the number of items of each owner.
    - `ends`: (n,), the inclusive prefix sum of `lengths`.
    """

    lengths: Int[Array, " n"]
    ends: Int[Array, " n"]

    @classmethod
    def of(cls, lengths: Int[Array, " n"], dtype: DTypeLike = jnp.int32) -> "Items":
        """The items of owners with these `lengths`. `dtype` is the type of the items' numbers."""
        return cls(lengths, sums_up_to(lengths, dtype))

    @property
    def total(self) -> Int[Array, ""]:
        """The total number of items."""
        return self.ends[-1]

    def chunk(
        self, first: Int[Array, ""] | int, length: int
    ) -> tuple[Int[Array, " length"], Int[Array, " length"], Bool[Array, " length"]]:
        """The `length` items from number `first`: the owner of each item, its index among the owner's items, and
        whether the item exists. If it does not exist, the index is meaningless, and the owner is a valid but arbitrary
        one."""
        item = first + jnp.arange(length, dtype=self.ends.dtype)
        exists = item < self.total
        if is_on_gpu():
            # Beyond the last item, starts again with the first items. Otherwise all of these would update the same
            # addresses.
            item = item % jnp.maximum(self.total, 1)
        # Without the barrier, XLA searches again for each value that is looked up.
        owner = lax.optimization_barrier(jnp.minimum(self._ended(item), self.ends.shape[0] - 1))
        return owner, item - take(self.ends - self.lengths, owner), exists

    def _ended(self, item: Int[Array, " length"]) -> Int[Array, " length"]:
        """The number of ends at or before each item, which is the index of its owner. On a CPU, the items are
        consecutive."""
        if is_on_gpu():
            # GPUs are slow to start loops. On CPUs, an unrolled search takes longer to compile.
            return jnp.searchsorted(self.ends, item, side="right", method="scan_unrolled").astype(jnp.int32)
        count = item.shape[0]
        if self.ends.shape[0] > _MAX_MARKS * count:
            return jnp.searchsorted(self.ends, item, side="right").astype(jnp.int32)
        marks = jnp.zeros(count + 1, jnp.int32).at[jnp.clip(self.ends - item[0], 0, count)].add(1)
        return sums_up_to(marks[:-1])
