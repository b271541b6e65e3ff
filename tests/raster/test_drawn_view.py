"""Images of cameras whose near and far distances leave window depth few digits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import quad, sun

from diffshadow.geometry import (
    MatrixCamera,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    Scene,
    library_mesh,
    merge,
    translation,
)
from diffshadow.raster import draw_antialiased, draw_surface, drawn_view
from diffshadow.shadow import ShadowVolumes

RESOLUTION = (40, 56)
EYE, TARGET = (0.3, 2.0, 3.0), (0.0, 0.3, 0.0)
# Folded, over a floor that reaches behind the eye; and a wall behind the eye, which is not seen.
FLOOR = quad((0, 0, 0), (9, 0, 0), (0, 0, -9))
SCENE = merge([library_mesh("torus_knot").transformed(translation(jnp.array([0, 0.5, 0]))), FLOOR])
IN_MILLIMETRES = Mesh(1000 * SCENE.vertices, SCENE.faces)


def pinhole(near, far=20.0, scale=1.0):
    eye, target = (scale * np.array(point) for point in (EYE, TARGET))
    return PinholeCamera(eye, target, fov_y=40, near=near, far=far, resolution=RESOLUTION)


def parallel(near, far):
    return OrthographicCamera(EYE, TARGET, height=3, near=near, far=far, resolution=RESOLUTION)


def faces(mesh, camera):
    return np.asarray(draw_surface(mesh, camera).face)


@pytest.mark.parametrize("near", [1e-2, 1e-6, 1e-7, 1e-20])
def test_a_small_near_distance_changes_no_face(near):
    np.testing.assert_array_equal(faces(SCENE, pinhole(near)), faces(SCENE, pinhole(0.5)))


def test_a_near_distance_in_the_wrong_unit_changes_no_face():
    expected = faces(IN_MILLIMETRES, pinhole(500.0, 20e3, 1000.0))
    np.testing.assert_array_equal(faces(IN_MILLIMETRES, pinhole(0.02, 20e3, 1000.0)), expected)


def test_a_matrix_camera_with_a_small_near_distance_changes_no_face():
    view = pinhole(1e-4).view()
    camera = MatrixCamera(view.world_to_eye, view.eye_to_clip, RESOLUTION)
    np.testing.assert_array_equal(faces(SCENE, camera), faces(SCENE, pinhole(0.5)))


@pytest.mark.parametrize(("near", "far"), [(-1e7, 1e7), (0.1, 1e8)])
def test_a_deep_parallel_window_changes_no_face(near, far):
    np.testing.assert_array_equal(faces(SCENE, parallel(near, far)), faces(SCENE, parallel(0.1, 30.0)))


def test_what_lies_before_the_near_plane_and_beyond_the_far_plane_stays_cut_away():
    # Upright to the view axis, 0.6 before the eye.
    wall = quad((0.248, 1.705, 2.48), (1, 0, -0.1), (0, 0.867, -0.491))
    both = merge([SCENE, wall])
    for camera in (pinhole(1.2), parallel(1.2, 1e8)):
        np.testing.assert_array_equal(faces(both, camera), faces(SCENE, camera))
    assert np.all(faces(both, pinhole(1e-6)) >= len(SCENE.faces))
    behind = faces(SCENE, pinhole(1e-6, 3.5))
    np.testing.assert_array_equal(behind, faces(SCENE, pinhole(0.5, 3.5)))
    assert 0.05 < np.mean(behind < 0) < 0.95


def test_a_small_near_distance_changes_no_face_before_a_surface_close_to_the_eye():
    """The image shows a card a hundredth of the scene's distance away, and the floor up to 9 away."""
    card = quad((0.283, 1.97, 2.96), (0.008, 0, -0.0008), (0, 0.00694, -0.00393))
    both = merge([SCENE, card])
    expected = faces(both, pinhole(0.02))
    np.testing.assert_array_equal(faces(both, pinhole(1e-7)), expected)
    assert 0.02 < np.mean(expected >= len(SCENE.faces)) < 0.5


def test_near_is_raised_to_a_part_of_the_nearest_surface():
    # Straight above the floor's edge: the nearest surface that the image shows lies in its lower corners.
    camera = PinholeCamera((0, 2, 0), (0, 0, -2), fov_y=60, near=1e-5, far=50, resolution=(32, 32))
    view = drawn_view(camera.view(), quad((0, 0, 0), (9, 0, 0), (0, 0, -9)))
    # The plane lies 2 below the eye; rays through corners leave the axis by atan(√2 tan 30°).
    assert float(view.near) == pytest.approx(2 / np.sqrt(1 + 2 * np.tan(np.pi / 6) ** 2) / 2, rel=1e-5)


@pytest.mark.parametrize("is_gpu", [False, True])
def test_a_view_whose_depths_are_fine_stays_as_it_is(is_gpu, monkeypatch):
    """On GPUs, a program finds this out, since vertices are not copied to the host."""
    monkeypatch.setattr("diffshadow.raster._drawn_view.is_on_gpu", lambda: is_gpu)
    for camera in (pinhole(0.3), parallel(0.1, 30.0)):
        view = camera.view()
        assert (drawn_view(view, SCENE) is view) == (not is_gpu)
        for found, given in zip(jax.tree.leaves(drawn_view(view, SCENE)), jax.tree.leaves(view), strict=True):
            np.testing.assert_array_equal(found, given)
    moved = drawn_view(pinhole(1e-6).view(), SCENE)
    assert float(moved.near) > 0.1


def test_a_traced_camera_sees_the_same_faces_and_keeps_its_gradient():
    @jax.jit
    def seen(near, x):
        eye = jnp.array([x, *EYE[1:]])
        surface = draw_surface(SCENE, PinholeCamera(eye, TARGET, fov_y=40, near=near, far=20, resolution=RESOLUTION))
        return jnp.mean(surface.position[..., 0]), surface.face

    along = lambda near: jax.jvp(lambda x: seen(near, x), (jnp.float32(EYE[0]),), (jnp.float32(1),))
    ((_, face), (slope, _)), ((_, expected), (expected_slope, _)) = along(1e-7), along(0.5)
    np.testing.assert_array_equal(face, expected)
    assert float(slope) == pytest.approx(float(expected_slope), rel=1e-5)
    assert abs(float(slope)) > 0.01


def test_antialiased_pictures_and_shadow_volumes_do_not_depend_on_a_small_near_distance():
    mesh = merge([library_mesh("box"), FLOOR])
    drawn = [draw_antialiased(mesh, pinhole(near)) for near in (1e-7, 0.5)]
    images = [np.asarray(each.resolve(each.surface.position)) for each in drawn]
    np.testing.assert_allclose(*images, atol=1e-5)
    for method in ("z_fail", "z_pass"):
        technique = ShadowVolumes(method)
        lit = []
        for near in (1e-7, 0.5):
            scene = Scene([library_mesh("box"), FLOOR], pinhole(near), sun(mesh))
            lit.append(np.asarray(technique.visibility(technique.prepare(scene))))
        np.testing.assert_array_equal(*lit)
        assert 0.02 < np.mean(lit[0] == 0) < 0.5
