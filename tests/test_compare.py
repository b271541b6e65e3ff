"""Depth compares: their limits, their shape, and that nothing outside a map ever shadows."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import LIGHTS, apply, drawn, lookups_at, map_of

from diffshadow.raster import Surface
from diffshadow.shadow import (
    Bias,
    Bilinear,
    FourTap,
    HardCompare,
    Nearest,
    PercentageCloser,
    RandomDisk,
    SoftCompare,
    look_up,
    receiver,
    stratified,
)

KERNELS = ("logistic", "linear", "smoothstep", "gaussian", "exponential")
FILTERS = {
    "nearest": Nearest(),
    "bilinear": Bilinear(),
    "four_tap": FourTap(1.7),
    "pcf": PercentageCloser(2.3),
    "disk": RandomDisk(2.0, stratified((4, 4), 4)),
    "nearest_disk": RandomDisk(2.0, stratified((4, 4), 4), "nearest", early_out=True),
}
UNIT = 0.01
"""Window depth per texel in these tests."""


def compare_at(compare, t):
    """The compare where the stored depth lies `t` texels behind the receiver's."""
    t = jnp.asarray(t, jnp.float32)
    return np.asarray(compare(t * UNIT, jnp.zeros_like(t), jnp.full_like(t, UNIT)))


@pytest.mark.parametrize("kernel", KERNELS)
def test_soft_compare_becomes_hard_as_its_width_vanishes(kernel):
    t = np.concatenate([-np.geomspace(100, 1e-3, 50), np.geomspace(1e-3, 100, 50)])
    np.testing.assert_allclose(compare_at(SoftCompare(1e-5, kernel), t), compare_at(HardCompare(), t), atol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
def test_soft_compare_rises_from_dark_to_lit(kernel):
    t = np.linspace(-60, 60, 4001)
    value = compare_at(SoftCompare(1.5, kernel), t)
    assert (np.diff(value) >= -1e-7).all()
    assert value[0] < 1e-6
    assert value[-1] > 1 - 1e-6
    assert (value >= 0).all()
    assert (value <= 1).all()
    half = 1.0 if kernel == "exponential" else 0.5
    assert compare_at(SoftCompare(1.5, kernel), 0.0) == pytest.approx(half, abs=1e-6)


@pytest.mark.parametrize(
    ("kernel", "t", "value"),
    [
        ("logistic", 3.0, 1 / (1 + np.exp(-1.5))),
        ("linear", 1.0, 0.75),
        ("linear", -2.5, 0.0),
        ("smoothstep", 1.0, 0.84375),
        ("gaussian", 2.0, 0.8413447),
        ("exponential", -2.0, np.exp(-1)),
    ],
)
def test_soft_compare_of_width_two_is_its_formula(kernel, t, value):
    assert compare_at(SoftCompare(2.0, kernel), t) == pytest.approx(value, abs=2e-6)


def test_width_is_in_texels_of_depth():
    narrow, wide = (
        SoftCompare(1.0)(jnp.array([s]), jnp.zeros(1), jnp.array([u])) for s, u in ((0.02, 0.01), (0.2, 0.1))
    )
    assert float(narrow[0]) == pytest.approx(float(wide[0]), abs=1e-6)


def test_operators_differ_at_equality_alone():
    t = np.array([-1.0, 0.0, 1.0])
    assert compare_at(HardCompare("less_equal"), t).tolist() == [0, 1, 1]
    assert compare_at(HardCompare("less"), t).tolist() == [0, 0, 1]


def test_what_cannot_be_compared_is_refused():
    for width in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match=r"width is .*; expected more than 0 texels, or a HardCompare"):
            SoftCompare(width)
    # Where types are checked, as in these tests, the constructor does not get so far.
    hard, soft = HardCompare(), SoftCompare(1.0)
    object.__setattr__(hard, "operator", "greater")
    object.__setattr__(soft, "kernel", "box")
    with pytest.raises(ValueError, match=r"the comparison is 'greater'; expected \"less_equal\" or \"less\""):
        hard.__check_init__()
    with pytest.raises(ValueError, match=r"kernel is 'box'; expected one of logistic, linear, smoothstep"):
        soft.__check_init__()


