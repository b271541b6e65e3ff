"""Counting off the set bits of a table: against NumPy's list of them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


@pytest.mark.exhaustive
@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1 << 30), st.sampled_from([4, 33]), st.sampled_from([0.0, 0.1, 0.9, 1.0]))
def test_set_bits_are_counted_off_column_by_column(seed, at_once, share):
    assert_located(np.random.default_rng(seed).random((70, 9)) < share, at_once, 250)


@pytest.mark.exhaustive
@pytest.mark.parametrize("at_once", [1, 6])
def test_any_number_of_rows_may_be_put_at_once(at_once):
    for share in (0.0, 0.1, 0.9, 1.0):
        assert_located(np.random.default_rng(at_once).random((70, 9)) < share, at_once, 250)


@pytest.mark.parametrize("row", [31, 32, 63])
def test_bits_at_the_ends_of_words_are_found(row):
    table = np.zeros((70, 9), bool)
    table[row, 1] = True
    assert_located(table, 33, 250)
