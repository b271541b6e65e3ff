"""Depth compares: their limits, their shape, and that nothing outside a map ever shadows."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import LIGHTS, apply, floor_and_card, lookups_at, map_of

from diffshadow.raster import Surface
from diffshadow.shadow import (
    Bias,
    Bilinear,
    FourTap,
    HardCompare,
    Nearest,
    PercentageCloser,
    RandomDisk,
    ShadowMap,
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
    t = np.asarray(t, np.float32)
    wide = jnp.asarray(np.resize(t, max(t.size, 128)))
    return np.asarray(compared(compare, wide))[: t.size].reshape(t.shape)


@eqx.filter_jit
def compared(compare, t):
    return compare(t * UNIT, jnp.zeros_like(t), jnp.full_like(t, UNIT))


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


HARD, SOFT, EXPONENTIAL = HardCompare(), SoftCompare(100.0), SoftCompare(100.0, "exponential")
# A filter does not care what compares, nor a compare for what filter it does.
USUAL = [(name, HARD) for name in FILTERS] + [("four_tap", SOFT), ("pcf", SOFT), ("nearest", EXPONENTIAL)]
PAIRS = [
    pytest.param(name, compare, id=f"{kind}-{name}", marks=[] if (name, compare) in USUAL else pytest.mark.exhaustive)
    for name in FILTERS
    for kind, compare in (("hard", HARD), ("logistic", SOFT), ("exponential", EXPONENTIAL))
]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "compare"), PAIRS)
def test_border_is_lit_in_every_direction(name, compare):
    dark = map_of(np.zeros((9, 12)))
    # Beyond the reach of every tap: on each side, at each corner, and very far away.
    far = np.array([0.0, 1e3, 1e9, 1e30])
    x = np.concatenate([-4 - far, [6.0], 16 + far])
    y = np.concatenate([-4 - far, [4.5], 13 + far])
    x, y = np.meshgrid(x, y)
    outside = ~((x == 6.0) & (y == 4.5))
    lit = np.asarray(apply(FILTERS[name], dark, lookups_at(x, y), compare))
    np.testing.assert_allclose(lit[outside], 1, atol=2e-6)
    assert (lit[~outside] < (1 if compare == EXPONENTIAL else 0.5)).all()


def test_nearest_and_bilinear_look_at_the_border_where_they_should():
    # Along both axes of a map that is not square, with as many look-ups as above.
    at = np.array([-0.51, -0.25, 0.0, 0.25, 0.5, 8.5, 8.75, 9.0, 9.25, 9.51, 11.5, 11.75, 12.0, 12.25, 12.51])
    x, y = (np.resize(np.concatenate(v), (9, 9)) for v in ((at, 0 * at + 2), (0 * at + 2, at)))
    size = np.where(np.arange(81) % 30 < 15, 12, 9).reshape(9, 9)
    along = np.where(size == 12, x, y)
    for kernel, exact in (
        (Nearest(), (along < 0) | (along >= size)),
        (Bilinear(), np.clip(np.maximum(0.5 - along, along + 0.5 - size), 0, 1)),
    ):
        lit = apply(kernel, map_of(np.zeros((9, 12))), lookups_at(x, y), HARD)
        np.testing.assert_allclose(lit, exact, atol=1e-6)


@eqx.filter_jit
def unbiased(shadow_map, points):
    mask = jnp.ones(points.shape[:2], bool)
    at = receiver(shadow_map, Surface(points, points, points, points, mask.astype(jnp.int32), mask))
    view = shadow_map.view
    return look_up(shadow_map, at, Bias()(at)), view.world_to_eye, view.near, view.far


@functools.cache
def map_under(name):
    return ShadowMap(jnp.zeros((9, 12)), LIGHTS[name](floor_and_card()))


def lookups_of(name, points):
    """Look-ups of `points` (n, 3) into a dark map, without bias."""
    wide = np.resize(np.asarray(points, np.float32), (9, 9, 3))
    return unbiased(map_under(name), jnp.asarray(wide))[0]


@functools.cache
def frame(name):
    """The matrix from world to eye space, and distances of the near and far planes."""
    return tuple(np.asarray(x) for x in unbiased(map_under(name), jnp.zeros((9, 9, 3)))[1:])


def test_beyond_the_far_plane_and_behind_a_spot_light_is_outside():
    for name in LIGHTS:
        light, (world_to_eye, _, far) = map_under(name).light, frame(name)
        start = np.asarray(light.position if name == "spot" else light.center)
        distances = np.array([far * 1.01, far * 0.99, -far])
        inside = lookups_of(name, start - distances[:, None] * world_to_eye[2, :3]).inside
        # Behind a directional light there is no "behind": what lies before its near plane is in front of everything.
        assert np.ravel(inside)[:3].tolist() == [False, True, name == "directional"]


@pytest.mark.exhaustive
@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-1e4, 1e4), min_size=6, max_size=6),
    st.floats(-1e-6, 1e-6),
    st.sampled_from(["bilinear", "pcf"]),
)
def test_points_beside_a_spot_light_are_lit_and_finite(sideways, ahead, name):
    """Where the perspective divide overflows."""
    rows = frame("spot")[0][:3, :3]
    offsets = np.array(sideways).reshape(3, 2) @ rows[:2] - ahead * rows[2]
    lookup = lookups_of("spot", np.asarray(map_under("spot").light.position) + offsets)
    assert np.isfinite(np.asarray(lookup.texel)).all()
    # Look-ups that follow no plane are as those made by hand.
    lit = np.where(lookup.inside, apply(FILTERS[name], map_under("spot"), lookup, HARD), 1)
    np.testing.assert_allclose(lit, 1, atol=2e-6)
