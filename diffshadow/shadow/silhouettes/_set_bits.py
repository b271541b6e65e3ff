"""A table of bits whose set ones can be counted off, however few they are."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, UInt32

_WIDTH = 32


class SetBits(eqx.Module):
    """Rows of bits for each of `n` columns, 32 of them to a word. Set ones are numbered column by column.

    - `words`: the lowest bit is that of the first row.
    - `start`: the number of each column's first, if it has one.
    - `count`: of all.
    """

    words: UInt32[Array, "w n"]
    start: Int[Array, " n"]
    count: Int[Array, ""]

    def __init__(self, words: UInt32[Array, "w n"]):
        self.words = words
        each = jnp.sum(lax.population_count(words), axis=0).astype(jnp.int32)
        self.start, self.count = jnp.cumsum(each) - each, jnp.sum(each)

    def locate(self, first: Int[Array, ""], size: int) -> tuple[Int[Array, " s"], Int[Array, " s"]]:
        """Row and column of the set bits with the numbers from `first` on, `size` of them, as far as they exist."""
        # A column's bits begin where its mark is: the marks up to a bit count the columns.
        marks = jnp.zeros(size + 1, jnp.int32).at[jnp.clip(self.start - first, 0, size)].add(1)
        column = jnp.cumsum(marks[:-1]) - 1
        left = first + jnp.arange(size, dtype=jnp.int32) - self.start[column]
        word, row, rank = jnp.zeros(size, jnp.uint32), jnp.zeros(size, jnp.int32), left
        for number, words in enumerate(self.words):
            own = words[column]
            held = lax.population_count(own).astype(jnp.int32)
            here = (left >= 0) & (left < held)
            word, row, rank = (
                jnp.where(here, own, word),
                jnp.where(here, _WIDTH * number, row),
                jnp.where(here, left, rank),
            )
            left = left - held
        half = _WIDTH // 2
        while half:
            low = lax.population_count(word & ((1 << half) - 1)).astype(jnp.int32)
            above = rank >= low
            word, row = jnp.where(above, word >> half, word), jnp.where(above, row + half, row)
            rank, half = jnp.where(above, rank - low, rank), half // 2
        return row, column


def empty_words(rows: int, columns: int) -> UInt32[Array, "w n"]:
    """Room for that many bits, and for a word more, none of them set."""
    return jnp.zeros((rows // _WIDTH + 2, columns), jnp.uint32)


def put_bits(words: UInt32[Array, "w n"], first: Int[Array, ""], bits: list[Bool[Array, " n"]]) -> UInt32[Array, "w n"]:
    """The words with these `bits` in rows from `first` on, where none are set yet."""
    for k in range(0, len(bits), _WIDTH):
        some: Any = sum(bit.astype(jnp.uint32) << i for i, bit in enumerate(bits[k : k + _WIDTH]))
        word, shift = (first + k) // _WIDTH, ((first + k) % _WIDTH).astype(jnp.uint32)
        # In two shifts: one by the whole width would be undefined.
        words = words.at[word].add(some << shift).at[word + 1].add(some >> (_WIDTH - 1 - shift) >> 1)
    return words
