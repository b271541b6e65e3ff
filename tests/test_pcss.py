"""Percentage-closer soft shadows: widths of penumbrae, against rays, bounds on the radius, derivatives."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    apply,
    covered,
    lookups_at,
    map_of,
    problem,
    quad,
    random_lookups,
    random_map,
    shadows,
    slopes_of_loss,
    technique,
)

from diffshadow.geometry import (
    DirectionalLight,
    OrthographicCamera,
    PinholeCamera,
    PointLight,
    RectangleLight,
    Scene,
    SpotLight,
    merge,
)
from diffshadow.raster import draw_surface
from diffshadow.reference import trace_visibility
from diffshadow.shadow import (
    Bilinear,
    ConstantBias,
    HardCompare,
    Lookup,
    PercentageCloserSoft,
    RandomDisk,
    ReceiverPlane,
    ShadowMap,
    ShadowMapping,
    SoftCompare,
    draw_shadow_map,
    stratified,
)
from diffshadow.shadow.filters._pcss import half_width_of

HARD = HardCompare()
DISTANCE = 4.0
"""Of lamps over the floor."""
LIGHTS = {
    "directional": DirectionalLight((0, -1, 0), (0, 0, 0), (4, 4), -3, 3, angular_radius=3.0),
    "spot": SpotLight((0, DISTANCE, 0), (0, -1, 0), outer_angle=30.0, near=1.0, far=4.5, radius=0.1),
    "point": PointLight((0, DISTANCE, 0), near=1.0, far=4.5, radius=0.1),
}
SEGMENT_10_90 = 1.3740
"""Of the share of a disk of radius 1 on one side of a line: from where it is 0.1 to where it is 0.9."""


def penumbra_width(light, height):
    """By the geometry of the light and an edge over the floor."""
    if light.is_directional:
        return 2 * height * np.tan(np.radians(float(light.angular_radius)))
    return 2 * float(light.radius) * height / (DISTANCE - height)


@pytest.mark.parametrize(
    ("light", "compare"),
    [
        pytest.param("directional", HARD, id="directional"),
        pytest.param("spot", HARD, id="spot"),
        pytest.param("point", HARD, id="point", marks=pytest.mark.exhaustive),
        pytest.param("directional", SoftCompare(0.5), id="soft"),
    ],
)
def test_penumbra_grows_as_the_blocker_rises(light, compare):
    light = LIGHTS[light]
    mapping = ShadowMapping(PercentageCloserSoft(), ConstantBias(1.5), compare)
    for height in (0.7, 2.0):
        # A half-plane over the floor whose edge lies along z, seen by a long row of pixels.
        mesh = merge([quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), quad((-1.5, height, 0), (1.5, 0, 0), (0, 0, -3))])
        camera = OrthographicCamera(
            (0, height / 2, 0), (0, 0, 0), (0, 0, -1), height=0.03, near=1e-3, far=height, resolution=(24, 800)
        )
        surface = draw_surface(mesh, camera)
        visibility = shadows(mapping, draw_shadow_map(mesh, light, (512, 512)), surface).mean(axis=0)
        across = np.asarray(surface.position[0, :, 0])
        # A soft compare leaves a receiver with a bias of three widths not wholly lit.
        visibility = np.asarray(visibility) / float(visibility.max())
        found = np.interp(0.9, visibility, across) - np.interp(0.1, visibility, across)
        exact = penumbra_width(light, height)
        assert found == pytest.approx(exact * SEGMENT_10_90 / 2, rel=0.1)
        assert np.interp(0.5, visibility, across) == pytest.approx(0, abs=0.05 * exact)


def test_blockers_and_penumbra_of_flat_maps_follow_from_the_formulas():
    lookup = lookups_at(np.linspace(10, 20, 4), 15.0, 0.9, depth_per_texel=0.05)
    for name, light in LIGHTS.items():
        if name == "point":
            continue
        view = light.view()
        z_r, z_b = (float(view.eye_depth(jnp.float32(d))) for d in (0.9, 0.5))
        shadow_map = ShadowMap(jnp.full((32, 32), 0.5), light)
        size = 0.1 if view.is_perspective else np.tan(np.radians(3.0))
        texel = float(view.texel_size(jnp.float32(z_r), (32, 32)))
        world = (z_r - z_b) * size / (z_b if view.is_perspective else 1)
        found = PercentageCloserSoft(max_radius=4.0).find_blockers(shadow_map, lookup, HARD)
        np.testing.assert_allclose(found.share, 1, atol=1e-6)
        np.testing.assert_allclose(found.depth, 0.5, atol=1e-6)
        np.testing.assert_allclose(found.radius, world / texel, rtol=2e-5)
        assert 0.05 < world / texel < 4
        for low, high in ((4.0, 8.0), (0.0, 0.01)):
            kernel = PercentageCloserSoft(min_radius=low, max_radius=high)
            bounded = kernel.find_blockers(shadow_map, lookup, HARD).radius
            np.testing.assert_allclose(bounded, low or high, rtol=1e-6)


@pytest.mark.exhaustive
def test_search_finds_all_that_can_hide_the_light_and_nothing_else():
    """A row of texels that block at the near plane, as seen from receivers at growing distance from it."""
    light = DirectionalLight((0, 0, -1), (0, 0, 0), (64, 64), 0, 64, angular_radius=20.0)
    depth = np.ones((64, 64))
    depth[:, 32:] = 1e-6
    receiver, x = 0.5, np.linspace(8, 40, 321)
    kernel = PercentageCloserSoft(search=stratified((32, 32), 1), pattern=stratified((2, 2), 1))
    share = kernel.find_blockers(ShadowMap(jnp.asarray(depth, jnp.float32), light), lookups_at(x, 32.0, receiver), HARD)
    reach = 32 * np.tan(np.radians(20.0))
    finds = np.asarray(share.share[0]) > 1e-5
    # Half a texel more, by the bilinear taps.
    assert x[finds].min() == pytest.approx(32 - reach - 0.5, abs=0.4)
    assert finds[x > 32].all()


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["directional", "spot"])
def test_light_size_takes_the_place_of_the_lights_own(light):
    known = problem(technique(PercentageCloserSoft(), constant=0.5, slope=1.0), light, image=48)
    lamp = known.shadow_map.light
    field, size = ("angular_radius", 12.0) if light == "directional" else ("radius", 0.6)
    point = shadows(known.technique, known.shadow_map, known.surface)
    given = eqx.tree_at(lambda t: t.filter, known.technique, PercentageCloserSoft(size))
    larger = eqx.tree_at(
        lambda m: m.light, known.shadow_map, eqx.tree_at(lambda lamp: getattr(lamp, field), lamp, jnp.asarray(size))
    )
    own = shadows(known.technique, larger, known.surface)
    np.testing.assert_array_equal(shadows(given, known.shadow_map, known.surface), own)
    assert np.abs(np.asarray(own - point)).max() > 0.2


def test_sizes_of_lights():
    assert float(half_width_of(LIGHTS["directional"], None)) == pytest.approx(np.tan(np.radians(3.0)), rel=1e-6)
    assert float(half_width_of(LIGHTS["directional"], jnp.asarray(5.0))) == pytest.approx(
        np.tan(np.radians(5.0)), rel=1e-6
    )
    assert float(half_width_of(LIGHTS["point"], None)) == pytest.approx(0.1)
    assert float(half_width_of(LIGHTS["spot"], jnp.asarray(0.3))) == pytest.approx(0.3)
    panel = RectangleLight((0, 4, 0), (0, -1, 0), (0.4, 0.1), outer_angle=30.0, near=1.0, far=4.5)
    assert np.pi * float(half_width_of(panel, None)) ** 2 == pytest.approx(0.04, rel=1e-6)
    flat = eqx.tree_at(lambda lamp: lamp.size, panel, jnp.array([0.4, 0.0]))
    slope = jax.grad(lambda size: half_width_of(eqx.tree_at(lambda lamp: lamp.size, panel, size), None))(flat.size)
    assert float(half_width_of(flat, None)) == 0
    assert np.isfinite(np.asarray(slope)).all()
    unknown = SimpleNamespace(is_directional=False)
    with pytest.raises(
        ValueError, match="how large a SimpleNamespace is is not known: give the soft shadows a light_size"
    ):
        half_width_of.__wrapped__(unknown, None)


def test_one_radius_for_all_is_the_random_disk():
    rng = np.random.default_rng(5)
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    # A light so large that the search has that radius too.
    pattern = stratified((4, 4))
    for compare in (HARD, SoftCompare(0.7)):
        soft = PercentageCloserSoft(89.0, pattern, pattern, min_radius=2.0, max_radius=2.0)
        found = apply(soft, shadow_map, lookup, compare)
        np.testing.assert_allclose(found, apply(RandomDisk(2.0, pattern), shadow_map, lookup, compare), atol=2e-5)


def test_lights_without_size_and_empty_maps():
    rng = np.random.default_rng(6)
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    point = apply(PercentageCloserSoft(), shadow_map, lookup, HARD)
    np.testing.assert_allclose(point, apply(Bilinear(), shadow_map, lookup, HARD), atol=1e-6)
    large = PercentageCloserSoft(30.0)
    np.testing.assert_array_equal(apply(large, map_of(np.ones((11, 14))), lookup, HARD), 1)
    np.testing.assert_array_equal(apply(large, map_of(np.ones((11, 14))), lookup, SoftCompare(0.5)), 1)
    wholly = map_of(np.full((11, 14), 0.1))
    inner = lookups_at(rng.uniform(5, 9, (4, 4)), rng.uniform(5, 6, (4, 4)))
    np.testing.assert_array_equal(apply(PercentageCloserSoft(30.0, max_radius=4.0), wholly, inner, HARD), 0)


POLE = merge(
    [
        quad((0, 0, 0), (3, 0, 0), (0, 0, -3)),
        *(
            quad(np.array([s * a, 1.5, s * (0.1 - a)]), (0.1 - a, 0, a), (0, 1.5, 0))
            for a in (0.0, 0.1)
            for s in (-1, 1)
        ),
    ]
)


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["directional", "spot"])
def test_shadow_of_a_tall_pole_is_nearer_to_rays_than_with_any_one_radius(light):
    if light == "directional":
        light = DirectionalLight.around(jnp.array((1.0, -1.2, 0.2)), POLE.vertices, angular_radius=3.0)
    else:
        light = SpotLight((-4, 5, -1), (4, -4, 1), outer_angle=40.0, near=2.0, far=12.0, radius=0.3)
    camera = PinholeCamera((1.5, 6.0, 4.0), (0.8, 0, 0), fov_y=45.0, near=0.5, far=20.0, resolution=(80, 80))
    reference = trace_visibility(Scene(POLE, camera, light), samples=128)
    surface, shadow_map = draw_surface(POLE, camera), draw_shadow_map(POLE, light, (512, 512))
    mapping = ShadowMapping(RandomDisk(), ReceiverPlane(deepening=0.0))
    mask = np.asarray(covered(mapping, shadow_map, surface)) & reference.mask

    def error(kernel):
        seen = shadows(eqx.tree_at(lambda m: m.filter, mapping, kernel), shadow_map, surface)
        return np.sqrt(np.mean((np.asarray(seen) - reference.visibility)[mask] ** 2))

    fixed = {radius: error(RandomDisk(float(radius), stratified((8, 8)))) for radius in (0, 2, 3, 4, 5, 6, 8, 12)}
    soft = error(PercentageCloserSoft(search=stratified((8, 8), seed=1), pattern=stratified((8, 8))))
    # The best of them lies between the least and the greatest, so that no other would be better.
    assert min(fixed, key=fixed.get) not in (0, 12)
    assert soft < 0.6 * min(fixed.values())


@pytest.mark.parametrize("light", [pytest.param("directional", marks=pytest.mark.exhaustive), "spot"])
def test_gradient_of_the_loss_matches_central_differences(light):
    names = ("bias.constant", "bias.slope", "bias.normal_offset", "filter.light_size", "compare.width")
    with jax.enable_x64(True):
        size = 6.0 if light == "directional" else 1.0
        kernel = PercentageCloserSoft(size, stratified((2, 2), 4), stratified((2, 3), 4), 0.0, 8.0)
        known = problem(technique(kernel, compare=SoftCompare(2.0)), light, image=32, texels=32)
        at = (0.9, 0.6, 0.4, size, 2.0)
        slopes, forward, backward = slopes_of_loss(known, names, at, np.full(len(at), 1e-6), reverse=True)
    assert (np.abs(slopes) > 1e-6).all()
    np.testing.assert_allclose(forward, slopes, rtol=0.01)
    np.testing.assert_allclose(forward, backward, rtol=1e-8)


@eqx.filter_jit
@eqx.filter_grad
def slopes_of_sum(arguments):
    shadow_map, lookup, size, width = arguments
    kernel = PercentageCloserSoft(size, stratified((2, 2), 4), stratified((2, 2), 4), 0.0, 6.0)
    return jnp.sum(kernel(shadow_map, lookup, SoftCompare(width)))


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["directional", "spot"])
def test_no_gradient_is_nan_or_infinite(light):
    rng = np.random.default_rng(8)
    lookup = random_lookups(rng)
    # Before the light, behind it, at the far plane and beyond.
    depth = lookup.depth.at[0].set(-1.0).at[1].set(0.0).at[2].set(1.0).at[3].set(2.0)
    for empty in (0.2, 1.0):
        shadow_map = ShadowMap(random_map(rng, empty=empty).depth, LIGHTS[light])
        for scale, width, size in ((1.0, 0.7, 5.0), (0.0, 1e-3, 0.0), (1e9, 100.0, 0.0), (1e30, 1.0, 40.0)):
            moved = Lookup(jnp.round(lookup.texel) * scale, depth, lookup.depth_per_texel, lookup.inside)
            found = slopes_of_sum((shadow_map, moved, jnp.float32(size), jnp.float32(width)))
            assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PercentageCloserSoft(-1.0), r"light_size is -1.0; expected 0 or more degrees or world units"),
        (
            lambda: PercentageCloserSoft(min_radius=3.0, max_radius=2.0),
            r"min_radius is 3.0 and max_radius 2.0; expected",
        ),
        (lambda: PercentageCloserSoft(min_radius=-1.0), r"min_radius is -1.0 and max_radius 64.0"),
    ],
)
def test_impossible_settings_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
