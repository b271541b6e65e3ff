"""Counting off the set bits of a table: against NumPy's list of them."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffshadow.shadow._set_bits import SetBits, empty_words, put_bits


def words_of(table, at_once):
    """The words of a table of bits (rows, columns), put into them some rows at a time."""
    words = empty_words(*table.shape)
    for first in range(0, len(table), at_once):
        words = put_bits(words, jnp.int32(first), [jnp.asarray(row) for row in table[first : first + at_once]])
    return words


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1 << 30), st.sampled_from([1, 4, 6, 33]), st.sampled_from([0.0, 0.1, 0.9, 1.0]))
def test_set_bits_are_counted_off_column_by_column(seed, at_once, share):
    table = np.random.default_rng(seed).random((70, 9)) < share
    bits = SetBits(words_of(table, at_once))
    column, row = np.nonzero(table.T)
    assert int(bits.count) == len(row)
    for first in range(0, len(row), 50):
        found = [np.asarray(part)[: len(row) - first] for part in bits.locate(jnp.int32(first), 50)]
        np.testing.assert_array_equal(found[0], row[first : first + 50])
        np.testing.assert_array_equal(found[1], column[first : first + 50])


@pytest.mark.parametrize("row", [31, 32, 63])
def test_bits_at_the_ends_of_words_are_found(row):
    table = np.zeros((64, 2), bool)
    table[row, 1] = True
    bits = SetBits(words_of(table, 7))
    assert [int(part[0]) for part in bits.locate(jnp.int32(0), 3)] == [row, 1]
