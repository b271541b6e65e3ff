"""Shadow maps: what they hold, and the visibility that they give at borders and on averted faces."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    LIGHTS,
    compiled_programs,
    covered,
    floor_and_card,
    floor_surface,
    quad,
    shadows,
    side_camera,
    sun,
    surface_at,
    technique,
)

from diffshadow.geometry import DirectionalLight, Edges, Mesh, Tile, library_mesh, merge
from diffshadow.raster import DepthTest, draw_surface
from diffshadow.shadow import (
    Bias,
    ConstantBias,
    MapSettings,
    Nearest,
    ShadowMap,
    draw_shadow_map,
    look_up,
    receiver,
)
from diffshadow.shadow._map_depths import midpoint
from diffshadow.shadow._receiver import project

# A map and an image of one size share what is compiled. Nothing in an image of this size is too large for a window.
SIZE = (32, 32)


def drawn_map(mesh, light, **options):
    return draw_shadow_map(mesh, light, SIZE, **options)


@pytest.mark.parametrize("light", LIGHTS)
def test_map_holds_the_depth_of_what_the_light_sees_first(light):
    shadow_map = drawn_map(floor_and_card(), LIGHTS[light](floor_and_card()))
    view = shadow_map.view
    # Rays through texel centres, met with the card's plane and the floor's, in eye space.
    grid = (np.arange(32) + 0.5) / 16 - 1
    x, y = np.meshgrid(grid, grid)
    to_world = np.linalg.inv(np.asarray(view.matrix, np.float64))
    ends = [np.stack([x, y, np.full_like(x, z), np.ones_like(x)], -1) @ to_world.T for z in (-1.0, 1.0)]
    near, far = (end[..., :3] / end[..., 3:] for end in ends)
    depth = np.ones(SIZE)
    for height, half in ((0.0, 3.0), (1.0, 0.5)):
        share = (height - near[..., 1]) / (far[..., 1] - near[..., 1])
        hit = near + share[..., None] * (far - near)
        eye = -(hit @ np.asarray(view.world_to_eye[2, :3]) + float(view.world_to_eye[2, 3]))
        window = float(view.far) * (eye - view.near) / (eye * (view.far - view.near)) if light == "spot" else share
        window = np.where(np.abs(hit[..., ::2]).max(axis=-1) < half, window, 1)
        depth = np.minimum(depth, window)
    wrong = np.abs(np.asarray(shadow_map.depth) - depth) > 2e-5
    # Texels whose centre lies on an edge may fall to either side.
    assert wrong.sum() <= 6
    assert np.asarray(shadow_map.depth)[depth == 1].min() > 0.99
    assert shadow_map.resolution == SIZE


def test_culling_leaves_out_the_faces_named():
    light = sun(floor_and_card())
    full, no_back, no_front = (
        np.asarray(drawn_map(floor_and_card(), light, cull=cull).depth) for cull in ("none", "back", "front")
    )
    # All faces are turned up, to the light.
    np.testing.assert_array_equal(full, no_back)
    assert (no_front == 1).all()


@pytest.mark.parametrize("light", LIGHTS)
def test_a_shift_moves_the_grid_of_texels(light):
    mesh = floor_and_card()
    own, moved = (drawn_map(mesh, LIGHTS[light](mesh), **how) for how in ({}, {"shift": jnp.array([3.0, -2.0])}))
    points = floor_surface(1.0, (4, 4)).position
    texel = lambda drawn: np.asarray(project(drawn.view, SIZE, points)[0])
    np.testing.assert_allclose(texel(moved) - texel(own), np.broadcast_to([3.0, -2.0], (4, 4, 2)), atol=1e-4)
    off = np.abs(moved.depth[:-2, 3:] - own.depth[2:, :-3])
    assert (off < 1e-5).mean() > 0.99


def test_maps_whose_texels_are_not_even_have_no_shift():
    light = sun(floor_and_card()).view()
    with pytest.raises(ValueError, match="a shift by texels was given for a view with a warp, with pages"):
        dataclasses.replace(light, tile=Tile(jnp.zeros(2, jnp.int32), jnp.int32(16))).shifted(jnp.ones(2), SIZE)


def test_an_image_in_the_buffer_of_a_map_is_the_same_and_shares_its_program(monkeypatch):
    mesh, camera = floor_and_card(), side_camera((40, 60))
    expected = draw_surface(mesh, camera)
    # No image is small now, and the buffer of small ones is that of the map.
    monkeypatch.setattr("diffshadow.raster._rasterize._SHARED_SIDE", 1)
    settings = MapSettings((255, 255))
    buffer = settings.buffer(camera.resolution)
    assert buffer == (256, 256)
    settings.draw(mesh, sun(mesh))
    with compiled_programs() as compiled:
        surface = draw_surface(mesh, camera, buffer=buffer)
    assert not any("_rasterize" in name for name in compiled)
    for found, alone in zip(*map(jax.tree.leaves, (surface, expected)), strict=True):
        np.testing.assert_array_equal(found, alone)


def test_images_larger_than_a_map_and_maps_that_are_very_large_or_not_plain_share_no_buffer():
    for silhouettes in (True, None):
        with_corners = MapSettings((64, 64), silhouettes=silhouettes)
        assert with_corners.buffer((64, 65)) == (65, 65)
        assert with_corners.buffer((64, 66)) is None
    assert MapSettings((64, 64), silhouettes=False).buffer((64, 65)) is None
    assert MapSettings((4096, 64)).buffer((64, 64)) is None
    assert MapSettings((64, 64), depth_format="unorm16").buffer((64, 64)) is None
    assert MapSettings((64, 64), polygon_offset=(1.0, 1.0)).buffer((64, 64)) is None


def test_edges_under_a_trace_need_a_number_of_crossings():
    mesh = floor_and_card()
    edges = Edges.of(mesh)
    with pytest.raises(ValueError, match=r"without crossings.*plan_crossings"):
        jax.jit(lambda light: draw_shadow_map(mesh, light, (8, 8), edges=edges).depth)(sun(mesh))


LAYERS = ("nearest", "midpoint", "second")
SLAB = 0.3
"""Thickness of the slab that hovers over the floor, world units."""


def floor_and_slab():
    """A floor 1 unit wide in y = 0, and a closed slab half as wide whose top lies at y = 1."""
    slab = library_mesh("box", size=(0.5, SLAB, 0.5))
    raised = Mesh(np.asarray(slab.vertices) + np.array([0.0, 1.0 - SLAB, 0.0]), slab.faces)
    return merge([quad((0, 0, 0), (0.5, 0, 0), (0, 0, -0.5)), raised])


NOON = DirectionalLight((0, -1, 0), (0, 0, 0), (2, 2), -2, 0.5)
"""Straight down on the slab, 2.5 units deep."""


@pytest.mark.exhaustive
def test_layers_of_a_map_hold_the_first_surface_the_second_and_their_middle():
    depth = {layer: np.asarray(drawn_map(floor_and_slab(), NOON, depth_layer=layer).depth) for layer in LAYERS}
    window = lambda y: (2 - y) / 2.5
    tops, floor, nothing = (slice(12, 20),) * 2, (slice(8, 12), slice(8, 24)), (slice(0, 8), slice(0, 32))
    for where, first, second in (
        (tops, window(1.0), window(1.0 - SLAB)),
        (floor, window(0.0), 1.0),
        (nothing, 1.0, 1.0),
    ):
        np.testing.assert_allclose(depth["nearest"][where], first, atol=1e-6)
        np.testing.assert_allclose(depth["second"][where], second, atol=1e-6)
        # The floor has nothing behind it but the far plane.
        np.testing.assert_allclose(depth["midpoint"][where], (first + second) / 2, atol=1e-6)


def test_an_unknown_layer_is_refused():
    with pytest.raises((ValueError, TypeError), match="'third'"):
        inspect.unwrap(draw_shadow_map)(floor_and_slab(), sun(floor_and_slab()), (4, 4), depth_layer="third")


WITHOUT_BIAS = {
    "midpoint": {"depth_layer": "midpoint"},
    "second": {"depth_layer": "second"},
    "front culling": {"cull": "front"},
}


def ball(segments=12, rings=11, radius=0.5):
    """A closed ball of few triangles about (0, 0.5, 0)."""
    turn, tilt = np.arange(segments) * 2 * np.pi / segments, np.arange(1, rings) * np.pi / rings
    circle = np.stack(np.broadcast_arrays(np.cos(turn), 0.0, np.sin(turn)), axis=-1)
    between = np.sin(tilt)[:, None, None] * circle + np.cos(tilt)[:, None, None] * np.array([0, 1, 0])
    vertices = np.concatenate([[[0, 1, 0]], between.reshape(-1, 3), [[0, -1, 0]]])
    k = np.arange(segments)
    following, last = (k + 1) % segments, len(vertices) - 1
    faces = [np.stack([0 * k, 1 + following, 1 + k], axis=1)]
    for first in 1 + segments * np.arange(rings - 2):
        a, b, c, d = first + k, first + following, first + segments + k, first + segments + following
        faces += [np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]
    first = last - segments
    faces.append(np.stack([first + k, first + following, 0 * k + last], axis=1))
    return Mesh(radius * vertices + np.array([0, 0.5, 0]), np.concatenate(faces))


@pytest.mark.exhaustive
def test_closed_meshes_need_no_bias_where_the_map_holds_more_than_their_lit_side():
    mesh, direction, rng = ball(), np.array([0.3, -1, -0.2]), np.random.default_rng(0)
    light = DirectionalLight(direction, (0, 0.5, 0), (1.2, 1.2), -1, 1)
    # Points all over its faces, from which the normals point away from its centre.
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
    own = rng.integers(0, len(corners), SIZE)
    points = np.einsum("hwk,hwkc->hwc", rng.dirichlet(np.ones(3), SIZE), corners[own])
    normals = np.asarray(mesh.corner_normals)[own, 0]
    assert (np.sum(normals * (points - [0, 0.5, 0]), axis=-1) > 0).all()
    surface, mapping = surface_at(points, normals), technique(Nearest())
    cosine = normals @ -direction / np.linalg.norm(direction)
    facing = cosine > 0
    acne = lambda shadow_map: facing & (np.asarray(shadows(mapping, shadow_map, surface)) < 1)
    assert acne(drawn_map(mesh, light)).sum() > 0.4 * facing.sum()
    for name, options in WITHOUT_BIAS.items():
        dark = acne(drawn_map(mesh, light, **options))
        # A texel is a 1/32 of the map: beside the silhouette both sides of the ball lie within it.
        assert not dark[cosine > 0.35].any(), name
        assert dark.sum() < 0.05 * facing.sum(), name


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("depth_format", "unit", "rounding"),
    [
        ("float32", 2.0**-24, 2.5e-7),
        ("unorm24", 2 / (2**24 - 1), 2.5e-7),
        ("unorm16", 2 / (2**16 - 1), 1.01 / (2**16 - 1)),
    ],
)
def test_polygon_offset_is_factor_times_slope_plus_units(depth_format, unit, rounding):
    # A plane whose depth lies between 1/2 and 1, where floats are 2⁻²⁴ apart, and rises by 0.3 along x and 0.1 along y.
    mesh = quad((0, 0, -1.0), (1, 0, -0.3), (0, 1, -0.1))
    light = DirectionalLight((0, 0, -1), (0, 0, 0), (2, 2), -2, 2)
    drawn_with = lambda offset: np.asarray(
        drawn_map(mesh, light, depth_format=depth_format, polygon_offset=offset).depth, np.float64
    )
    plain, exact = drawn_with((0.0, 0.0)), 2 / 32 / 4 * 0.3
    assert 0.5 < plain.min() < plain.max() < 1
    for factor, units in ((1.0, 0.0), (0.0, 1000.0), (2.5, 3000.0), (-1.0, -50.0)):
        np.testing.assert_allclose(drawn_with((factor, units)) - plain, factor * exact + units * unit, atol=rounding)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("layer", "depth_format", "steps"),
    [
        ("nearest", "unorm16", 2**16 - 1),
        pytest.param("midpoint", "unorm16", 2**16 - 1, marks=pytest.mark.exhaustive),
    ],
)
def test_fixed_point_maps_round_to_the_nearest_step(depth_format, steps, layer):
    # The offset of nothing is there to share what is compiled.
    offset = None if depth_format == "float32" else (0.0, 0.0)
    fixed, exact = (
        np.asarray(
            drawn_map(floor_and_slab(), NOON, depth_layer=layer, depth_format=f, polygon_offset=o).depth, np.float64
        )
        for f, o in ((depth_format, offset), ("float32", None))
    )
    np.testing.assert_allclose(fixed * steps, np.round(fixed * steps), atol=1e-7 * steps)
    # The middle of two that are rounded is rounded again.
    np.testing.assert_allclose(fixed, exact, atol=(1.0 if layer == "midpoint" else 0.5) / steps + 2e-7)
    assert depth_format != "unorm16" or (fixed != exact).any()


def test_the_middle_of_fixed_point_depths_is_rounded_again():
    nearest, second, steps = np.array([3, 4, 10, 65535]), np.array([4, 6, 15, 65535]), 65535
    middle = midpoint(np.float32(nearest / steps), np.float32(second / steps), DepthTest("unorm16"))
    found = np.asarray(middle, np.float64) * steps
    np.testing.assert_allclose(found, np.round(found), atol=1e-2)
    np.testing.assert_allclose(found, (nearest + second) / 2, atol=0.51)


@eqx.filter_jit
def _received(shadow_map, surface):
    """The surface's depths as the light sees it, and those of its look-up with a bias of half of the depth's range."""
    at = receiver(shadow_map, surface)
    return at.depth, look_up(shadow_map, at, Bias(ConstantBias(0.5, "depth"))(at)).depth


def test_receivers_are_compared_with_fixed_point_maps_at_a_depth_these_could_hold():
    surface = floor_surface(2.0, SIZE)
    for depth_format, least in (("float32", -np.inf), ("unorm16", 0.0)):
        # The near plane lies on the near half of the floor, and the far plane beyond it.
        light = DirectionalLight((0.2, -1, 0), (0, 0, 0), (6, 6), -0.1, 2)
        shadow_map = ShadowMap(jnp.asarray(np.ones(SIZE, np.float32)), light, depth_format)
        plain, found = _received(shadow_map, surface)
        biased = np.asarray(plain) - 0.5
        assert (biased < 0).any()
        np.testing.assert_allclose(found, np.clip(biased, least, np.inf if least < 0 else 1), atol=1e-6)


def test_faces_turned_away_are_dark_and_pixels_without_surface_lit():
    # A lone upright card: its far side faces the camera, its near side the light.
    mesh, mask = quad((0, 1, 0), (1, 0, 0), (0, 1, 0)), np.arange(32)[:, None] < np.arange(32)
    points = np.stack(np.broadcast_arrays(np.linspace(-0.9, 0.9, 32), np.linspace(0.1, 1.9, 32)[:, None], 0.0), axis=-1)
    surface = dataclasses.replace(surface_at(points, (0, 0, 1)), mask=jnp.asarray(mask))
    for z, expected in ((1.0, 0.0), (-1.0, 1.0)):
        light = DirectionalLight((0, -0.2, z), (0, 1, 0), (4, 4), -4, 4)
        visibility = shadows(technique(Nearest(), constant=1.0, slope=1.0), drawn_map(mesh, light), surface)
        assert (np.asarray(visibility)[mask] == expected).all()
        assert (np.asarray(visibility)[~mask] == 1).all()


def test_receivers_beyond_the_border_and_the_far_plane_are_lit():
    surface = floor_surface(2.5, SIZE)
    x, z = np.asarray(surface.position)[..., 0], np.asarray(surface.position)[..., 2]
    mapping, zeros = technique(Nearest()), jnp.asarray(np.zeros((30, 20), np.float32))
    # A map of zeros shadows all that it covers: the middle 2 x 3 units.
    small = DirectionalLight((0, -1, 0), (0, 0, 0), (2, 3), -2, 2)
    visibility = np.asarray(shadows(mapping, ShadowMap(zeros, small), surface))
    frame = np.asarray(small.view().world_to_eye)[:2, :3]
    across = np.abs(np.stack([x, 0 * x, z], -1) @ frame.T) < [1, 1.5]
    np.testing.assert_array_equal(visibility == 0, across.all(axis=-1))
    np.testing.assert_array_equal(covered(mapping, ShadowMap(zeros, small), surface), across.all(axis=-1))
    # The same map, whose far plane ends above the floor.
    short = DirectionalLight((0, -1, 0), (0, 1, 0), (2, 3), -1, 0.5)
    assert (np.asarray(shadows(mapping, ShadowMap(zeros, short), surface)) == 1).all()
