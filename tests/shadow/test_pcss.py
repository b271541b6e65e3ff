"""Percentage-closer soft shadows: widths of penumbrae, against rays, bounds on the radius, derivatives."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    apply,
    lookups_at,
    marked,
    problem,
    random_lookups,
    random_map,
    shadows,
    technique,
)

from diffshadow.geometry import (
    DirectionalLight,
    PointLight,
    RectangleLight,
    SpotLight,
)
from diffshadow.raster import Surface
from diffshadow.shadow import (
    ConstantBias,
    HardCompare,
    PercentageCloserSoft,
    RandomDisk,
    ShadowMap,
    ShadowMapping,
    SoftCompare,
    stratified,
)
from diffshadow.shadow.filters._pcss import half_width_of

HARD = HardCompare()
DISTANCE = 4.0
"""Of lamps over the floor."""
LIGHTS = {
    "directional": DirectionalLight((0, -1, 0), (0, 0, 0), (4, 4), -3, 3, angular_radius=3.0),
    # With texels four times as wide as high.
    "wide": DirectionalLight((0, -1, 0), (0, 0, 0), (8, 2), -3, 3, angular_radius=3.0, up=(0, 0, -1)),
    "spot": SpotLight((0, DISTANCE, 0), (0, -1, 0), outer_angle=30.0, near=1.0, far=4.5, radius=0.1),
    "point": PointLight((0, DISTANCE, 0), near=1.0, far=4.5, radius=0.1),
}
SEGMENT_10_90 = 1.3740
"""Of the fraction of a disk of radius 1 on one side of a line: from where it is 0.1 to where it is 0.9."""


def penumbra_width(light, height):
    """By the geometry of the light and an edge over the floor."""
    if light.is_directional:
        return 2 * height * np.tan(np.radians(float(light.angular_radius)))
    return 2 * float(light.radius) * height / (DISTANCE - height)


def half_plane_over_floor(light, height, texels=512, columns=800):
    """What a light sees of a half-plane over the floor whose edge lies along z, and a row of the floor's points."""
    view = light.view()
    matrix = np.asarray(view.matrix, np.float64)

    def window(points):
        clip = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ matrix.T
        return clip[..., :3] / clip[..., 3:] * 0.5 + 0.5

    # The light looks straight down: planes of one height have one depth, and the edge is one line in the map.
    edge, floor = window(np.array([[0.0, height, 0.0], [0.0, 0.0, 0.0]]))
    beside = window(np.array([[-1.0, height, 0.0]]))[0]
    axis = int(np.argmax(np.abs(beside - edge)[:2]))
    assert edge[1 - axis] == pytest.approx(beside[1 - axis])
    x = (np.arange(texels) + 0.5) / texels
    hidden = (x - edge[axis]) * (beside - edge)[axis] > 0
    rows = np.where(np.expand_dims(hidden, axis), edge[2], floor[2])
    depth = jnp.asarray(np.broadcast_to(rows, (texels, texels)), jnp.float32)
    across, along = np.meshgrid(np.linspace(-0.5, 0.5, columns), np.linspace(-0.015, 0.015, 24))
    position = jnp.asarray(np.stack([across, 0 * across, along], axis=-1), jnp.float32)
    up = jnp.asarray(np.broadcast_to([0, 1, 0], position.shape), jnp.float32)
    whole = jnp.asarray(np.ones(across.shape, bool))
    return ShadowMap(depth, light), Surface(position, up, up, up, whole.astype(jnp.int32), whole), across[0]


def check_penumbra(light, height, compare, shadow_map, surface, across):
    mapping = ShadowMapping(PercentageCloserSoft(), ConstantBias(1.5), compare)
    visibility = np.asarray(shadows(mapping, shadow_map, surface)).mean(axis=0)
    # A soft compare leaves a receiver with a bias of three widths not wholly lit.
    visibility = visibility / visibility.max()
    found = np.interp(0.9, visibility, across) - np.interp(0.1, visibility, across)
    exact = penumbra_width(light, height)
    assert found == pytest.approx(exact * SEGMENT_10_90 / 2, rel=0.1)
    assert np.interp(0.5, visibility, across) == pytest.approx(0, abs=0.05 * exact)


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", marked(["directional", "wide", "spot"], {"directional", "wide"}))
def test_penumbra_grows_as_the_blocker_rises(light):
    light = LIGHTS[light]
    for height in (0.7, 2.0):
        check_penumbra(light, height, HARD, *half_plane_over_floor(light, height))


