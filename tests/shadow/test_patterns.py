"""Sampling patterns: where their points lie, and how fast the mean over them converges to the disk's integral."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import apply, lookups_at, map_of
from scipy.spatial.distance import pdist

from diffshadow.shadow import (
    HardCompare,
    Pattern,
    RandomDisk,
    halton,
    poisson_disk,
    sobol,
    stratified,
    uniform,
    vogel,
)
from diffshadow.shadow.patterns import EARLY_SAMPLES, _owen_scrambled, interleaved_gradient_noise, to_disk

MAKERS = {f.__name__: f for f in (uniform, stratified, poisson_disk, vogel, sobol, halton)}
COUNTS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)


def sets_of(pattern):
    """Every pixel's set, (p², n, 2), in float64."""
    offsets = np.asarray(pattern.offsets, np.float64)
    return np.moveaxis(offsets.reshape(pattern.samples, -1, 2), 0, 1)


@pytest.mark.parametrize("samples", [1, 2, 4, 7, 31, 32, 100, 1023, 1024])
@pytest.mark.parametrize("name", MAKERS)
def test_any_number_of_samples_lies_in_the_disk_and_fills_it(name, samples):
    pattern = MAKERS[name](samples, 4, seed=1)
    assert pattern.offsets.shape == (samples, 4, 4, 2)
    points = sets_of(pattern)
    squared = (points**2).sum(axis=-1)
    assert squared.max() <= 1 + 1e-6
    # Squared radii are uniform over [0, 1]: independent ones err by 0.29 / √n, and five standard errors are allowed.
    assert abs(squared.mean() - 0.5) < 5 * 0.29 / np.sqrt(squared.size)
    # Each coordinate has a variance of 1/4. Vogel's spirals of a few points are one set, turned.
    spread = 0.5 / np.sqrt(squared.size if name != "vogel" else 16)
    assert (np.abs(points.mean(axis=(0, 1))) < 5 * spread).all()


@pytest.mark.parametrize("name", MAKERS)
def test_pattern_follows_from_its_seed_and_differs_between_pixels(name):
    make = MAKERS[name]
    first = np.asarray(make(12, 3, seed=5).offsets)
    np.testing.assert_array_equal(first, make(12, 3, seed=5).offsets)
    assert (first != np.asarray(make(12, 3, seed=6).offsets)).any()
    sets = np.moveaxis(first.reshape(12, 9, 2), 1, 0)
    assert len(np.unique(sets.reshape(9, -1).round(5), axis=0)) == 9


@pytest.mark.parametrize("name", MAKERS)
def test_rotation_is_a_matter_of_choice(name):
    assert MAKERS[name](8, 2, rotated=True).rotated
    assert MAKERS[name](8, 2).rotated == (name == "vogel")


@pytest.mark.parametrize("samples", [32, 1024])
@pytest.mark.parametrize("name", MAKERS)
def test_first_samples_lie_far_out_and_all_round(name, samples):
    """So that where they agree, an edge through the disk is unlikely."""
    first = sets_of(MAKERS[name](samples, 4, seed=2))[:, :EARLY_SAMPLES]
    radius, angle = np.hypot(*np.moveaxis(first, -1, 0)), np.arctan2(first[..., 1], first[..., 0])
    # A half-plane that cuts off less than a third of the circle may slip through, but not one that cuts off more.
    gaps = np.diff(np.sort(angle, axis=-1), axis=-1, append=np.sort(angle, axis=-1)[:, :1] + 2 * np.pi)
    assert gaps.max() < np.pi
    # The outermost of 4 points in an eighth of the disk lies at 0.89 on average.
    assert radius.mean() > 0.84


def half_plane(points, rng, count):
    """The lit share of each set, (s, n, 2), and of the disk, for `count` half-planes at random a set."""
    angle, distance = rng.uniform(0, 2 * np.pi, (count, 1)), rng.uniform(-0.9, 0.9, (count, 1))
    along = points[:, None, :, 0] * np.cos(angle) + points[:, None, :, 1] * np.sin(angle)
    exact = 0.5 + (distance * np.sqrt(1 - distance**2) + np.arcsin(distance)) / np.pi
    return (along < distance).mean(axis=-1), exact[:, 0]


def small_disk(points, rng, count):
    """As `half_plane`, of a disk of radius 0.6 that lies within."""
    angle, distance = rng.uniform(0, 2 * np.pi, (count, 1)), 0.4 * np.sqrt(rng.uniform(0, 1, (count, 1)))
    x, y = distance * np.cos(angle), distance * np.sin(angle)
    aside = np.hypot(points[:, None, :, 0] - x, points[:, None, :, 1] - y)
    return (aside > 0.6).mean(axis=-1), np.full(count, 1 - 0.36)


