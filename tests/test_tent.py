"""Percentage-closer filtering with a tent, and Castaño's kernels: closed forms, weights, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import apply, lookups_at, map_of, problem, random_lookups, random_map, slopes_of_loss, technique

from diffshadow.shadow import Bilinear, Castano, HardCompare, Lookup, Nearest, SoftCompare, Tent

HARD, SOFT = HardCompare(), SoftCompare(2.0)
WEIGHTS = {3: (1, 2, 1), 5: (1, 3, 4, 3, 1), 7: (1, 5, 12, 16, 12, 5, 1)}
"""Of bilinear compares one texel apart, as Castaño gives them."""
HALF_PLANE = np.where(np.arange(32) < 16, 0.2, 1.0) * np.ones((12, 1))


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def tent_integral(u):
    """Of a tent from -1 to 1 with area 1, up to u."""
    u = np.clip(u, -1, 1)
    return np.where(u < 0, (1 + u) ** 2 / 2, 1 - (1 - u) ** 2 / 2)


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.5, 3.3])
@pytest.mark.parametrize("axis", [0, 1])
def test_tent_of_half_plane_is_the_tent_integral(radius, axis):
    x = np.linspace(8, 24, 321)
    depth, at = (HALF_PLANE, (x, 6.3)) if axis == 0 else (HALF_PLANE.T, (6.3, x))
    visibility = apply(Tent(radius), map_of(depth), lookups_at(*at), HARD)
    np.testing.assert_allclose(visibility[0], tent_integral((x - 16) / radius), atol=3e-6)


@pytest.mark.parametrize("size", WEIGHTS)
def test_castano_of_half_plane_is_a_staircase_of_ramps(size):
    """Each bilinear compare makes a ramp one texel wide."""
    x = np.linspace(8, 24, 321)
    visibility = apply(Castano(size), map_of(HALF_PLANE), lookups_at(x, 6.3), HARD)
    weights = np.array(WEIGHTS[size]) / sum(WEIGHTS[size])
    places = np.arange(size) - size // 2
    exact = sum(w * np.clip(x + o - 16 + 0.5, 0, 1) for w, o in zip(weights, places, strict=True))
    np.testing.assert_allclose(visibility[0], exact, atol=3e-6)
    # The penumbra is as many texels wide.
    inside = np.abs(x - 16) < size / 2 - 0.01
    np.testing.assert_array_equal((exact > 0) & (exact < 1), inside)


@pytest.mark.parametrize("compare", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("size", WEIGHTS)
def test_castanos_few_taps_are_the_weighted_sum_of_many(size, compare, rng):
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    expected, weights, reach = 0, WEIGHTS[size], size // 2
    for i in range(size):
        for j in range(size):
            moved = lookup.texel + jnp.array([i - reach, j - reach])
            one = Lookup(moved, lookup.depth, lookup.depth_per_texel, lookup.inside)
            expected = expected + weights[i] * weights[j] * apply(Bilinear(), shadow_map, one, compare)
    found = apply(Castano(size), shadow_map, lookup, compare)
    np.testing.assert_allclose(found, expected / sum(weights) ** 2, atol=3e-6)


@pytest.mark.parametrize("radius", [0.7, 1.0, 2.3])
def test_tent_weighs_each_texel_by_its_integral(radius, rng):
    """Of a map with one texel that shadows, both along an axis and across."""
    depth = np.ones((11, 11))
    depth[5, 5] = 0.2
    x, y = rng.uniform(2, 9, (2, 6, 7))
    found = apply(Tent(radius), map_of(depth), lookups_at(x, y), HARD)
    share = lambda p: tent_integral((6 - p) / radius) - tent_integral((5 - p) / radius)
    np.testing.assert_allclose(found, 1 - share(x) * share(y), atol=3e-6)
    assert np.ptp(found) > 0.1


@pytest.mark.parametrize("compare", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("radius", [0.0, 0.3, 1.0, 1.7, 3.0])
def test_tent_does_not_depend_on_the_largest_radius(radius, compare, rng):
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    tight = Tent(radius)(shadow_map, lookup, compare)
    np.testing.assert_allclose(apply(Tent(radius, 5.2), shadow_map, lookup, compare), tight, atol=3e-6)


def test_tent_of_radius_zero_is_the_nearest_tap(rng):
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    off_border = (jnp.abs(lookup.texel - jnp.round(lookup.texel)) > 2e-3).all(axis=-1)
    found, expected = (f(shadow_map, lookup, HARD) for f in (Tent(0.0), Nearest()))
    np.testing.assert_allclose(jnp.where(off_border, found, 0), jnp.where(off_border, expected, 0), atol=1e-6)


@pytest.mark.parametrize("kernel", [Tent(3.4), Castano(3), Castano(5), Castano(7)])
def test_constant_maps_give_the_compare_itself_even_far_away(kernel, rng):
    lookup = lookups_at(rng.uniform(6, 20, (7, 9)), rng.uniform(6, 20, (7, 9)), rng.uniform(0.4, 0.6, (7, 9)))
    shadow_map = map_of(np.full((26, 26), 0.5))
    expected = Nearest()(shadow_map, lookup, SOFT)
    np.testing.assert_allclose(apply(kernel, shadow_map, lookup, SOFT), expected, atol=3e-6)
    far = Lookup(lookup.texel * 1e6, lookup.depth, lookup.depth_per_texel, lookup.inside)
    np.testing.assert_allclose(apply(kernel, shadow_map, far, SOFT), 1, atol=3e-5)


@pytest.mark.parametrize(
    ("name", "kernel"), [("tent", lambda: Tent(1.0, 2.0)), ("castano", lambda: Castano(3))], ids=["tent", "castano"]
)
def test_gradient_of_the_loss_matches_central_differences(name, kernel):
    names, values = ("bias.constant", "bias.slope", "bias.normal_offset"), (0.9, 0.6, 0.4)
    if name == "tent":
        names, values = (*names, "filter.radius"), (*values, 1.7)
    with jax.enable_x64(True):
        known = problem(technique(kernel(), compare=SoftCompare(3.0)), "spot", image=32, texels=32)
        slopes, forward, backward = slopes_of_loss(known, names, values, np.full(len(names), 1e-5), reverse=True)
    assert (np.abs(slopes) > 1e-6).all()
    np.testing.assert_allclose(forward, slopes, rtol=0.01)
    np.testing.assert_allclose(forward, backward, rtol=1e-9)


@eqx.filter_jit
@eqx.filter_grad
def slopes_of_sum(arguments, shadow_map):
    lookup, radius, width = arguments
    kernels = (Tent(radius, 2.0), Castano(3))
    return sum(jnp.sum(kernel(shadow_map, lookup, SoftCompare(width))) for kernel in kernels)


def test_no_gradient_is_nan_or_infinite(rng):
    lookup, shadow_map = random_lookups(rng), random_map(rng)
    for scale in (0.0, 1.0, 1e9, 1e30):
        # Whole numbers of texels lie on the kinks of both filters.
        texel = jnp.round(lookup.texel) * scale
        moved = Lookup(texel, lookup.depth, lookup.depth_per_texel, lookup.inside)
        for radius in (0.0, 1.0, 1.7):
            found = slopes_of_sum((moved, jnp.float32(radius), jnp.float32(0.7)), shadow_map)
            assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(found))


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match=r"the tent's radius is -1.0 texels; expected 0 to max_radius = 1: give"):
        Tent(-1.0)
    with pytest.raises(ValueError, match=r"the tent's radius is 3.0 texels; expected 0 to max_radius = 2: give"):
        Tent(3.0, 2.0)
    kernel = Castano(3)
    # Where types are checked, as in these tests, the constructor does not get so far.
    object.__setattr__(kernel, "size", 4)
    with pytest.raises(ValueError, match=r"Castaño's kernel has size 4; expected 3, 5 or 7"):
        kernel.__check_init__()