@eqx.filter_jit
def blockers(kernel, shadow_map, lookup, compare):
    """What a search finds; of the light's view, distances of two depths and the width of a texel at the first."""
    view = shadow_map.view
    z_r, z_b = view.eye_depth(jnp.float32(0.9)), view.eye_depth(jnp.float32(0.5))
    return kernel.find_blockers(shadow_map, lookup, compare), z_r, z_b, view.texel_size(z_r, shadow_map.resolution)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "compare"), [("directional", HARD), ("spot", SoftCompare(3.0))])
def test_blockers_and_penumbra_of_flat_maps_follow_from_the_formulas(name, compare):
    lookup, light = lookups_at(np.linspace(10, 20, 4), 15.0, 0.9, depth_per_texel=0.05), LIGHTS[name]
    shadow_map = ShadowMap(jnp.full((32, 32), 0.5), light)
    found, z_r, z_b, texel = blockers(PercentageCloserSoft(max_radius=4.0), shadow_map, lookup, compare)
    z_r, z_b, texel = (float(x) for x in (z_r, z_b, texel))
    size = 0.1 if name == "spot" else np.tan(np.radians(3.0))
    world = (z_r - z_b) * size / (z_b if name == "spot" else 1)
    # The blockers lie eight texels before the receiver.
    dark = 1 if compare == HARD else 1 / (1 + np.exp(-8 / 3.0))
    np.testing.assert_allclose(found.fraction, dark, atol=2e-6)
    np.testing.assert_allclose(found.depth, 0.5, atol=1e-6)
    np.testing.assert_allclose(found.radius, world / texel, rtol=2e-5)
    assert 0.05 < world / texel < 4
    for low, high in ((4.0, 8.0), (0.0, 0.01)):
        bounded = blockers(PercentageCloserSoft(min_radius=low, max_radius=high), shadow_map, lookup, compare)[0]
        np.testing.assert_allclose(bounded.radius, low or high, rtol=1e-6)


@pytest.mark.exhaustive
def test_search_finds_all_that_can_hide_the_light_and_nothing_else():
    """A row of texels that block at the near plane, as seen from receivers at growing distance from it."""
    light = DirectionalLight((0, 0, -1), (0, 0, 0), (64, 64), 0, 64, angular_radius=20.0)
    depth = np.ones((64, 64))
    depth[:, 32:] = 1e-6
    receiver, x = 0.5, np.linspace(8, 40, 321)
    kernel = PercentageCloserSoft(search=stratified((32, 32), 1), pattern=stratified((2, 2), 1))
    found = kernel.find_blockers(ShadowMap(jnp.asarray(depth, jnp.float32), light), lookups_at(x, 32.0, receiver), HARD)
    reach = 32 * np.tan(np.radians(20.0))
    finds = np.asarray(found.fraction[0]) > 1e-5
    # Half a texel more, by the bilinear taps.
    assert x[finds].min() == pytest.approx(32 - reach - 0.5, abs=0.4)
    assert finds[x > 32].all()


@pytest.mark.exhaustive
def test_light_size_takes_the_place_of_the_lights_own():
    known, size = problem(technique(PercentageCloserSoft(), constant=0.5, slope=1.0), "spot", image=48), 0.6
    point = shadows(known.technique, known.shadow_map, known.surface)
    given = eqx.tree_at(lambda t: t.filter, known.technique, PercentageCloserSoft(size))
    larger = eqx.tree_at(
        lambda m: m.light,
        known.shadow_map,
        eqx.tree_at(lambda lamp: lamp.radius, known.shadow_map.light, jnp.asarray(size)),
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
    slope = jax.jit(jax.grad(lambda size: half_width_of(eqx.tree_at(lambda lamp: lamp.size, panel, size), None)))(
        flat.size
    )
    assert float(half_width_of(flat, None)) == 0
    assert np.isfinite(np.asarray(slope)).all()
    unknown = SimpleNamespace(is_directional=False)
    with pytest.raises(ValueError, match="SimpleNamespace has no radius; set the light's radius or pass light_size"):
        half_width_of.__wrapped__(unknown, None)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "compare",
    [pytest.param(HARD, id="hard"), pytest.param(SoftCompare(0.7), id="soft")],
)
def test_one_radius_for_all_is_the_random_disk(compare):
    rng = np.random.default_rng(5)
    shadow_map, lookup = random_map(rng), random_lookups(rng)
    # A light so large that the search has that radius too.
    pattern = stratified((4, 4))
    soft = PercentageCloserSoft(89.0, pattern, pattern, min_radius=2.0, max_radius=2.0)
    found = apply(soft, shadow_map, lookup, compare)
    np.testing.assert_allclose(found, apply(RandomDisk(2.0, pattern), shadow_map, lookup, compare), atol=2e-5)