COMPARES = [HardCompare(), SoftCompare(100.0), SoftCompare(100.0, "exponential")]


@pytest.mark.parametrize("name", FILTERS)
def test_border_is_lit_in_every_direction(name):
    dark = map_of(np.zeros((9, 12)))
    # Beyond the reach of every tap: on each side, at each corner, and very far away.
    far = np.array([0.0, 1e3, 1e9, 1e30])
    x = np.concatenate([-4 - far, [6.0], 16 + far])
    y = np.concatenate([-4 - far, [4.5], 13 + far])
    x, y = np.meshgrid(x, y)
    outside = ~((x == 6.0) & (y == 4.5))
    for compare in (HardCompare(), SoftCompare(100.0)):
        lit = np.asarray(apply(FILTERS[name], dark, lookups_at(x, y), compare))
        np.testing.assert_allclose(lit[outside], 1, atol=2e-6)
        assert (lit[~outside] < 0.5).all()


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("compare", COMPARES, ids=["hard", "logistic", "exponential"])
def test_empty_texels_never_darken(name, compare):
    rng = np.random.default_rng(0)
    lookup = lookups_at(rng.uniform(-3, 15, (8, 8)), rng.uniform(-3, 12, (8, 8)), rng.uniform(0, 1, (8, 8)))
    lit = apply(FILTERS[name], map_of(np.ones((9, 12))), lookup, compare)
    np.testing.assert_allclose(np.asarray(lit), 1, atol=2e-6)


def test_nearest_and_bilinear_look_at_the_border_where_they_should():
    dark = map_of(np.zeros((4, 4)))
    x = np.array([-0.51, -0.25, 0.0, 0.25, 0.5, 3.5, 3.75, 4.0, 4.25, 4.51])
    nearest = np.asarray(Nearest()(dark, lookups_at(x, 2.0), HardCompare()))[0]
    bilinear = np.asarray(Bilinear()(dark, lookups_at(x, 2.0), HardCompare()))[0]
    np.testing.assert_array_equal(nearest, [1, 1, 0, 0, 0, 0, 0, 1, 1, 1])
    np.testing.assert_allclose(bilinear, [1, 0.75, 0.5, 0.25, 0, 0, 0.25, 0.5, 0.75, 1], atol=1e-6)


def lookups_of(shadow_map, points):
    """Look-ups of `points` (1, n, 3), without bias."""
    mask = jnp.ones(points.shape[:2], bool)
    at = receiver(shadow_map, Surface(points, points, points, points, mask.astype(jnp.int32), mask))
    return look_up(shadow_map, at, Bias()(at))


def test_beyond_the_far_plane_and_behind_a_spot_light_is_outside():
    for name in LIGHTS:
        _, shadow_map = drawn(name, 64, 64)
        light = shadow_map.light
        view = light.view()
        back = np.asarray(view.world_to_eye[2, :3])
        start = np.asarray(light.position if name == "spot" else light.center)
        distances = np.array([float(view.far) * 1.01, float(view.far) * 0.99, -float(view.far)])
        points = jnp.asarray((start - distances[:, None] * back)[None], jnp.float32)
        inside = np.asarray(lookups_of(shadow_map, points).inside)[0]
        # Behind a directional light there is no "behind": what lies before its near plane is in front of everything.
        assert inside.tolist() == [False, True, name == "directional"]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6),
    st.floats(-1e-6, 1e-6),
    st.sampled_from(sorted(FILTERS)),
)
def test_points_beside_a_spot_light_are_lit_and_finite(sideways, ahead, name):
    """Where the perspective divide overflows."""
    _, shadow_map = drawn("spot", 64, 64)
    light = shadow_map.light
    rows = np.asarray(light.view().world_to_eye[:3, :3])
    offsets = np.array(sideways).reshape(3, 2) @ rows[:2] - ahead * rows[2]
    points = jnp.asarray((np.asarray(light.position) + offsets)[None], jnp.float32)
    lookup = lookups_of(shadow_map, points)
    assert np.isfinite(np.asarray(lookup.texel)).all()
    lit = jnp.where(lookup.inside, apply(FILTERS[name], shadow_map, lookup, HardCompare()), 1)
    np.testing.assert_allclose(np.asarray(lit), 1, atol=2e-6)
