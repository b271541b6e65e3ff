"""Items that belong to owners, numbered through: what a loop goes over if its length is known only as it runs."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Int

from .._misc import take


class Items(NamedTuple):
    """Items of owners: first all of the first owner, then all of the second, and so on.

    - `lengths`: (n,), how many items each owner has.
    - `ends`: (n,), the number of items up to each owner and with it.
    """

    lengths: Int[Array, " n"]
    ends: Int[Array, " n"]

    @classmethod
    def of(cls, lengths: Int[Array, " n"], dtype: DTypeLike = jnp.int32) -> "Items":
        """Items of owners that have so many each; `dtype` is that of their numbers."""
        return cls(lengths, jnp.cumsum(lengths, dtype=dtype))

    @property
    def total(self) -> Int[Array, ""]:
        """How many items there are."""
        return self.ends[-1]

    def chunk(
        self, first: Int[Array, ""] | int, length: int
    ) -> tuple[Int[Array, " length"], Int[Array, " length"], Bool[Array, " length"]]:
        """Of the `length` items from number `first`: each one's owner, its place among those of its owner, and whether
        there is such an item. For one that there is not, owner and place mean nothing; the owner exists."""
        item = first + jnp.arange(length, dtype=self.ends.dtype)
        # GPUs are slow to start loops, and CPUs take longer to compile them unrolled.
        method = "scan" if jax.default_backend() == "cpu" else "scan_unrolled"
        found = jnp.searchsorted(self.ends, item, side="right", method=method).astype(jnp.int32)
        # The barrier keeps XLA from searching again for each value that is looked up.
        owner = lax.optimization_barrier(jnp.minimum(found, self.ends.shape[0] - 1))
        return owner, item - take(self.ends - self.lengths, owner), item < self.total
