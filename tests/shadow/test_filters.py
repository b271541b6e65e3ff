"""Filters: what they become at special radii, how they weigh, and the random disk's pattern and early-out."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import apply, lookups_at, map_of, random_lookups, random_map

from diffshadow.shadow import (
    Bilinear,
    ExponentialVarianceShadowMap,
    FourTap,
    HardCompare,
    Lookup,
    MomentShadowMap,
    Nearest,
    Pattern,
    PercentageCloser,
    RandomDisk,
    SoftCompare,
    Tent,
    VarianceShadowMap,
    stratified,
)
from diffshadow.shadow.filters._pcf import _covered, _lower_edge, _width
from diffshadow.shadow.patterns import EARLY_SAMPLES, interleaved_gradient_noise

HARD, SOFT = HardCompare(), SoftCompare(2.0)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


REACH = 4.0
"""Of boxes, in texels."""
SETS = stratified((4, 4), 4)
SOFTLY = pytest.param(SOFT, id="soft")
# What compares is not the filter's business.
BOTH = [SOFTLY, pytest.param(HARD, id="hard", marks=pytest.mark.exhaustive)]


@pytest.mark.parametrize("compare", BOTH)
@pytest.mark.parametrize(
    "kernel",
    [
        pytest.param(FourTap(0.0), id="four", marks=pytest.mark.exhaustive),
        pytest.param(RandomDisk(0.0, SETS), id="disk"),
        pytest.param(RandomDisk(0.0, SETS, early_out=True), id="early", marks=pytest.mark.exhaustive),
    ],
)
def test_radius_zero_is_one_bilinear_tap(kernel, compare, rng):
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    expected = apply(Bilinear(), shadow_map, lookup, compare)
    np.testing.assert_allclose(apply(kernel, shadow_map, lookup, compare), expected, atol=1e-6)


def test_nearest_disk_and_box_of_radius_zero_are_one_nearest_tap(rng):
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    expected = np.asarray(apply(Nearest(), shadow_map, lookup, SOFT))
    disk = apply(RandomDisk(0.0, SETS, lookup="nearest"), shadow_map, lookup, SOFT)
    np.testing.assert_allclose(disk, expected, atol=1e-6)
    # The box is never narrower than a thousandth of a texel on each side: look-ups on a texel's border see both.
    box, texel = np.asarray(apply(PercentageCloser(0.0, REACH), shadow_map, lookup, SOFT)), np.asarray(lookup.texel)
    off_border = (np.abs(texel - np.round(texel)) > 2e-3).all(axis=-1)
    np.testing.assert_allclose(box[off_border], expected[off_border], atol=1e-3)


@pytest.mark.parametrize("compare", BOTH)
def test_box_of_half_a_texel_is_the_bilinear_compare(compare, rng):
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    expected = apply(Bilinear(), shadow_map, lookup, compare)
    np.testing.assert_allclose(apply(PercentageCloser(0.5, REACH), shadow_map, lookup, compare), expected, atol=3e-6)


def test_box_at_a_texels_centre_is_the_mean_of_five_by_five(rng):
    shadow_map = random_map(rng)
    row, column = np.meshgrid(np.arange(2, 9), np.arange(2, 12), indexing="ij")
    row, column = (np.resize(v, (9, 13)) for v in (row, column))
    stored = np.asarray(shadow_map.depth, np.float64)
    # Logistic, two texels of a depth of 0.05 wide; an empty texel is lit.
    lit = np.where(stored < 1, 1 / (1 + np.exp(-(stored - 0.5) / 0.05 / 2)), 1)
    expected = np.mean([lit[row + i, column + j] for i in range(-2, 3) for j in range(-2, 3)], axis=0)
    found = apply(PercentageCloser(2.5, REACH), shadow_map, lookups_at(column + 0.5, row + 0.5), SOFT)
    np.testing.assert_allclose(found, expected, atol=2e-6)


@jax.jit
def box_along_an_axis(position, radius):
    """The first texel of a box and where its lower edge lies in that; and shares of seven texels."""
    first, edge = _lower_edge(position, radius)
    return first, edge, [_covered(edge, radius, i).weight / _width(edge, radius) for i in range(7)]


@pytest.mark.parametrize("radius", [0.0, 0.2, 0.5, 1.3, 2.0, 3.0])
def test_weights_of_the_box_sum_to_one(radius, rng):
    radius = jnp.float32(max(radius, 1e-3))
    position = np.concatenate([rng.uniform(-1e3, 1e3, (4, 50)), np.full((4, 1), 1e9)], axis=1).astype(np.float32)
    first, edge, fractions = (np.asarray(x) for x in box_along_an_axis(position, radius))
    np.testing.assert_allclose(sum(fractions), 1, atol=3e-7)
    # The box lies round the position: its lower edge is a radius below.
    own = np.floor(position)
    below = ((first - own) + edge)[:, :-1]
    np.testing.assert_allclose(below, ((position - own) - np.asarray(radius))[:, :-1], atol=1e-4)


@pytest.mark.parametrize("width", [0.3, 3.0])
def test_constant_maps_give_the_compare_itself(width, rng):
    """Weights sum to 1, whatever the filter."""
    x, y, depth = rng.uniform(4.5, 9.5, (9, 13)), rng.uniform(4.5, 6.5, (9, 13)), rng.uniform(0.4, 0.6, (9, 13))
    lookup, compare, shadow_map = lookups_at(x, y, depth), SoftCompare(width), map_of(np.full((11, 14), 0.5))
    expected = 1 / (1 + np.exp(-(0.5 - depth) / 0.05 / width))
    disks = RandomDisk(4.0, SETS), RandomDisk(4.0, SETS, early_out=True)
    for kernel in (Nearest(), Bilinear(), FourTap(2.2), PercentageCloser(3.4, REACH), *disks):
        np.testing.assert_allclose(apply(kernel, shadow_map, lookup, compare), expected, atol=4e-6)


@pytest.mark.parametrize(("pattern", "samples"), [(8, (4, 8)), (3, (5, 2)), (1, (1, 1)), (4, (8, 8))])
def test_offset_table_is_stratified_and_runs_inwards(pattern, samples):
    angles, rings = samples
    table = np.asarray(jnp.moveaxis(stratified(samples, pattern, seed=3).offsets, 0, 2), np.float64)
    assert table.shape == (pattern, pattern, angles * rings, 2)
    v = (table**2).sum(axis=-1)
    u = np.arctan2(table[..., 1], table[..., 0]) / (2 * np.pi) % 1
    assert v.max() <= 1 + 1e-6
    ring, sector = np.floor(v * rings - 1e-6).clip(0), np.floor((u * angles + 1e-6) % angles)
    # Each stratum of each set holds one sample, and rings come in order from the rim.
    assert (ring == np.repeat(np.arange(rings)[::-1], angles)).mean() > 0.999
    cell = np.sort(ring * angles + sector, axis=-1)
    assert (cell == np.arange(angles * rings)).mean() > 0.99
    if pattern > 1:
        assert (table[0, 0] != table[0, 1]).any()


def test_offset_table_follows_from_its_seed():
    np.testing.assert_array_equal(stratified((4, 4), 4, 5).offsets, stratified((4, 4), 4, 5).offsets)
    assert (np.asarray(stratified((4, 4), 4, 5).offsets) != np.asarray(stratified((4, 4), 4, 6).offsets)).any()


@pytest.mark.parametrize(
    ("mode", "rotated"), [("bilinear", True), pytest.param("nearest", False, marks=pytest.mark.exhaustive)]
)
def test_early_out_is_the_mean_of_eight_taps_where_these_agree_and_of_all_elsewhere(mode, rotated, rng):
    # Patches of depth larger than the disk, so that many look-ups see no edge.
    shape, radius = (9, 13), 2.0
    depth = np.kron(rng.uniform(0.2, 0.8, (2, 2)), np.ones((8, 8)))
    shadow_map, (x, y) = map_of(depth), rng.uniform(0, 16, (2, *shape))
    pattern = Pattern(stratified((4, 3), 4).offsets, rotated)
    rows, columns = np.indices(shape) % 4
    angle = 2 * np.pi * np.asarray(interleaved_gradient_noise(shape), np.float64) * rotated
    cosine, sine = np.cos(angle), np.sin(angle)

    def tap(offset):
        dx, dy = offset[rows, columns, 0], offset[rows, columns, 1]
        places = x + radius * (cosine * dx - sine * dy), y + radius * (sine * dx + cosine * dy)
        return np.asarray(
            apply({"bilinear": Bilinear(), "nearest": Nearest()}[mode], shadow_map, lookups_at(*places), HARD)
        )

    taps = np.array([tap(offset) for offset in np.asarray(pattern.offsets, np.float64)])
    first = taps[:EARLY_SAMPLES].mean(axis=0)
    agree = (first < 1e-6) | (first > 1 - 1e-6)
    assert 0.15 < agree.mean() < 0.9
    early = RandomDisk(radius, pattern, mode, early_out=True)
    found = apply(early, shadow_map, lookups_at(x, y), HARD)
    np.testing.assert_allclose(found, np.where(agree, np.round(first), taps.mean(axis=0)), atol=1e-5)


def every_filter(shadow_map, lookup, radius, width):
    """By the programs of the tests above."""
    kernels = (Nearest(), Bilinear(), FourTap(radius), PercentageCloser(radius, REACH), RandomDisk(radius, SETS))
    kernels += (RandomDisk(radius, SETS, early_out=True), RandomDisk(radius, SETS, "nearest"))
    return np.stack([apply(kernel, shadow_map, lookup, SoftCompare(width)) for kernel in kernels])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    radius=st.floats(0, 4, width=32),
    width=st.floats(float(np.float32(0.01)), 10, width=32),
    scale=st.floats(float(np.float32(0.1)), 1e4, width=32),
    empty=st.floats(0, 1),
)
def test_visibility_stays_in_its_range(seed, radius, width, scale, empty):
    rng = np.random.default_rng(seed)
    lookup = random_lookups(rng)
    texel = jnp.asarray(np.asarray(lookup.texel) * np.float32(scale))
    lookup = Lookup(texel, lookup.depth, lookup.depth_per_texel, lookup.inside)
    found = np.asarray(every_filter(random_map(rng, empty=empty), lookup, jnp.float32(radius), jnp.float32(width)))
    assert (found >= 0).all()
    assert (found <= 1 + 3e-5).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: PercentageCloser(3.0, 2.0),
            r"radius is 3.0 and max_radius is 2.0; expected radius at most max_radius",
        ),
        (lambda: PercentageCloser(2.0, 500.0), r"max_radius is 500.0; expected a number at least 0 and at most 128"),
        (lambda: stratified((0, 4)), r"samples is 0; expected a whole number at least 1"),
        (lambda: stratified(pattern_size=0), r"pattern_size is 0; expected a whole number at least 1"),
    ],
)
def test_impossible_filters_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


SIZED = [PercentageCloser, MomentShadowMap, Tent, VarianceShadowMap, ExponentialVarianceShadowMap]


def test_a_radius_that_is_traced_reaches_eight_texels_and_no_further():
    """As with `max_radius=8`: a filter made within `jax.jit` or `jax.grad` takes memory for so many."""
    most = []

    @eqx.filter_jit
    def radii(radius, kind):
        made = kind(radius)
        most.append(made.max_radius)
        return made.radius

    for kind in SIZED:
        assert float(radii(jnp.float32(8), kind)) == 8
        with pytest.raises(RuntimeError, match=rf"{kind.__name__}.radius is above 8 texels.*pass max_radius="):
            jax.block_until_ready(radii(jnp.float32(8.1), kind))
    assert most == [8.0] * len(SIZED)
