"""Pre-filtered maps: bounds, light bleeding, blurs in closed form, derivatives."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import lookups_at, map_of, random_lookups
from scipy.stats import norm

from diffshadow.geometry import DirectionalLight, PointLight, SpotLight
from diffshadow.shadow import (
    ExponentialShadowMap,
    ExponentialVarianceShadowMap,
    HardCompare,
    Lookup,
    MomentShadowMap,
    ShadowMap,
    VarianceShadowMap,
)
from diffshadow.shadow.filters._prefilter import chebyshev, linear_depth
from diffshadow.shadow.kernels import Blur

HARD = HardCompare()
KINDS = {
    "variance": VarianceShadowMap,
    "exponential": ExponentialShadowMap,
    "exponential_variance": ExponentialVarianceShadowMap,
    "moments": MomentShadowMap,
}
BOUNDS = ("variance", "exponential_variance", "moments")
"""Those that are an upper bound of visibility for whatever lies in the map."""
SUN = DirectionalLight((0, -1, 0), (0, 0, 0), (1, 1), 0, 1)
"""Its window depth is linear depth."""


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@eqx.filter_jit
def seen(kernels, shadow_map, lookup):
    """The visibility by all of some filters at once."""
    return [kernel(shadow_map, lookup, HARD) for kernel in kernels]


def share_below(kernel, radius, u):
    """Share of a kernel of `radius` below u, by its formula."""
    u = np.clip(u / radius, -1, 1)
    if kernel == "box":
        return (1 + u) / 2
    if kernel == "tent":
        return np.where(u < 0, (1 + u) ** 2 / 2, 1 - (1 - u) ** 2 / 2)
    return (norm.cdf(3 * u) - norm.cdf(-3)) / (norm.cdf(3) - norm.cdf(-3))


def test_numbers_of_a_bound_are_those_of_its_formula():
    """Of maps that hold the one depth 0.5, whose variance is 0, at a receiver that lies 0.1 deeper."""
    stored, receiver = jnp.array([[0.5]]), jnp.array([[0.6]])
    by_formula = eqx.filter_jit(lambda filter, stored, depth: filter.bound(filter.moments(stored), depth))
    bound = lambda filter, depth=receiver: np.asarray(by_formula(filter, stored, depth))
    np.testing.assert_allclose(bound(VarianceShadowMap(least_variance=0.01)), 0.01 / (0.01 + 0.1**2), rtol=1e-4)
    np.testing.assert_allclose(bound(ExponentialShadowMap(exponent=10.0)), np.exp(-1), rtol=1e-5)
    # The warps are measured by the receiver's own, and the floor by their slopes 2 c there.
    both = ExponentialVarianceShadowMap(positive_exponent=3.0, negative_exponent=2.0, least_variance=0.01)
    floors, behind = 0.01 * (2 * np.array([3.0, 2.0])) ** 2, np.array([1 - np.exp(-0.6), np.exp(0.4) - 1])
    np.testing.assert_allclose(bound(both), np.min(floors / (floors + behind**2)), rtol=1e-4)
    # With all of the bias, masses of 3/16 at both ends and 5/8 in the middle: what lies before it shadows.
    np.testing.assert_allclose(bound(MomentShadowMap(moment_bias=1.0), stored), 1 - 3 / 16, rtol=1e-4)


@eqx.filter_jit
def blurred(kernel, radius, values, beyond):
    """Of values (2, 24, 24); and by how many texels it is wider."""
    blur = Blur(radius, 4.0, kernel)
    return blur(values, beyond), blur.margin


@pytest.mark.parametrize("kernel", ["box", "tent", "gaussian"])
@pytest.mark.parametrize("radius", [0.0, 0.5, 1.0, 2.5, 3.3])
def test_blur_of_a_half_plane_is_the_kernels_integral(kernel, radius):
    values = np.where(np.arange(24) < 12, 0.0, 1.0) * np.ones((24, 1))
    both = jnp.asarray(np.stack([values, values.T]), jnp.float32)
    wide, margin = blurred(kernel, jnp.float32(radius), both, jnp.float32(0))
    assert wide.shape == (2, 24 + 2 * margin, 24 + 2 * margin)
    for image in (np.asarray(wide[0]), np.asarray(wide[1]).T):
        middle = image[len(image) // 2, margin:-margin][4:-4]
        exact = share_below(kernel, max(radius, 1e-3), np.arange(24) + 0.5 - 12)[4:-4]
        np.testing.assert_allclose(middle, exact, atol=2e-6)


@pytest.mark.parametrize("kernel", ["box", "tent", "gaussian"])
def test_blur_keeps_constants_and_spreads_the_map_across_its_border(kernel, rng):
    radius, beyond = jnp.float32(3.7), jnp.float32(0.3)
    constant, margin = blurred(kernel, radius, jnp.asarray(np.full((2, 24, 24), 0.3), jnp.float32), beyond)
    np.testing.assert_allclose(constant, 0.3, atol=1e-6)
    values = rng.random((2, 24, 24))
    wide = np.asarray(blurred(kernel, radius, jnp.asarray(values, jnp.float32), jnp.float32(0))[0])
    # Nothing is lost, and the outermost texels hold what lies beyond.
    np.testing.assert_allclose(wide.sum(axis=(1, 2)), np.sum(values, axis=(1, 2)), rtol=1e-5)
    assert (wide[:, 0] == 0).all()
    assert (wide[:, :, -1] == 0).all()
    assert (wide[:, margin - 1, margin:-margin] > 0).all()


def test_linear_depth_runs_from_near_to_far():
    spot = SpotLight((0, 4, 0), (0, -1, 0), outer_angle=30.0, near=1.0, far=5.0)
    depth = jnp.array([[-0.1, 0.0, 0.5, 0.9, 1.0, 1.4]])
    distance = 1 / (1 - np.array([0.0, 0.0, 0.5, 0.9, 1.0, 1.0]) * (1 - 1 / 5))
    found, plain = eqx.filter_jit(lambda maps: [linear_depth(m, m.depth)[0] for m in maps])(
        [ShadowMap(depth, spot), ShadowMap(depth, SUN)]
    )
    np.testing.assert_allclose(found, (distance - 1) / 4, atol=1e-6)
    np.testing.assert_allclose(plain, [0, 0, 0.5, 0.9, 1, 1], atol=1e-6)


SHAPE = (6, 16)
"""Of look-ups."""
REACH = 3.0
"""Texels, of all these filters."""


def all_seen(shadow_map, x, y, depth, radius, kernel="box", **options):
    """Visibility (h, w) by each kind of map, all by one program."""
    x, y, depth = (np.broadcast_to(v, SHAPE) for v in (x, y, depth))
    kernels = [kind(radius, REACH, kernel, **options) for kind in KINDS.values()]
    found = seen(kernels, shadow_map, lookups_at(x, y, depth))
    return {name: np.asarray(lit) for name, lit in zip(KINDS, found, strict=True)}


def receiver_and_occluder(depths, width=4):
    """A map of stripes at `depths`, so many texels wide, which repeat."""
    column = np.asarray(depths)[np.arange(24) // width % len(depths)]
    return ShadowMap(jnp.asarray(np.broadcast_to(column, (24, 24)), jnp.float32), SUN)


@pytest.mark.exhaustive
@pytest.mark.parametrize("radius", [0.5, 2.5])
def test_one_occluder_over_one_receiver_is_percentage_closer_filtering(radius):
    """At texels' centres; between them, compares are blended here and moments there."""
    shadow_map, x = receiver_and_occluder((0.3, 0.7)), np.arange(4, 20) + 0.5
    # How much of the box lies in stripes as deep as the receiver.
    deep = np.asarray(shadow_map.depth)[0] > 0.5
    shares = [np.clip(np.minimum(x + radius, t + 1) - np.maximum(x - radius, t), 0, None) for t in range(24)]
    expected = np.sum([share * d for share, d in zip(shares, deep, strict=True)], axis=0) / (2 * radius)
    for found in all_seen(shadow_map, x, 12.5, 0.7, radius).values():
        np.testing.assert_allclose(found, np.broadcast_to(expected, SHAPE), atol=3e-3)
    assert np.ptp(expected) > 0.5


