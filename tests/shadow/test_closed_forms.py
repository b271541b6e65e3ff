"""Shadow mapping against formulas: tilted planes, squares over a floor, half-planes under wide filters."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    LIGHTS,
    apply,
    floor_and_card,
    floor_camera,
    lookups_at,
    map_of,
    marked,
    quad,
    shadows,
    side_camera,
    technique,
    twice,
)
from scipy.ndimage import maximum_filter, minimum_filter

from diffshadow.geometry import DirectionalLight, Mesh, OrthographicCamera, Scene, SpotLight, merge
from diffshadow.raster import Surface, draw_surface
from diffshadow.reference import trace_visibility
from diffshadow.shadow import (
    AdaptiveBias,
    Bias,
    FourTap,
    HardCompare,
    Nearest,
    PercentageCloser,
    RandomDisk,
    ReceiverPlane,
    ShadowMapping,
    draw_shadow_map,
    receiver,
    stratified,
)

TEXELS, POINTS = 64, 64
"""Of maps and images, along each side."""
SNAPPING = 1 / 128
"""Texels by which snapping to 1/256 texel may move an edge, with room for rounding."""


def tilted_plane(angle, azimuth, least=-12.0, most=12.0):
    """A plane that faces `+z`, whose depth along `-z` rises by tan(angle) along the direction `azimuth`, degrees.

    It reaches from `least` to `most` along that direction.
    """
    tilt, turn = np.radians([angle, azimuth])
    along = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), -np.sin(tilt)])
    across = np.array([-np.sin(turn), np.cos(turn), 0.0])
    return twice(quad((least + most) / 2 * along, (most - least) / 2 * along, 12 * across))


def unlit(bias, shadow_map, surface):
    """How many pixels of a plane one nearest tap finds in shadow."""
    visibility = np.asarray(shadows(ShadowMapping(Nearest(), bias), shadow_map, surface))
    return np.sum(np.asarray(surface.mask) & (visibility < 1))


def points_of_plane(angle, azimuth):
    """Points of `tilted_plane` over the middle of a map 2 units wide: one in each of 64 x 64 texels.

    They fall on as many different places of a texel along each axis, within 1/500 of its corners.
    """
    shape = (POINTS, POINTS)
    # Scrambled, since neighbours in the texel need not be neighbours in the map.
    places = np.linspace(0.002, 0.998, POINTS)[(np.arange(POINTS) * 27 + 13) % POINTS]
    x, y = np.meshgrid(*2 * [(np.arange(POINTS) + places) * 2 / TEXELS - 1])
    slope = -np.tan(np.radians(angle)) * np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
    position = np.stack([x, y, slope[0] * x + slope[1] * y], axis=-1).astype(np.float32)
    normal = np.array([-slope[0], -slope[1], 1]) / np.hypot(1, np.hypot(*slope))
    normal = np.broadcast_to(normal, position.shape).astype(np.float32)
    mask = np.pad(np.ones((POINTS - 2, POINTS - 2), bool), 1)
    position, normal, face, mask = (jnp.asarray(x) for x in (position, normal, np.zeros(shape, np.int32), mask))
    return Surface(position, normal, normal, normal, face, mask)


def least_bias(make_bias, angle, azimuth):
    """The least value, in texels, that leaves no false shadow on a tilted plane lit along -z."""
    light = DirectionalLight((0, 0, -1), (0, 0, 0), (2, 2), -12, 12)
    surface = points_of_plane(angle, azimuth)
    shadow_map = draw_shadow_map(tilted_plane(angle, azimuth), light, (TEXELS, TEXELS))
    low, high = 0.0, 8.0
    for _ in range(14):
        middle = (low + high) / 2
        if unlit(make_bias(middle), shadow_map, surface):
            low = middle
        else:
            high = middle
    return high


@pytest.mark.parametrize("azimuth", [0, 160])
@pytest.mark.parametrize("angle", [0, 20, 45, 60, 75])
def test_least_acne_free_constant_bias_of_a_tilted_plane(angle, azimuth):
    slope = np.tan(np.radians(angle)) * np.abs([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
    exact = slope.sum() / 2
    found = least_bias(lambda value: Bias(value), angle, azimuth)
    # Finitely many points come within 1 % of the corners of texels; depths are rounded to a thousandth of a texel.
    assert 0.985 * exact - 2e-3 <= found <= exact + 2e-3


@pytest.mark.parametrize(("azimuth", "exact"), [(0, 0.5), (45, np.sqrt(0.5))])
def test_least_acne_free_slope_bias_does_not_depend_on_the_angle(azimuth, exact):
    for angle in (30, 70):
        assert least_bias(lambda value: Bias(0.0, value), angle, azimuth) == pytest.approx(exact, rel=0.015)


PLANES = [(0, 0), (20, 25), (45, 110), (60, 160), (75, 45), (80, 200), (85, 0), (85, 30), (85, 290)]
"""Angles between normal and light's axis, and azimuths, degrees."""
TURNED = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A rotation, so that no number on the way is whole."""
OVERHEAD = {
    "directional": lambda: DirectionalLight(-TURNED[:, 2], (0, 0, 0), (2, 2), -12, 12),
    "spot": lambda: SpotLight(5 * TURNED[:, 2], -TURNED[:, 2], 25.0, 0.5, 20.0),
}


@functools.cache
def lit_plane(angle, azimuth, light, depth_format="float32"):
    """A plane at `angle` to the light's axis that fills most of its map, as a camera beside the light sees it."""
    # Before a lamp it ends, so that nothing has to be clipped.
    most = min(12.0, 4.4 / max(np.sin(np.radians(angle)), 0.1)) if light == "spot" else 12.0
    plane = tilted_plane(angle, azimuth, -most, 12.0)
    mesh = Mesh(np.asarray(plane.vertices) @ TURNED.T, plane.faces)
    camera = OrthographicCamera(
        4 * TURNED[:, 2], (0, 0, 0), tuple(TURNED[:, 1]), height=1.9, near=-12.0, far=20.0, resolution=(64, 64)
    )
    shadow_map = draw_shadow_map(mesh, OVERHEAD[light](), (64, 64), depth_format=depth_format)
    return shadow_map, draw_surface(mesh, camera)


