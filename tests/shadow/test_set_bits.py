"""Counting off the set bits of a table: against NumPy's list of them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.shadow.kernels._set_bits import SetBits, empty_words, put_bits


@functools.partial(jax.jit, static_argnames=("at_once", "size"))
def located(table, at_once, size):
    """How many bits of a table (rows, columns) are set, put there some rows at a time, and where all of them are, found
    `size` at a time."""
    words = empty_words(*table.shape)
    for first in range(0, len(table), at_once):
        words = put_bits(words, jnp.int32(first), list(table[first : first + at_once]))
    bits = SetBits(words)
    parts = [bits.locate(jnp.int32(first), size) for first in range(0, table.size, size)]
    return bits.count, parts


def assert_located(table, at_once, size):
    count, parts = located(table, at_once, size)
    column, row = np.nonzero(table.T)
    assert int(count) == len(row)
    assert sum(int(exists.sum()) for _, _, exists in parts) == len(row)
    for first, found in zip(range(0, len(row), size), parts, strict=False):
        for part, expected in zip(found, (row, column, np.ones(len(row), bool)), strict=True):
            np.testing.assert_array_equal(part[: len(row) - first], expected[first : first + size])


@pytest.mark.parametrize("row", [31, 32, 63])
def test_bits_at_the_ends_of_words_are_found(row):
    table = np.zeros((70, 9), bool)
    table[row, 1] = True
    assert_located(table, 33, 250)
