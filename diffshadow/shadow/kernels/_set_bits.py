"""A table of bits that can enumerate its set bits in time proportional to their number."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, UInt32

from ...raster import Items

WIDTH = 32
"""Bits in a word."""


class SetBits(eqx.Module):
    """A table of bits with `n` columns, which stores 32 rows in each word. Set bits are numbered column by column.

    - `words`: the lowest bit belongs to the first row.
    - `columns`: the set bits as items of columns.
    """

    words: UInt32[Array, "w n"]
    columns: Items

    def __init__(self, words: UInt32[Array, "w n"]):
        self.words = words
        self.columns = Items.of(jnp.sum(lax.population_count(words), axis=0).astype(jnp.int32))

    @property
    def count(self) -> Int[Array, ""]:
        """Number of set bits."""
        return self.columns.total

    @classmethod
    def of(cls, bits: Bool[Array, " m"]) -> "SetBits":
        """Packs one row of `bits` into columns of `WIDTH` bits."""
        columns = jnp.pad(bits, (0, -bits.size % WIDTH)).reshape(-1, WIDTH)
        return cls(jnp.sum(columns << jnp.arange(WIDTH, dtype=jnp.uint32), axis=1, dtype=jnp.uint32)[None])

    def locate(self, first: Int[Array, ""], size: int) -> tuple[Int[Array, " s"], Int[Array, " s"], Bool[Array, " s"]]:
        """Row and column of the `size` set bits from number `first`, and whether they exist."""
        column, left, exists = self.columns.chunk(first, size)
        word, row, rank = jnp.zeros(size, jnp.uint32), jnp.zeros(size, jnp.int32), left
        for number, words in enumerate(self.words):
            own = words[column]
            bits = lax.population_count(own).astype(jnp.int32)
            here = (left >= 0) & (left < bits)
            word, row, rank = (
                jnp.where(here, own, word),
                jnp.where(here, WIDTH * number, row),
                jnp.where(here, left, rank),
            )
            left = left - bits
        half = WIDTH // 2
        while half:
            low = lax.population_count(word & ((1 << half) - 1)).astype(jnp.int32)
            above = rank >= low
            word, row = jnp.where(above, word >> half, word), jnp.where(above, row + half, row)
            rank, half = jnp.where(above, rank - low, rank), half // 2
        return row, column, exists


def empty_words(rows: int, columns: int) -> UInt32[Array, "w n"]:
    """Words for this many rows and columns, plus one word per column; no bit is set."""
    return jnp.zeros((rows // WIDTH + 2, columns), jnp.uint32)


def put_bits(words: UInt32[Array, "w n"], first: Int[Array, ""], bits: list[Bool[Array, " n"]]) -> UInt32[Array, "w n"]:
    """Sets `bits` in the rows from `first`, which must all be unset."""
    for k in range(0, len(bits), WIDTH):
        some: Any = sum(bit.astype(jnp.uint32) << i for i, bit in enumerate(bits[k : k + WIDTH]))
        word, shift = (first + k) // WIDTH, ((first + k) % WIDTH).astype(jnp.uint32)
        # Two shifts, because a shift by the word's width is undefined.
        words = words.at[word].add(some << shift).at[word + 1].add(some >> (WIDTH - 1 - shift) >> 1)
    return words
