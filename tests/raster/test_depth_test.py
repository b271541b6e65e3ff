"""Depth formats: fixed-point ones at every one of their steps, and what each resolves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.raster import DepthTest

pytestmark = pytest.mark.optimized

STEPS = {"unorm16": 2**16 - 1, "unorm24": 2**24 - 1}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", STEPS)
def test_decoded_depths_are_the_nearest_floats_and_encode_to_their_own_step(name):
    test, stored = DepthTest(name), np.arange(STEPS[name] + 1, dtype=np.float32)
    decoded, encoded = jax.jit(lambda u: (test.decode(u), test.encode(test.decode(u))))(stored)
    np.testing.assert_array_equal(decoded, (stored.astype(np.float64) / STEPS[name]).astype(np.float32))
    np.testing.assert_array_equal(encoded, stored)
    np.testing.assert_array_equal(test.encode(decoded), stored)


def test_depths_between_two_steps_are_rounded_to_the_nearer():
    test, step = DepthTest("unorm16"), 1 / STEPS["unorm16"]
    between = np.float32([1.25, 1.75, 100.4, 100.6]) * np.float32(step)
    np.testing.assert_array_equal(jax.jit(test.encode)(between), [1, 2, 100, 101])


def test_a_unit_of_polygon_offset_is_what_the_buffer_resolves():
    greatest = jnp.array([0.3, 0.5, 0.75, 1.0], jnp.float32)
    np.testing.assert_array_equal(DepthTest().resolution_at(greatest), np.spacing(np.asarray(greatest)))
    for name, steps in STEPS.items():
        np.testing.assert_array_equal(DepthTest(name).resolution_at(greatest), np.full(4, np.float32(2 / steps)))
