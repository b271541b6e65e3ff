"""Poses of cameras: where they look after a turn, and that a pose at rest changes nothing."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.geometry import CameraPose, MatrixCamera, OrthographicCamera, PinholeCamera, Vector

EYE, TARGET = (1.0, 2.0, 3.0), (0.2, -0.1, 0.4)
PINHOLE = PinholeCamera(EYE, TARGET, fov_y=50, near=0.5, far=9, resolution=(24, 32))
CAMERAS = {
    "pinhole": PINHOLE,
    "orthographic": OrthographicCamera(EYE, TARGET, height=3, near=0.5, far=9, resolution=(24, 32)),
    "matrix": MatrixCamera(PINHOLE.view().world_to_eye, PINHOLE.projection(), (24, 32)),
}


def axes(camera):
    """Right, up and backward of a camera, in the world."""
    return np.asarray(camera.view().world_to_eye)[:3, :3]


def turned(camera, **degrees):
    return camera.at(dataclasses.replace(camera.pose(), turn=Vector(**degrees)))


@pytest.mark.parametrize("name", CAMERAS)
def test_a_camera_at_its_own_pose_sees_the_same(name):
    camera = CAMERAS[name]
    again = camera.at(camera.pose())
    assert type(again) is type(camera)
    np.testing.assert_allclose(again.view().matrix, camera.view().matrix, atol=2e-6)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("axis", "moving", "towards"), [("x", 2, 1), ("y", 0, 2), ("z", 1, 0)])
def test_a_turn_rotates_the_other_axes_by_its_angle(name, axis, moving, towards):
    """By 30 degrees, in the camera's own axes: a turn about x moves backward away from up, and so on."""
    camera = CAMERAS[name]
    before, after = axes(camera), axes(turned(camera, **{axis: 30.0}))
    fixed = "xyz".index(axis)
    np.testing.assert_allclose(after[fixed], before[fixed], atol=1e-6)
    np.testing.assert_allclose(after[moving] @ before[moving], np.cos(np.pi / 6), atol=1e-6)
    np.testing.assert_allclose(after[moving] @ before[towards], -np.sin(np.pi / 6), atol=1e-6)
    np.testing.assert_allclose(turned(camera, **{axis: 30.0}).eye, camera.eye, atol=1e-5)


def test_a_turn_about_x_looks_up_and_one_about_y_to_the_left():
    right, up, _ = axes(PINHOLE)
    assert -axes(turned(PINHOLE, x=10.0))[2] @ up > 0.1
    assert -axes(turned(PINHOLE, y=10.0))[2] @ right < -0.1
    assert axes(turned(PINHOLE, z=10.0))[1] @ right < -0.1


def test_a_pose_moves_the_eye_and_changes_the_field_of_view():
    pose = CameraPose(Vector(4.0, 5.0, 6.0), Vector(), fov_y=jnp.asarray(30.0))
    moved = PINHOLE.at(pose)
    np.testing.assert_allclose(moved.eye, [4, 5, 6])
    np.testing.assert_allclose(axes(moved), axes(PINHOLE), atol=1e-6)
    assert float(moved.fov_y) == 30
    # The target stays as far away as it was.
    np.testing.assert_allclose(np.linalg.norm(moved.target - moved.eye), np.linalg.norm(np.subtract(EYE, TARGET)))