def test_uniform_depths_are_wholly_lit_or_dark(rng):
    x, y = rng.uniform(8, 16, (2, *SHAPE))
    shadow_map, empty = receiver_and_occluder((0.5,)), map_of(np.ones((24, 24)))
    for depth, expected in ((0.2, 1), (0.499, 1), (0.6, 0), (0.95, 0)):
        for found in all_seen(shadow_map, x, y, depth, 2.2, light_bleeding=0.02).values():
            np.testing.assert_allclose(found, expected, atol=0)
    for depth in (0.0, 0.5, 1.0):
        for found in all_seen(empty, x, y, depth, 2.2, light_bleeding=0.02).values():
            np.testing.assert_allclose(found, 1, atol=3e-5)


def test_beyond_the_border_all_is_lit():
    x, y = np.array([[-40.0, 40.0, 12.0, 12.0, -3.6, 1e9], [12.0, 12.0, -40.0, 40.0, -3.6, -1e9]])[:, :, None]
    for found in all_seen(receiver_and_occluder((0.2,)), x, y, 0.9, 2.5).values():
        np.testing.assert_allclose(found, 1, atol=2e-5)


@pytest.mark.parametrize("kernel", ["box", pytest.param("tent", marks=pytest.mark.exhaustive), "gaussian"])
def test_bounds_hold_for_any_depths(kernel, rng):
    """Visibility is never less than the share of the kernel that is not nearer than the receiver."""
    radius = 2.6
    shadow_map = ShadowMap(jnp.asarray(rng.random((24, 24)), jnp.float32), SUN)
    column, row = np.meshgrid(np.arange(4, 20), np.arange(8, 14))
    receiver = rng.random(SHAPE)
    offsets = np.arange(-3, 4)
    weight = share_below(kernel, radius, offsets + 0.5) - share_below(kernel, radius, offsets - 0.5)
    stored = np.asarray(shadow_map.depth, np.float64)
    truth = np.zeros(SHAPE)
    for i, wx in zip(offsets, weight, strict=True):
        for j, wy in zip(offsets, weight, strict=True):
            truth += wx * wy * (stored[row + j, column + i] >= receiver)
    lit = all_seen(shadow_map, column + 0.5, row + 0.5, receiver, radius, kernel)
    for found in (lit[name] for name in BOUNDS):
        assert (found >= truth - 2e-3).all()
        assert (found <= 1 + 1e-6).all()
        # And they say something.
        assert np.mean(found - truth) < 0.35