KERNELS = {
    "nearest": lambda radius: Nearest(),
    "four_tap": FourTap,
    "pcf": lambda radius: PercentageCloser(radius, 3.0),
    "wide_pcf": lambda radius: PercentageCloser(radius, 16.0),
    "nearest_disk": lambda radius: RandomDisk(radius, SETS, lookup="nearest"),
    "disk": lambda radius: RandomDisk(radius, SETS, lookup="bilinear"),
}
SETS = stratified()
# What a kernel does with a plane does not depend on the light, nor the plane on the kernel.
USUAL = {"directional": ("four_tap", "pcf", "disk"), "spot": ("nearest", "nearest_disk")}


@eqx.filter_jit
def acne_of_filters(names, shadow_map, surface, radius):
    """Receivers that each filter shadows in part."""
    visibility = [ShadowMapping(KERNELS[k](radius), ReceiverPlane()).visibility(shadow_map, surface) for k in names]
    # The shares of a box add up to 1 but for rounding.
    return jnp.stack([jnp.sum(surface.mask & (v < 1 - 1e-5)) for v in visibility])


@pytest.mark.parametrize(("angle", "azimuth"), PLANES)
@pytest.mark.parametrize("light", marked(OVERHEAD, list(OVERHEAD)[1:]))
def test_receiver_plane_leaves_no_acne_on_a_plane_under_any_kernel(light, angle, azimuth):
    shadow_map, surface = lit_plane(angle, azimuth, light)
    seen = np.sum(surface.mask)
    assert seen > 0.5 * surface.mask.size
    for radius in (0.7, 3.0, 16.0):
        assert not np.asarray(acne_of_filters(USUAL[light], shadow_map, surface, jnp.float32(radius))).any()
    assert unlit(Bias(), shadow_map, surface) > 0.3 * seen or angle < 20


@pytest.mark.exhaustive
def test_receiver_plane_knows_how_the_rasterizer_rounds():
    wide = ShadowMapping(RandomDisk(16.0, SETS, lookup="nearest"), ReceiverPlane(deepening=0.0))
    for angle, azimuth in ((0, 0), (60, 160), (85, 30)):
        shadow_map, surface = lit_plane(angle, azimuth, "spot", "unorm16")
        assert np.asarray(shadows(wide, shadow_map, surface)).min() == 1


@eqx.filter_jit
def adaptively(shadow_map, surface):
    """What a nearest tap makes of the adaptive bias; the bias with an epsilon of 0.05, what a texel spans and what
    rounding may do, all in texels."""
    at = receiver(shadow_map, surface)
    spans = jnp.sum(jnp.abs(at.slope), axis=-1) / 2
    lit = ShadowMapping(Nearest(), AdaptiveBias()).visibility(shadow_map, surface)
    return lit, AdaptiveBias(0.05)(at).depth / at.depth_per_texel, spans, at.rounding / at.depth_per_texel


@pytest.mark.parametrize(("angle", "azimuth"), PLANES)
@pytest.mark.parametrize("light", [pytest.param("directional", marks=pytest.mark.exhaustive), "spot"])
def test_adaptive_bias_leaves_no_acne_and_is_no_more_than_a_texel_spans(light, angle, azimuth):
    shadow_map, surface = lit_plane(angle, azimuth, light)
    mask = np.asarray(surface.mask)
    lit, bias, spans, rounding = (np.asarray(x)[mask] for x in adaptively(shadow_map, surface))
    assert (lit == 1).all()
    lift = bias - rounding - 0.05
    # A constant bias needs what a texel spans everywhere.
    assert (lift <= spans * (1 + 1e-4) + 1e-5).all()
    assert (rounding <= 0.02).all()
    if angle > 0:
        assert (lift / spans).max() > 0.9
        assert (lift / spans).mean() < 0.45


