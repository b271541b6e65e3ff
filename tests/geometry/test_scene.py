"""Scenes: which meshes cast, and what is refused."""

import numpy as np
import pytest

from diffshadow.geometry import DirectionalLight, PinholeCamera, Scene, library_mesh

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
        ([BOX, PLANE], (True,), "casts has 1 entries, and the scene has 2 meshes; expected one each"),
        ([BOX, PLANE], (False, False), "no mesh of the scene casts shadows; expected one that does"),
    ],
)
def test_scenes_without_casters_are_refused(meshes, casts, message):
    with pytest.raises(ValueError, match=message):
        Scene(meshes, CAMERA, SUN, casts)
