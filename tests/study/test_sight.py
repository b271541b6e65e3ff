"""Cameras and lights that see nothing: which cause is named. Nothing here is drawn."""

import jax.numpy as jnp
import pytest

from diffshadow.config import build_scene, parse_config
from diffshadow.raster import Surface
from diffshadow.study.remarks._sight import blind_camera, blind_light

SCENE = """
scene:
  meshes:
    - {path: builtin:box}
    - {path: builtin:plane, options: {size: 4}}
  camera: {resolution: [4, 4]}
"""


def scene_of(*overrides):
    config = parse_config(SCENE, overrides)
    return config, build_scene(config)


def surface_at(*points, seen=True):
    """What a camera sees that looks at these points."""
    position = jnp.asarray(points, jnp.float32).reshape(1, -1, 3)
    face = jnp.full(position.shape[:2], 0 if seen else -1, jnp.int32)
    return Surface(position, position, position, position, face, face >= 0)


NOTHING = surface_at([0, 0, 0], seen=False)


@pytest.mark.parametrize(
    ("camera", "cause"),
    [
        ("{eye: [0, 0.5, 0], target: [9, 0.5, 0]}", "its eye is inside scene.meshes.0 (builtin:box)"),
        (
            "{eye: [3, 3, 3], target: [0, 0, 0], near: 50, far: 60}",
            "its target is 5.2 world units away; its near is 50",
        ),
        ("{eye: [3, 3, 3], target: [0, 0, 0], near: 1, far: 2}", "its target is 5.2 world units away"),
        ("{eye: [3, 3, 3], target: [0, 0.5, 0]}", "no triangle covers one"),
        ("{eye: [3, 3, 3], target: [0, 0, 0], near: 1e-30}", "single precision cannot distinguish depths"),
        ("{eye: [1e9, 1e9, 1e9], target: [0, 0, 0]}", "no triangle covers one"),
    ],
)
def test_camera_that_sees_nothing_names_the_cause(camera, cause):
    said = blind_camera(*scene_of(f"scene.camera={camera}"), NOTHING)
    assert said is not None
    assert cause in said
    assert "and the scene's size is 5.74 world units; expected a part of the scene in sight; " in said


def test_near_that_follows_from_a_far_mesh_is_reported():
    said = blind_camera(*scene_of("scene.meshes.0.translate=[1e6, 0, 0]", "scene.camera.orbit={}"), NOTHING)
    assert said is not None
    assert "its target is 2.17 world units away; its near is " in said
    assert "check the sizes and positions of the meshes" in said


def test_camera_that_sees_a_surface_has_no_cause():
    assert blind_camera(*scene_of(), surface_at([0, 1, 0])) is None


@pytest.mark.parametrize(
    ("light", "cause", "mend"),
    [
        (
            "{type: spot, position: [0, 0.5, 0], target: [0, 0, 0], outer_angle: 40}",
            "of 2 pixels with a surface, 2 are behind it, and it is inside scene.meshes.0 (builtin:box)",
            "move it out of that mesh, change its target",
        ),
        (
            "{type: spot, position: [0, 5, 0], target: [0, 9, 0], outer_angle: 40}",
            "2 are behind it;",
            "change its target",
        ),
        ("{type: spot, position: [0, 5, 0], near: 1, far: 2}", "2 are beyond its far;", "raise its far"),
        (
            "{type: spot, position: [9, 5, 0], target: [9, 0, 0], outer_angle: 9}",
            "2 are to the side of its frustum;",
            "outer_angle",
        ),
        # Far from both of its planes.
        (
            "{type: spot, position: [9, 5, 0], target: [9, 0, 0], outer_angle: 9, near: 0.1, far: 50}",
            "2 are to the side of its frustum;",
            "outer_angle",
        ),
        (
            "{type: spot, position: [1e9, 1e9, 0]}",
            "none is within its frustum, because single precision",
            "move it nearer",
        ),
        ("{type: point, position: [0, 5, 0], near: 1, far: 2}", "2 are beyond its far;", "raise its far"),
    ],
)
def test_light_that_misses_what_is_seen_names_the_cause(light, cause, mend):
    said = blind_light(*scene_of(f"scene.light={light}"), surface_at([0, 1, 0], [0.2, 1, 0.1]))
    assert cause in said
    assert mend in said
    assert "and the scene's size is 5.74 world units; expected a surface that both see" in said


def test_bias_that_moves_receivers_out_of_the_frustum_is_named():
    said = blind_light(*scene_of("bias.normal_offset=4000"), surface_at([0, 1, 0]))
    assert "a normal_offset of 4000 texels moves all out of its frustum" in said
    assert "lower bias.normal_offset" in said


def test_point_beside_or_below_a_mesh_is_not_inside_it():
    # Half of all directions from below the plane's middle meet it, as far as it reaches.
    for eye in ([0, -0.001, 0.1], [0, 1.01, 0], [0.51, 0.5, 0.3]):
        said = blind_camera(*scene_of(f"scene.camera={{eye: {eye}, target: [0, 0.4, 0]}}"), NOTHING)
        assert said is not None
        assert "inside" not in said