def inside_of_quad(points, corners):
    """How far `points` (..., 2) lie inside a convex quad (4, 2), in the maximum norm: the least over its edges."""
    inside = []
    for a, b, c in zip(corners, np.roll(corners, -1, axis=0), np.roll(corners, -2, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]])
        normal *= np.sign((c - a) @ normal) / np.abs(normal).sum()
        inside.append((points - a) @ normal)
    return np.min(inside, axis=0)


@eqx.filter_jit
def matrix_of(light):
    return light.view().matrix


def texels_of(light, points, resolution):
    """Where world `points` fall on the light's map, in texels."""
    points = np.asarray(points, np.float64)
    clip = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ np.asarray(matrix_of(light)).T
    return (clip[..., :2] / clip[..., 3:] * 0.5 + 0.5) * np.array(resolution[::-1])


@pytest.mark.parametrize("name", LIGHTS)
def test_shadow_of_a_square_lies_where_geometry_says(name):
    mesh = floor_and_card(0.5, height=1.0)
    light = LIGHTS[name](mesh)
    surface = draw_surface(mesh, floor_camera(1.5, (64, 64)))
    resolution = (64, 64)
    shadow_map = draw_shadow_map(mesh, light, resolution)
    visibility = np.asarray(shadows(technique(Nearest(), constant=1.0, slope=1.0), shadow_map, surface))

    # Where each ray to the light pierces the card's plane, by similar triangles.
    position = np.asarray(surface.position, np.float64)
    to_light = np.asarray(light.position) - position if name == "spot" else -np.asarray(light.direction, np.float64)
    pierced = position + to_light / to_light[..., 1:2]
    truth = ~(np.abs(pierced[..., ::2]).max(axis=-1) < 0.5)

    distance = np.abs(
        inside_of_quad(texels_of(light, position, resolution), texels_of(light, mesh.vertices[4:], resolution))
    )
    assert 0.05 < np.mean(~truth) < 0.5
    assert (visibility == truth)[distance > 0.5 + SNAPPING].all()
    # And the texel's width shows: nearest look-ups are wrong somewhere along the outline.
    assert (visibility != truth).any()


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.5, 3.3])
def test_pcf_of_half_plane_is_a_ramp_as_wide_as_its_box(radius):
    x = np.linspace(8, 24, 321)
    depth = np.where(np.arange(32) < 16, 0.2, 1.0) * np.ones((12, 1))
    visibility = apply(PercentageCloser(radius, 4.0), map_of(depth), lookups_at(x, 6.3), HardCompare())
    np.testing.assert_allclose(visibility[0], np.clip((x - 16 + radius) / (2 * radius), 0, 1), atol=3e-6)


@pytest.mark.parametrize("early_out", [False, True])
def test_random_disk_of_half_plane_is_a_circular_segment(early_out):
    radius, x = 6.0, np.linspace(8, 24, 65)
    depth = np.where(np.arange(32) < 16, 0.2, 1.0) * np.ones((96, 1))
    disk = RandomDisk(radius, stratified((8, 8), pattern_size=64), "nearest", early_out)
    visibility = np.asarray(apply(disk, map_of(depth), lookups_at(x, np.full((64, 1), 48.0)), HardCompare()))
    s = np.clip((x - 16) / radius, -1, 1)
    exact = 0.5 + (s * np.sqrt(1 - s * s) + np.arcsin(s)) / np.pi
    # 64 x 64 stratified samples: their error is below that of independent ones, whose 4.5 standard errors are allowed.
    noise = 4.5 * np.sqrt(exact * (1 - exact) / 4096)
    error = np.abs(np.mean(visibility, axis=0) - exact)
    if early_out:  # the outermost eight may agree where a few inner ones would not
        noise = noise + 0.03
    assert (error <= noise + 1e-6).all()
    assert np.ptp(visibility[0]) == 1


@pytest.mark.parametrize("light", LIGHTS)
def test_hard_map_agrees_with_rays_away_from_outlines(light):
    box = Mesh(*_box_corners())
    mesh = merge([quad((0, 0, 0), (2.2, 0, 0), (0, 0, -2.2)), box])
    scene = Scene(mesh, side_camera((64, 64)), LIGHTS[light](mesh))
    reference = trace_visibility(scene)
    surface = draw_surface(mesh, scene.camera)
    shadow_map = draw_shadow_map(mesh, scene.light, (64, 64))
    nearest = np.asarray(shadows(technique(Nearest(), constant=0.5, slope=0.9), shadow_map, surface))
    mask = np.asarray(surface.mask) & reference.mask
    # A texel is about as wide as three pixels: what is lit like all around it lies a texel from every outline.
    reach = [minimum_filter(reference.visibility, 7), maximum_filter(reference.visibility, 7)]
    far = mask & (reach[0] == reach[1])
    assert far.sum() > 0.7 * mask.sum()
    assert (nearest != reference.visibility)[far].sum() <= 2  # pixels on the box's own edges
    assert 0.05 < np.mean(reference.visibility[far]) < 0.98


def _box_corners():
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]
    faces += [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return signs * 0.45 + [0.0, 1.0, 0.0], faces
