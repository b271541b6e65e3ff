"""Percentage-closer filtering with a tent, Castaño's kernels and free ones: closed forms, weights, derivatives."""

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import apply, lookups_at, map_of, random_lookups, random_map

from diffshadow.shadow import Bilinear, Castano, HardCompare, Lookup, Nearest, Separable, SoftCompare, Tent

HARD, SOFT = HardCompare(), SoftCompare(2.0)
WEIGHTS = {3: (1, 2, 1), 5: (1, 3, 4, 3, 1), 7: (1, 5, 12, 16, 12, 5, 1)}
"""Of bilinear compares one texel apart, as Castaño gives them."""
MAP, SHAPE = (16, 16), (9, 13)
"""Of maps and of look-ups, so that each filter is compiled once for each compare."""
COUNT = 9 * 13
REACH = 4.0
HALF_PLANE = np.where(np.arange(16) < 8, 0.2, 1.0) * np.ones((16, 1))


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def tent_integral(u):
    """Of a tent from -1 to 1 with area 1, up to u."""
    u = np.clip(u, -1, 1)
    return np.where(u < 0, (1 + u) ** 2 / 2, 1 - (1 - u) ** 2 / 2)


def along(axis, values):
    """Look-ups (9, 13) at these positions along an axis of a map (16, 16), in its middle along the other."""
    positions = [np.resize(values, SHAPE), np.full(SHAPE, 8.3)]
    return lookups_at(*positions[:: 1 - 2 * axis])


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.5, 3.3])
@pytest.mark.parametrize("axis", [0, 1])
def test_tent_of_half_plane_is_the_tent_integral(radius, axis):
    x = np.linspace(4, 12, COUNT)
    visibility = apply(Tent(radius, REACH), map_of(HALF_PLANE if axis == 0 else HALF_PLANE.T), along(axis, x), HARD)
    np.testing.assert_allclose(np.ravel(visibility), tent_integral((x - 8) / radius), atol=3e-6)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("size", WEIGHTS)
def test_castano_of_half_plane_is_a_staircase_of_ramps(size, axis):
    """Each bilinear compare makes a ramp one texel wide."""
    x = np.linspace(4, 12, COUNT)
    visibility = apply(Castano(size), map_of(HALF_PLANE if axis == 0 else HALF_PLANE.T), along(axis, x), HARD)
    weights = np.array(WEIGHTS[size]) / sum(WEIGHTS[size])
    places = np.arange(size) - size // 2
    exact = sum(w * np.clip(x + o - 8 + 0.5, 0, 1) for w, o in zip(weights, places, strict=True))
    np.testing.assert_allclose(np.ravel(visibility), exact, atol=3e-6)
    # The penumbra is as many texels wide.
    inside = np.abs(x - 8) < size / 2 - 0.01
    np.testing.assert_array_equal((exact > 0) & (exact < 1), inside)


def test_separable_kernel_of_half_plane_is_a_staircase_with_its_weights():
    x = np.linspace(4, 12, COUNT)
    for axis in (0, 1):
        visibility = apply(
            Separable((0.5, 0.3)), map_of(HALF_PLANE if axis == 0 else HALF_PLANE.T), along(axis, x), HARD
        )
        weights = np.array([0.3, 0.5, 1, 0.5, 0.3]) / 2.6
        exact = sum(w * np.clip(x + o - 8 + 0.5, 0, 1) for w, o in zip(weights, range(-2, 3), strict=True))
        np.testing.assert_allclose(np.ravel(visibility), exact, atol=3e-6)


def test_castanos_kernels_are_separable_ones(rng):
    shadow_map, lookup = random_map(rng, MAP), random_lookups(rng, SHAPE, MAP)
    of = lambda kernel: apply(kernel, shadow_map, lookup, HARD)
    np.testing.assert_allclose(of(Separable((0.75, 0.25))), of(Castano(5)), atol=1e-6)


BOTH = [pytest.param(HARD, id="hard"), pytest.param(SOFT, id="soft", marks=pytest.mark.exhaustive)]


@pytest.mark.parametrize("compare", BOTH)
@pytest.mark.parametrize("size", WEIGHTS)
def test_castanos_few_taps_are_the_weighted_sum_of_many(size, compare, rng):
    shadow_map, lookup = random_map(rng, MAP), random_lookups(rng, SHAPE, MAP)
    expected, weights, reach = 0, WEIGHTS[size], size // 2
    for i in range(size):
        for j in range(size):
            moved = jnp.asarray(np.asarray(lookup.texel) + np.array([i - reach, j - reach], np.float32))
            one = Lookup(moved, lookup.depth, lookup.depth_per_texel, lookup.inside)
            expected = expected + weights[i] * weights[j] * np.asarray(apply(Bilinear(), shadow_map, one, compare))
    found = apply(Castano(size), shadow_map, lookup, compare)
    np.testing.assert_allclose(found, expected / sum(weights) ** 2, atol=3e-6)


@pytest.mark.parametrize("radius", [0.7, 1.0, 2.3])
def test_tent_weighs_each_texel_by_its_integral(radius, rng):
    """Of a map with one texel that shadows, both along an axis and across."""
    depth = np.ones(MAP)
    depth[5, 6] = 0.2
    x, y = rng.uniform(3.5, 10.5, SHAPE), rng.uniform(2.5, 9.5, SHAPE)
    found = apply(Tent(radius, REACH), map_of(depth), lookups_at(x, y), HARD)
    share = lambda p, low: tent_integral((low + 1 - p) / radius) - tent_integral((low - p) / radius)
    np.testing.assert_allclose(found, 1 - share(x, 6) * share(y, 5), atol=3e-6)
    assert np.ptp(found) > 0.1


def test_tent_of_radius_zero_is_the_nearest_tap(rng):
    shadow_map, lookup = random_map(rng, MAP), random_lookups(rng, SHAPE, MAP)
    texel = np.asarray(lookup.texel)
    off_border = (np.abs(texel - np.round(texel)) > 2e-3).all(axis=-1)
    found, expected = (np.asarray(apply(f, shadow_map, lookup, HARD)) for f in (Tent(0.0, REACH), Nearest()))
    np.testing.assert_allclose(found[off_border], expected[off_border], atol=1e-6)
