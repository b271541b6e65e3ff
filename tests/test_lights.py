"""Lights: what their shadow maps hold, where they lie, and what they refuse."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.geometry import DirectionalLight, PinholeCamera, SpotLight, library_mesh

SCALES = [0.01, 1.0, 100.0]


def divided(clip):
    clip = np.asarray(clip, np.float64)
    return clip[..., :3] / clip[..., 3:]


def cloud(scale, n=200):
    """Points of a box about as large as `scale`, off the origin."""
    rng = np.random.default_rng(0)
    return jnp.asarray(scale * (rng.uniform(-1, 1, (n, 3)) * [1, 0.5, 2] + [0.3, 0.5, -0.2]), jnp.float32)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("direction", [(0.3, -1, 0.2), (0, -1, 0), (1, 0, 0), (-0.5, -0.1, 3)])
def test_directional_light_around_holds_all_points_tightly(scale, direction):
    points = cloud(scale)
    light = DirectionalLight.around(jnp.array(direction, float), points)
    reach = np.abs(divided(light.view().clip(points))).max(axis=0)
    assert (reach <= 1).all()
    assert (reach >= 0.97).all()
    low, high = (f(divided(light.view().clip(points)), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose(low, -high, atol=1e-4)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("position", [(3, 5, 4), (0.3, 6, -0.2), (-20, 1, 0), (1.8, 1.2, 2.2)])
def test_spot_light_around_holds_all_points_tightly(scale, position):
    points = cloud(scale)
    light = SpotLight.around(scale * jnp.array(position, float), points)
    clip = divided(light.view().clip(points))
    assert np.abs(clip).max() <= 1
    assert np.abs(clip[:, :2]).max() >= 0.97
    depth = np.asarray(light.view().eye_depth(jnp.asarray((clip[:, 2] + 1) / 2, jnp.float32)))
    span = float(light.far - light.near)
    assert depth.min() - float(light.near) <= 0.02 * span
    assert float(light.far) - depth.max() <= 0.02 * span


def test_spot_light_around_holds_points_close_to_it():
    points = jnp.array([[0.0, -10.0, 0.0], [0.0, -0.05, 0.0], [0.01, -2.0, 0.0]])
    light = SpotLight.around(jnp.zeros(3), points)
    assert np.abs(divided(light.view().clip(points))).max() <= 1


@pytest.mark.parametrize("scale", SCALES)
def test_lights_around_a_flat_scene_hold_it(scale):
    points = scale * library_mesh("plane", segments=2).vertices
    for light in (
        DirectionalLight.around(jnp.array([0.0, -1.0, 0.0]), points),
        DirectionalLight.around(jnp.array([1.0, 0.0, 0.0]), points),
        SpotLight.around(scale * jnp.array([0.0, 2.0, 0.0]), points),
    ):
        clip = divided(light.view().clip(points))
        assert np.isfinite(clip).all()
        assert np.abs(clip).max() <= 1


def test_spot_light_inside_the_scene_needs_an_angle():
    points = cloud(1.0)
    inside = jnp.array([0.3, 0.5, 0.3])
    with pytest.raises(ValueError, match=r"stands inside the scene.*move the light or give the angle"):
        SpotLight.around(inside, points)
    light = SpotLight.around(inside, points, outer_angle=40.0)
    assert 0 < float(light.near) < float(light.far)
    assert float(light.outer_angle) == 40


@pytest.mark.parametrize("behind", [0.0, -1e4])
def test_spot_light_of_a_given_angle_holds_what_lies_ahead_of_it(behind):
    points = jnp.array([[0.0, -0.5, 0.0], [0.0, -2.0, 0.0], [0.0, -behind, 0.0]])
    light = SpotLight.around(jnp.zeros(3), points, target=jnp.array([0.0, -1.0, 0.0]), outer_angle=30.0)
    assert np.abs(divided(light.view().clip(points[:2]))).max() <= 1
    assert float(light.far) < 2.1


def test_spot_light_that_looks_away_from_the_scene_has_a_frustum():
    points = cloud(1.0)
    light = SpotLight.around(jnp.array([0.0, 9.0, 0.0]), points, target=jnp.array([0.0, 20.0, 0.0]), outer_angle=30.0)
    assert 0 < float(light.near) < float(light.far)
    assert np.isfinite(light.view().matrix).all()


def test_spot_light_around_looks_at_its_target():
    points = cloud(1.0)
    light = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, target=jnp.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(light.direction, [-2, -5, -4])
    assert np.abs(divided(light.view().clip(points))).max() <= 1


def test_lights_lie_where_towards_says():
    points = cloud(1.0, n=5)
    sun = DirectionalLight.around(jnp.array([0.0, -2.0, 0.0]), points)
    np.testing.assert_allclose(sun.towards(points), np.broadcast_to([0, 1, 0], (5, 3)), atol=1e-6)
    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points)
    np.testing.assert_allclose(points + lamp.towards(points), np.broadcast_to([3, 5, 4], (5, 3)), rtol=1e-6)
    assert sun.is_directional
    assert not lamp.is_directional
    assert not sun.has_size
    assert not lamp.has_size


def test_points_of_a_lights_disk_lie_on_it():
    points, rim = cloud(1.0, n=8), np.linspace(0, 2 * np.pi, 8, endpoint=False)
    disk = jnp.asarray(np.stack([np.cos(rim), np.sin(rim)], axis=-1), jnp.float32)
    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points, radius=0.25)
    offset = np.asarray(lamp.towards(points, disk) - lamp.towards(points))
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), 0.25, rtol=1e-4)
    np.testing.assert_allclose(offset @ np.asarray(lamp.direction), 0, atol=1e-5)
    np.testing.assert_allclose(offset.sum(axis=0), 0, atol=1e-5)
    sun = DirectionalLight.around(jnp.array([1.0, -2.0, 0.5]), points, angular_radius=2.0)
    ways, axis = np.asarray(sun.towards(points, disk)), -np.asarray(sun.direction)
    cosine = ways @ axis / np.linalg.norm(ways, axis=-1) / np.linalg.norm(axis)
    np.testing.assert_allclose(np.rad2deg(np.arccos(cosine)), 2.0, rtol=1e-3)
    assert sun.has_size
    assert lamp.has_size


def test_bad_lights_are_refused():
    points = cloud(1.0)
    sun = DirectionalLight.around(jnp.array([0.0, -1.0, 0.0]), points)
    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), points)
    sun_options = {name: getattr(sun, name) for name in ("direction", "center", "extent", "near", "far")}
    lamp_options = {name: getattr(lamp, name) for name in ("position", "direction", "outer_angle", "near", "far")}
    for kind, options, bad, message in [
        (
            DirectionalLight,
            sun_options,
            {"direction": (0, 0, 0)},
            r"direction is \[0\.0, 0\.0, 0\.0\]; expected a finite",
        ),
        (DirectionalLight, sun_options, {"direction": (math.nan, 0, 0)}, "expected a finite vector"),
        (DirectionalLight, sun_options, {"near": 5.0, "far": 5.0}, "near = 5.0 and far = 5.0"),
        (DirectionalLight, sun_options, {"extent": (1.0, 0.0)}, "expected positive world units"),
        (DirectionalLight, sun_options, {"angular_radius": 90.0}, r"expected degrees in \[0, 90\)"),
        (SpotLight, lamp_options, {"direction": (0, 0, 0)}, "spot light's direction"),
        (SpotLight, lamp_options, {"near": 0.0}, "expected 0 < near < far"),
        (SpotLight, lamp_options, {"near": 9.0, "far": 1.0}, "near = 9.0 and far = 1.0"),
        (SpotLight, lamp_options, {"outer_angle": 90.0}, "expected degrees between 0 and 90"),
        (SpotLight, lamp_options, {"radius": -1.0}, "expected world units, 0 or more"),
    ]:
        with pytest.raises(ValueError, match=message):
            kind(**(options | bad))
    with pytest.raises(ValueError, match="direction is"):
        DirectionalLight.around(jnp.zeros(3), points)
    with pytest.raises(ValueError, match="eye and target are both"):
        SpotLight.around(jnp.ones(3), points, target=jnp.ones(3))


def test_lights_and_cameras_can_be_traced():
    def depth_of_origin(height):
        camera = PinholeCamera(jnp.array([0.0, height, 3.0]), jnp.zeros(3))
        light = eqx.tree_at(lambda x: x.position, lamp, jnp.array([3.0, height, 4.0]))
        return camera.view().clip(jnp.zeros(3))[3] + light.view().clip(jnp.zeros(3))[3]

    lamp = SpotLight.around(jnp.array([3.0, 5.0, 4.0]), cloud(1.0))
    gradient = jax.jit(jax.grad(depth_of_origin))(5.0)
    # The camera turns to the origin, at distance √(h² + 3²); the light only moves along its direction's slope.
    slope = -float(lamp.direction[1] / jnp.linalg.norm(lamp.direction))
    assert float(gradient) == pytest.approx(5 / math.hypot(5, 3) + slope, rel=1e-4)
