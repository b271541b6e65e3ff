"""Shadow maps: what they hold, and the visibility that they give at borders and on averted faces."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LIGHTS, drawn, floor_and_card, floor_camera, quad, shadows, side_camera, sun, technique

from diffshadow.geometry import DirectionalLight, SpotLight, merge
from diffshadow.raster import draw_surface, plan
from diffshadow.shadow import Bilinear, Nearest, ShadowMap, draw_shadow_map


@pytest.mark.parametrize("light", LIGHTS)
def test_map_holds_the_depth_of_what_the_light_sees_first(light):
    _, shadow_map = drawn(light, 64, 64)
    view = shadow_map.view
    # Rays through texel centres, met with the card's plane and the floor's, in eye space.
    grid = (np.arange(64) + 0.5) / 32 - 1
    x, y = np.meshgrid(grid, grid)
    to_world = np.linalg.inv(np.asarray(view.matrix, np.float64))
    ends = [np.stack([x, y, np.full_like(x, z), np.ones_like(x)], -1) @ to_world.T for z in (-1.0, 1.0)]
    near, far = (end[..., :3] / end[..., 3:] for end in ends)
    depth = np.ones((64, 64))
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
    assert shadow_map.resolution == (64, 64)


def test_light_that_sees_nothing_leaves_everything_lit():
    mesh = floor_and_card()
    away = SpotLight((0, 3, 0), (0, 1, 0), 30.0, 0.1, 10.0)
    shadow_map = draw_shadow_map(mesh, away, (16, 16))
    assert (np.asarray(shadow_map.depth) == 1).all()
    surface, _ = drawn("spot", 64, 64)
    mapping = technique(Bilinear())
    assert (np.asarray(shadows(mapping, shadow_map, surface)) == 1).all()
    assert not bool(mapping.covered(shadow_map, surface).any())


def test_culling_leaves_out_the_faces_named():
    mesh = floor_and_card()
    light = sun(mesh)
    full, no_back, no_front = (
        np.asarray(draw_shadow_map(mesh, light, (32, 32), cull=cull).depth) for cull in ("none", "back", "front")
    )
    # All faces are turned up, to the light.
    np.testing.assert_array_equal(full, no_back)
    assert (no_front == 1).all()


def test_a_given_capacity_lets_the_map_be_drawn_under_a_trace_and_differentiated():
    mesh = floor_and_card()
    light = sun(mesh)
    capacity = plan(light.view().clip(mesh.vertices), mesh.faces, (32, 32))

    @jax.jit
    def depth_with(lift):
        raised = eqx.tree_at(lambda m: m.vertices, mesh, mesh.vertices + jnp.array([0.0, 1.0, 0.0]) * lift)
        return draw_shadow_map(raised, light, (32, 32), capacity=capacity).depth

    value, slope = jax.jvp(depth_with, (jnp.zeros(()),), (jnp.ones(()),))
    np.testing.assert_allclose(value, draw_shadow_map(mesh, light, (32, 32)).depth, atol=2e-7)
    # Seen along a fixed ray, a plane that rises by 1 comes nearer by 1 / |d_y| along it.
    direction = np.asarray(light.direction) / np.linalg.norm(light.direction)
    expected = -1 / abs(direction[1]) / float(light.far - light.near)
    np.testing.assert_allclose(np.asarray(slope)[np.asarray(value) < 1], expected, rtol=1e-4)
    with pytest.raises(ValueError, match="without a capacity"):
        jax.jit(lambda v: draw_shadow_map(eqx.tree_at(lambda m: m.vertices, mesh, v), light, (8, 8)).depth)(
            mesh.vertices
        )


def test_faces_turned_away_are_dark_and_pixels_without_surface_lit():
    # A lone upright card: its far side faces the camera, its near side the light.
    mesh = merge([quad((0, 1, 0), (1, 0, 0), (0, 1, 0))])
    camera = side_camera()
    surface = draw_surface(mesh, camera)
    for z, expected in ((1.0, 0.0), (-1.0, 1.0)):
        light = DirectionalLight((0, -0.2, z), (0, 1, 0), (4, 4), -4, 4)
        shadow_map = draw_shadow_map(mesh, light, (32, 32))
        visibility = np.asarray(shadows(technique(Nearest(), constant=1.0, slope=1.0), shadow_map, surface))
        mask = np.asarray(surface.mask)
        assert 0.02 < mask.mean() < 0.9
        assert (visibility[mask] == expected).all()
        assert (visibility[~mask] == 1).all()


def test_receivers_beyond_the_border_and_the_far_plane_are_lit():
    mesh = floor_and_card()
    surface = draw_surface(mesh, floor_camera(2.5, (64, 64)))
    x = np.asarray(surface.position)[..., 0]
    z = np.asarray(surface.position)[..., 2]
    mapping = technique(Nearest())
    # A map of zeros shadows all that it covers: the middle 2 x 3 units.
    small = DirectionalLight((0, -1, 0), (0, 0, 0), (2, 3), -2, 2)
    visibility = np.asarray(shadows(mapping, ShadowMap(jnp.zeros((30, 20)), small), surface))
    frame = np.asarray(small.view().world_to_eye[:2, :3])
    across = np.abs(np.stack([x, 0 * x, z], -1) @ frame.T) < [1, 1.5]
    np.testing.assert_array_equal(visibility == 0, across.all(axis=-1))
    covered = np.asarray(mapping.covered(ShadowMap(jnp.zeros((30, 20)), small), surface))
    np.testing.assert_array_equal(covered, across.all(axis=-1))
    # The same map, whose far plane ends above the floor.
    short = DirectionalLight((0, -1, 0), (0, 1, 0), (2, 3), -1, 0.5)
    assert (np.asarray(shadows(mapping, ShadowMap(jnp.zeros((30, 20)), short), surface)) == 1).all()
