"""Scenes: which meshes cast, where their origin is, and what is refused."""

import warnings

import numpy as np
import pytest

from diffshadow.geometry import (
    WORLD,
    DirectionalLight,
    Mesh,
    PinholeCamera,
    PrecisionWarning,
    Scene,
    library_mesh,
    origin_of,
)

BOX, PLANE, BALL = library_mesh("box"), library_mesh("plane"), library_mesh("sphere", subdivisions=1)
CAMERA = PinholeCamera((0, 1, 5), (0, 0, 0))
SUN = DirectionalLight((0, -1, 0), (0, 0, 0), (4, 4), -4, 4)


def test_a_single_mesh_casts_and_is_the_whole_scene():
    scene = Scene(BOX, CAMERA, SUN)
    assert scene.mesh is scene.casters is BOX
    assert scene.receivers is None
    assert scene.casting_faces.all()


def test_casters_and_receivers_are_parts_of_the_mesh():
    scene = Scene([PLANE, BOX, BALL], CAMERA, SUN, casts=(False, True, False))
    corners = lambda mesh: np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    whole, casting = corners(scene.mesh), scene.casting_faces
    np.testing.assert_array_equal(whole[casting], corners(scene.casters))
    np.testing.assert_array_equal(whole[~casting], corners(scene.receivers))
    np.testing.assert_array_equal(corners(scene.casters), corners(BOX))
    assert scene.lit_by(0).casts == (False, True, False)


@pytest.mark.parametrize(
    ("meshes", "casts", "message"),
    [
        ([], None, "the scene has no mesh; expected a mesh, or several"),
        ([BOX, PLANE], (True,), "casts has 1 entry, and the scene has 2 meshes; expected one each"),
        ([BOX, PLANE], (False, False), "no mesh of the scene casts shadows; expected at least one"),
    ],
)
def test_scenes_without_casters_are_refused(meshes, casts, message):
    with pytest.raises(ValueError, match=message):
        Scene(meshes, CAMERA, SUN, casts)


@pytest.mark.parametrize("far", [0, 90, -90])
def test_a_scene_near_the_worlds_origin_is_counted_from_there(far):
    points = np.array([[-3.0, 0, -3], [3, 2, 3]])
    assert origin_of(points + far) == WORLD


def test_the_origin_of_a_far_scene_is_a_round_number_in_its_middle():
    points = np.array([[-3.0, 0, -3], [3, 2, 3]])
    # Steps are no smaller than the scene, so that a scene moved by whole steps keeps its coordinates to the bit.
    assert origin_of(points + np.array([6e5, 0, -8e6])) == (6e5, 0, -8e6)
    assert origin_of(points + np.array([600001.3, 1e4, 0])) == (6e5, 1e4, 0)
    assert origin_of(points + np.array([600003.2, 1e4, 0])) == (6e5, 1e4, 0)
    assert origin_of(1e-3 * points + np.array([123.456, 0, 0])) == pytest.approx((123.456, 0, 0), abs=0.005)


def test_a_scene_too_far_for_single_precision_is_warned_about_once():
    at = lambda far: Mesh(np.asarray(BOX.vertices, np.float64) + far, BOX.faces, BOX.corner_normals)
    with pytest.warns(PrecisionWarning, match=r"1 world units wide.*steps of 0.0078.*a point such as \[100000.0, 0.0,"):
        Scene([at([1e5, 0, 0])], CAMERA, SUN)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Scene([at([1e2, 0, 0])], CAMERA, SUN)
        Scene([at(0)], CAMERA, SUN, origin=(1e5, 0, 0))


@pytest.mark.parametrize("origin", [(0.0, 0.0), (0.0, 0.0, np.nan)])
def test_an_origin_that_is_no_point_is_refused(origin):
    with pytest.raises(ValueError, match=r"the scene's origin is .* expected three finite world coordinates"):
        Scene([BOX], CAMERA, SUN, origin=origin)
