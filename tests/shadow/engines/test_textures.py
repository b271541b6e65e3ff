"""Textures of half floats, against NumPy's."""

import jax
import numpy as np
import pytest

from diffshadow.shadow.engines._textures import as_half

pytestmark = pytest.mark.optimized


def test_every_half_float_stays_and_what_lies_between_is_rounded_to_the_nearest():
    # From the least subnormal to infinity, with ties and what lies on either side of them.
    half = np.arange(0x7C01, dtype=np.uint16).view(np.float16).astype(np.float32)
    tie = (half[:-2] + half[1:-1]) / 2
    beside = np.concatenate([np.nextafter(tie, 0), np.nextafter(tie, np.float32(1e6))])
    # Of subnormal numbers, the engine drops the last bits before it rounds.
    beside = beside[beside >= 2.0**-14]
    dropped = tie[tie < 2.0**-14] + np.float32([[-(2.0**-36)], [2.0**-36]])
    x = np.concatenate([half, tie, beside, dropped.ravel(), [65519, 65520]])
    x = np.concatenate([x, -x]).astype(np.float32)
    with np.errstate(over="ignore"):
        expected = x.astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(jax.jit(as_half)(x), expected)


def test_what_lies_just_beyond_the_middle_of_two_subnormal_numbers_is_rounded_to_the_even_one():
    x = np.float32([516.50001, 517.50001, 517.4999, 516.4999]) * np.float32(2.0**-24)
    np.testing.assert_array_equal(np.asarray(jax.jit(as_half)(x)) * 2.0**24, [516, 518, 517, 516])


def test_the_derivative_is_that_of_the_exact_value():
    x = np.float32([1e-6, 0.1, 1.7, -300.0])
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.grad(as_half)))(x), np.ones(4))
