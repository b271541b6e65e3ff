"""A search structure for the points of a light's view.

It finds the points in a rectangle of the view. The n points, with x and y from 0 to 1, are sorted by y and cut into `s`
horizontal strips with equal numbers of points. Each strip is sorted by x and cut into `b` blocks of 16 points, where b
is about √n / 16. Padding and invalid points come last. Each strip stores its range of y, (s,), and each block its range
of x, (s·b,). All blocks except the last ones are full, even if points are spread unevenly. A grid would have empty and
overfull cells.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import take

BLOCK = 16
"""The number of points in a block."""
_INDEX_BITS = 31
_KEY_BITS = 31


class Strips(NamedTuple):
    """Points in strips of blocks: `s` strips of `b` blocks of `p` points.

    - `order`: (s·b, p), the index of each point among all n; n for padding.
    - `low`, `high`: (s,), the minimum and maximum y in each strip; infinity in strips without points.
    - `left`, `right`: (s·b,), the minimum and maximum x in each block; infinity in blocks without points.
    """

    order: Int[Array, "sb p"]
    low: Float[Array, " s"]
    high: Float[Array, " s"]
    left: Float[Array, " sb"]
    right: Float[Array, " sb"]

    @property
    def blocks(self) -> int:
        """The number of blocks in a strip."""
        return self.left.shape[0] // self.low.shape[0]

    def strips_between(self, low: Float[Array, " n"], high: Float[Array, " n"]) -> tuple[Array, Array]:
        """The first strip that may have points with y from `low` to `high`, and the number of such strips, (n,)
        each."""
        first = jnp.searchsorted(self.high, low, side="left").astype(jnp.int32)
        end = jnp.searchsorted(self.low, high, side="right").astype(jnp.int32)
        return first, jnp.where(low <= high, jnp.maximum(end - first, 0), 0)

    def blocks_between(
        self, strip: Int[Array, " n"], left: Float[Array, " n"], right: Float[Array, " n"]
    ) -> tuple[Array, Array]:
        """The first block of each `strip` (n,) that may have points with x from `left` to `right`, as an index among
        all blocks, and the number of such blocks in the strip, (n,) each."""
        begin = strip * self.blocks
        first = _count(lambda block: take(self.right, begin + block) < left, self.blocks)
        end = _count(lambda block: take(self.left, begin + block) <= right, self.blocks)
        return begin + first, jnp.where(left <= right, jnp.maximum(end - first, 0), 0)


def in_strips(x: Float[Array, " n"], y: Float[Array, " n"], valid: Bool[Array, " n"]) -> Strips:
    """The points at `x` and `y` (n,), both from 0 to 1, where `valid` (n,) is true. For use in 64-bit mode."""
    n = x.shape[0]
    blocks = max(1, round(math.sqrt(n) / BLOCK))
    strips = -(-n // (blocks * BLOCK))
    size = strips * blocks * BLOCK
    x, y = (jnp.pad(jnp.where(valid, at, jnp.inf), (0, size - n), constant_values=jnp.inf) for at in (x, y))
    order = _sorted(y, jnp.arange(size))
    order = _sorted(take(x, order).reshape(strips, -1), order.reshape(strips, -1))
    x, y = take(x, order).reshape(-1, BLOCK), take(y, order).reshape(strips, -1)

    def greatest(at: Float[Array, "k m"]) -> Float[Array, " k"]:
        """The maximum of each row's valid values, or infinity if there is none."""
        most = jnp.max(jnp.where(jnp.isinf(at), -jnp.inf, at), axis=1)
        return jnp.where(jnp.isinf(most), jnp.inf, most)

    order = jnp.minimum(order, n).astype(jnp.int32).reshape(-1, BLOCK)
    return Strips(order, jnp.min(y, axis=1), greatest(y), jnp.min(x, axis=1), greatest(x))


def _sorted(at: Float[Array, "*s n"], index: Int[Array, "*s n"]) -> Int[Array, "*s n"]:
    """`index` in the order of `at`, along the last axis."""
    # One integer for each point sorts three times as fast as a pair of a float and an index.
    steps = jnp.where(jnp.isfinite(at), jnp.clip(at, 0, 1) * (2**_KEY_BITS - 1), 2**_KEY_BITS).astype(jnp.int64)
    keys = lax.sort(steps << _INDEX_BITS | index, is_stable=False)
    return keys & (1 << _INDEX_BITS) - 1


def _count(holds: Callable[[Array | int], Array], most: int) -> Int[Array, " n"]:
    """The number of values from 0 to `most - 1` that satisfy `holds`, which is true up to some value and false beyond
    it."""
    low = jnp.zeros_like(holds(0), jnp.int32)

    def halve(_, bounds):
        low, high = bounds
        middle = jnp.minimum((low + high) // 2, most - 1)
        here = holds(middle) & (low < high)
        return jnp.where(here, middle + 1, low), jnp.where(here | (low >= high), high, middle)

    return lax.fori_loop(0, most.bit_length(), halve, (low, jnp.full_like(low, most)))[0]