def test_chebyshev_is_tight_for_two_depths():
    share = np.linspace(0.1, 0.9, 5)
    mean, square = share * 0.2 + (1 - share) * 0.8, share * 0.04 + (1 - share) * 0.64
    arrays = (jnp.asarray(v[None], jnp.float32) for v in (mean, square - mean**2, np.full(5, 0.8)))
    np.testing.assert_allclose(chebyshev(*arrays)[0], 1 - share, atol=1e-6)


def test_light_bleeding_of_stacked_occluders_falls_from_method_to_method():
    """A receiver at 0.8 under an occluder at 0.6, of which another at 0.1 hides a half: all dark."""
    shadow_map, x = receiver_and_occluder((0.1, 0.6)), np.resize(np.arange(6, 18) + 0.5, 16)
    lit = all_seen(shadow_map, x, 12.5, 0.8, 2.5)
    variance, exponential, moments = (lit[name].max() for name in BOUNDS)
    assert variance > 0.15
    assert variance > 2 * exponential
    assert exponential > 0
    assert moments < 0.5 * exponential or moments < 1e-3
    reduced = all_seen(shadow_map, x, 12.5, 0.8, 2.5, light_bleeding=float(variance))
    np.testing.assert_allclose(reduced["variance"], 0, atol=1e-6)


def test_three_depths_bleed_in_moments_less_than_in_variance():
    lit = all_seen(receiver_and_occluder((0.1, 0.3, 0.5), width=2), np.arange(4, 20) + 0.5, 12.5, 0.75, 2.5)
    variance, moments = lit["variance"].max(), lit["moments"].max()
    assert 0.01 < moments < 0.6 * variance


@pytest.mark.exhaustive
@pytest.mark.parametrize("names", [("variance",), tuple(KINDS)], ids=["variance", "all"])
def test_layers_of_a_point_light_are_filtered_apart(names, rng):
    light = PointLight((0, 0, 0), near=0.5, far=5.0)
    depth = jnp.asarray(rng.uniform(0.5, 0.6, (6, 11, 14)), jnp.float32)
    lookup = random_lookups(rng)
    layer = rng.integers(0, 6, lookup.depth.shape)
    kernels = [KINDS[name](1.8) for name in names]
    layered = Lookup(
        lookup.texel, lookup.depth, lookup.depth_per_texel, lookup.inside, layer=jnp.asarray(layer, jnp.int32)
    )
    together = seen(kernels, ShadowMap(depth, light), layered)
    spot = SpotLight((0, 0, 0), (0, 0, -1), outer_angle=45.0, near=0.5, far=5.0)
    apart = [seen(kernels, ShadowMap(jnp.asarray(np.asarray(depth)[k]), spot), lookup) for k in range(6)]
    for kind, found in enumerate(together):
        one_by_one = np.stack([np.asarray(apart[k][kind]) for k in range(6)])
        expected = np.take_along_axis(one_by_one, layer[None], axis=0)[0]
        np.testing.assert_allclose(found, expected, atol=1e-5)
        assert np.ptp(expected) > 0.1