OCCLUDERS = {"half_plane": half_plane, "disk": small_disk}


def errors(name, occluder):
    """The root mean square error of each of `COUNTS`, over 256 sets and 16 occluders each."""
    found = []
    for samples in COUNTS:
        rng = np.random.default_rng(samples)
        lit, exact = OCCLUDERS[occluder](sets_of(MAKERS[name](samples, 16, seed=samples)), rng, 16)
        found.append(np.sqrt(np.mean((lit - exact) ** 2)))
    return np.array(found)


def slope(found, counts=COUNTS):
    return np.polyfit(np.log(counts), np.log(found), 1)[0]


@pytest.mark.parametrize("occluder", OCCLUDERS)
def test_monte_carlo_converges_as_the_root_of_samples(occluder):
    found = errors("uniform", occluder)
    # 4096 errors a count, of which sets share 16: 2.5 % each at the most, hence 0.005 of the slope over 8 octaves.
    assert slope(found) == pytest.approx(-0.5, abs=0.02)
    if occluder == "disk":
        # A binomial's standard deviation.
        np.testing.assert_allclose(found, np.sqrt(0.36 * 0.64 / np.array(COUNTS)), rtol=0.1)


@pytest.mark.exhaustive
def test_filter_converges_to_the_disks_integral():
    """The filter itself, on a map fine enough that an edge between two texels is straight."""
    texels, radius = 512, 100.0
    depth = np.where(np.arange(texels) < texels // 2, 0.2, 0.8) * np.ones((texels, 1))
    rng = np.random.default_rng(3)
    distance = rng.uniform(-0.9, 0.9, (32, 32))
    lookup = lookups_at(texels / 2 + radius * distance, rng.uniform(200, 300, (32, 32)), 0.5)
    exact = 0.5 + (distance * np.sqrt(1 - distance**2) + np.arcsin(distance)) / np.pi
    counts = (4, 32, 256)
    slopes = {}
    for make in (uniform, stratified):
        found = []
        for samples in counts:
            disk = RandomDisk(radius, make(samples, 32), "nearest")
            found.append(np.sqrt(np.mean((np.asarray(apply(disk, map_of(depth), lookup, HardCompare())) - exact) ** 2)))
        slopes[make] = slope(found, counts)
    # 1024 independent errors a count: 2.2 % each, hence 0.008 of the slope.
    assert slopes[uniform] == pytest.approx(-0.5, abs=0.035)
    assert slopes[stratified] < -0.65


@pytest.mark.parametrize("samples", [2, 32, 500, 1024])
def test_poisson_disk_points_keep_their_distance(samples):
    nearest = [pdist(points).min() for points in sets_of(poisson_disk(samples, 4))]
    # Scaled by the disk that holds exactly n, which has more or fewer to a unit of area.
    assert min(nearest) > (1.1 if samples > 2 else 0.8) / np.sqrt(samples)


def test_vogel_is_the_golden_spiral():
    pattern = vogel(50)
    assert pattern.offsets.shape == (50, 1, 1, 2)
    (points,) = sets_of(pattern)
    order = np.argsort((points**2).sum(axis=-1))
    radius, angle = np.hypot(*points[order].T), np.arctan2(points[order, 1], points[order, 0])
    np.testing.assert_allclose(radius, np.sqrt((np.arange(50) + 0.5) / 50), atol=1e-6)
    turn = np.diff(angle) - 2.39996323
    np.testing.assert_allclose(turn - 2 * np.pi * np.round(turn / (2 * np.pi)), 0, atol=1e-5)


@pytest.mark.parametrize("samples", [16, 64, 1024])
def test_sobol_keeps_its_strata_when_scrambled(samples):
    """Every elementary interval of the square holds one point: polar mapping shows where each came from."""
    for points in sets_of(sobol(samples, 3, mapping="polar")):
        v, u = (points**2).sum(axis=-1), np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1
        for wide in 2 ** np.arange(int(np.log2(samples)) + 1):
            cell = np.floor(u * wide) * (samples // wide) + np.floor(v * (samples // wide))
            # float32 offsets lose a stratum by rounding now and then.
            assert len(np.unique(cell)) >= 0.99 * samples - 1


def test_owen_scrambling_permutes_each_digit_by_those_above_it():
    seed = np.random.default_rng(4).integers(1 << 32, size=(200, 1), dtype=np.uint32)
    x = np.array([0x12345678, 0x12345679, 0x1234ABCD, 0x92345678], np.uint32)
    y = _owen_scrambled(x, seed)
    top = lambda a, b: 32 - np.floor(np.log2((a ^ b).astype(np.float64)) + 1)
    for i, j in ((0, 1), (0, 2), (0, 3), (1, 2)):
        # The first digit that differs stays the first one.
        np.testing.assert_array_equal(top(y[:, i], y[:, j]), top(x[i], x[j]))
    # Each digit is 1 half of the time: 200 flips, five standard errors.
    ones = (y[:, :1] >> np.arange(32, dtype=np.uint32) & 1).mean(axis=0)
    assert (np.abs(ones - 0.5) < 5 * 0.5 / np.sqrt(200)).all()


@pytest.mark.parametrize("mapping", ["concentric", "polar"])
def test_mappings_to_the_disk_keep_areas(mapping):
    points = to_disk(np.random.default_rng(5).random((400_000, 2)), mapping)
    radius, angle = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    assert radius.max() < 1
    rings = np.histogram(radius**2, bins=10, range=(0, 1))[0] / len(points)
    sectors = np.histogram(angle, bins=12, range=(-np.pi, np.pi))[0] / len(points)
    # Five standard errors of a count of 40 000, and of 33 333.
    np.testing.assert_allclose(rings, 0.1, rtol=0.025)
    np.testing.assert_allclose(sectors, 1 / 12, rtol=0.028)


def test_concentric_mapping_keeps_neighbours_together():
    square = np.array([[0.5, 0.5], [1.0, 0.5], [0.5, 1.0], [0.0, 0.5], [0.5, 0.0], [1.0, 1.0]])
    half = np.sqrt(0.5)
    expected = [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1], [half, half]]
    np.testing.assert_allclose(to_disk(square, "concentric"), expected, atol=1e-12)
    rng = np.random.default_rng(0)
    a = rng.uniform(0.01, 0.99, (2000, 2))
    b = a + rng.uniform(-1e-3, 1e-3, a.shape)
    moved = np.linalg.norm(to_disk(a, "concentric") - to_disk(b, "concentric"), axis=-1)
    # Polar mapping tears the square apart along u = 0.
    assert (moved / np.linalg.norm(a - b, axis=-1)).max() < 4


def test_interleaved_gradient_noise_is_evenly_spread():
    noise = np.asarray(interleaved_gradient_noise((96, 96)))
    assert noise.min() >= 0
    assert noise.max() < 1
    windows = np.lib.stride_tricks.sliding_window_view(noise, (3, 3)).reshape(-1, 9)
    # Nine independent numbers would leave their mean a standard deviation of 0.096: at most half of that.
    assert windows.mean(axis=-1).std() < 0.048


def test_turned_pattern_is_each_pixels_own():
    pattern, shape = vogel(6), (5, 9)
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.2, 0.8, (20, 20))
    x, y = rng.uniform(5, 15, shape), rng.uniform(5, 15, shape)
    found = apply(RandomDisk(3.0, pattern), map_of(depth), lookups_at(x, y), HardCompare())
    angle = 2 * np.pi * np.asarray(interleaved_gradient_noise(shape), np.float64)
    expected = 0
    for dx, dy in sets_of(dataclasses.replace(pattern, rotated=False))[0]:
        moved = lookups_at(
            x + 3 * (np.cos(angle) * dx - np.sin(angle) * dy), y + 3 * (np.sin(angle) * dx + np.cos(angle) * dy)
        )
        alone = RandomDisk(0.0, Pattern(jnp.zeros((1, 1, 1, 2))))
        expected = expected + np.asarray(apply(alone, map_of(depth), moved, HardCompare())) / 6
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("name", MAKERS)
def test_empty_patterns_are_refused(name):
    with pytest.raises(ValueError, match="samples is 0; expected a whole number at least 1"):
        MAKERS[name](0, 8)
    with pytest.raises(ValueError, match="pattern_size is 0; expected a whole number at least 1"):
        MAKERS[name](4, 0)


def test_unknown_mapping_is_refused():
    # Where types are checked, as in these tests, the decorated function does not get so far.
    plain = getattr(to_disk, "__wrapped__", to_disk)
    with pytest.raises(ValueError, match="mapping to the disk is 'square'; expected concentric or polar"):
        plain(np.zeros((1, 2)), "square")


def test_pattern_of_another_shape_is_refused():
    pattern = vogel(4)
    object.__setattr__(pattern, "offsets", jnp.zeros((4, 2, 3, 2)))
    with pytest.raises(ValueError, match=r"offsets have shape \(4, 2, 3, 2\); expected \(n, p, p, 2\)"):
        pattern.__check_init__()
