"""Scenes written as glTF: read back by this package and by trimesh, and what cannot be written."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from gltf_scene import TRIANGLE, gltf

from diffshadow import io
from diffshadow.geometry import (
    DirectionalLight,
    MatrixCamera,
    MatrixLight,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    PointLight,
    RectangleLight,
    Scene,
    SpotLight,
)

CORNERS = np.float32([[0, 0, 0], [2, 0.1, 0], [0.3, 1.7, 0], [0.5, 0.4, 1.3]])
FACES = np.int32([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
# Flat faces of one colour, and smooth ones of several.
ROUND = CORNERS / np.linalg.norm(CORNERS + 1, axis=1, keepdims=True) + 3
SMOOTH = (CORNERS + 1) / np.linalg.norm(CORNERS + 1, axis=1, keepdims=True)
MESHES = (
    Mesh(CORNERS, FACES, albedo=(0.2, 0.4, 0.6)),
    Mesh(ROUND, FACES, SMOOTH[FACES], albedo=np.float32([[0.1] * 3, [0.9] * 3, [0.9] * 3, [0.1, 0.5, 0.9]])),
)
CAMERA = PinholeCamera((3.1, 4.2, 5.3), (0.1, 0.2, -0.3), fov_y=37.0, near=0.2, far=50.0, resolution=(30, 40))
POINTS = jnp.asarray(np.concatenate([CORNERS, ROUND]))
LIGHTS = (
    DirectionalLight.around((-1.0, -2.0, 0.5), POINTS),
    SpotLight((1.0, 6.0, 2.0), (0.2, -1.0, 0.1), 30.0, 0.5, 20.0, inner_angle=25.0),
    PointLight.around((1.0, 7.0, 3.0), POINTS),
)


def written(tmp_path, scene, name="scene.glb", **more):
    io.write_gltf(tmp_path / name, scene, **more)
    return io.read_scene(tmp_path / name)


@pytest.mark.parametrize("name", ["scene.glb", "scene.gltf"])
def test_what_is_written_is_read_back(name, tmp_path):
    origin = (1e6, 0.0, -2e6)
    scene = Scene(MESHES, CAMERA, LIGHTS, casts=(True, False), receives=(False, True), origin=origin)
    found = written(tmp_path, scene, name)
    assert found.remarks == []
    for mesh, theirs in zip(MESHES, found.meshes, strict=True):
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
        np.testing.assert_allclose(theirs.vertices[theirs.faces], vertices[faces] + origin, rtol=1e-15, atol=1e-9)
        np.testing.assert_allclose(theirs.normals[theirs.faces], mesh.corner_normals, atol=1e-6)
    assert [len(mesh.vertices) for mesh in found.meshes] == [12, 10], "corners are shared where they look alike"
    assert [(mesh.casts, mesh.receives) for mesh in found.meshes] == [(True, False), (False, True)]
    (camera,) = found.cameras
    np.testing.assert_allclose(camera.eye, np.asarray(CAMERA.eye, np.float64) + origin, rtol=1e-12)
    forward = np.asarray(CAMERA.target) - np.asarray(CAMERA.eye)
    np.testing.assert_allclose(camera.forward, forward / np.linalg.norm(forward), atol=1e-6)
    assert (camera.fov_y, camera.aspect) == pytest.approx((37.0, 4 / 3), rel=1e-6)
    assert (camera.near, camera.far) == pytest.approx((0.2, 50.0), rel=1e-6)
    assert [light.type for light in found.lights] == ["directional", "spot", "point"]
    for light, theirs in zip(LIGHTS, found.lights, strict=True):
        if theirs.direction is not None:
            way = np.asarray(light.direction) / np.linalg.norm(light.direction)
            np.testing.assert_allclose(theirs.direction, way, atol=1e-6)
        if theirs.type != "directional":
            np.testing.assert_allclose(np.subtract(theirs.position, origin), light.position, atol=1e-6)
    assert (found.lights[1].inner_angle, found.lights[1].outer_angle) == pytest.approx((25.0, 30.0), rel=1e-6)


def test_trimesh_opens_what_is_written(tmp_path):
    io.write_gltf(tmp_path / "scene.glb", Scene(MESHES, CAMERA, LIGHTS))
    opened = trimesh.load_scene(tmp_path / "scene.glb")
    np.testing.assert_allclose(opened.bounds, [POINTS.min(axis=0), POINTS.max(axis=0)], atol=1e-6)
    meshes = sorted(opened.geometry.items())
    assert [len(mesh.faces) for _, mesh in meshes] == [4, 4]
    (_, plain), (_, coloured) = meshes
    np.testing.assert_array_equal(plain.visual.material.baseColorFactor, [51, 102, 153, 255])
    assert len(np.unique(coloured.visual.vertex_attributes["color"], axis=0)) == 3


def test_what_the_format_has_no_place_for_is_in_extras(tmp_path):
    lights = [LIGHTS[0], RectangleLight.around((1.0, 6.0, 2.0), POINTS, (0.3, 0.2)), MatrixLight(*of_view(LIGHTS[1]))]
    io.write_gltf(tmp_path / "scene.gltf", Scene(MESHES, CAMERA, lights), extras={"bias.constant": 0.8})
    document = json.loads((tmp_path / "scene.gltf").read_text())
    assert document["scenes"][0]["extras"] == {"bias.constant": 0.8}
    kept = [node["extras"]["diffshadow"] for node in document["nodes"] if "light" in node["name"]]
    assert [each["type"] for each in kept] == ["DirectionalLight", "RectangleLight", "MatrixLight"]
    np.testing.assert_allclose(kept[0]["extent"], LIGHTS[0].extent)
    np.testing.assert_allclose(kept[1]["size"], (0.3, 0.2), rtol=1e-6)
    found = io.read_scene(tmp_path / "scene.gltf").lights
    assert [light.type for light in found] == ["directional", "point", "spot"]
    # Around the corners of a square frustum.
    assert found[2].outer_angle == pytest.approx(math.degrees(math.atan(2**0.5 * math.tan(math.radians(30)))), rel=1e-6)
    np.testing.assert_allclose(found[2].position, LIGHTS[1].position, atol=1e-5)


def of_view(light):
    view = light.view()
    return view.world_to_eye, view.eye_to_clip


@pytest.mark.parametrize("matrices", [False, True])
def test_parallel_cameras_are_written(matrices, tmp_path):
    camera = OrthographicCamera((3.0, 4.0, 5.0), (0.0, 0.0, 0.0), height=2.5, near=0.5, far=9.0, resolution=(20, 30))
    given = MatrixCamera(*of_view(camera), resolution=(20, 30)) if matrices else camera
    (found,) = written(tmp_path, Scene(MESHES, given, LIGHTS[0])).cameras
    assert (found.height, found.aspect, found.near, found.far) == pytest.approx((2.5, 1.5, 0.5, 9.0), rel=1e-6)
    np.testing.assert_allclose(found.eye, (3, 4, 5), atol=1e-5)


def test_what_cannot_be_written_is_refused(tmp_path):
    scene = Scene(MESHES, CAMERA, LIGHTS)
    with pytest.raises(io.FileError, match=r"its name ends with '.obj'; expected .glb or .gltf"):
        io.write_gltf(tmp_path / "scene.obj", scene)
    with pytest.raises(io.FileError, match="is not a folder; create it"):
        io.write_gltf(tmp_path / "nowhere" / "scene.glb", scene)
    with pytest.raises(TypeError, match="what to write is of type Mesh; expected a Scene"):
        io.write_gltf(tmp_path / "scene.glb", MESHES[0])
    with pytest.raises(ValueError, match="the extras have values that JSON cannot store"):
        io.write_gltf(tmp_path / "scene.glb", scene, extras={"a": float("nan")})
    off = np.array(CAMERA.view().eye_to_clip)
    off[0, 2] = 0.25
    camera = MatrixCamera(CAMERA.view().world_to_eye, off, resolution=(30, 40))
    with pytest.raises(ValueError, match=r"projection is off-centre by .* expected a centred one"):
        io.write_gltf(tmp_path / "scene.glb", Scene(MESHES, camera, LIGHTS))
    with pytest.raises(ValueError, match="the scene is traced by JAX"):
        jax.eval_shape(lambda s: io.write_gltf(tmp_path / "scene.glb", s), scene)
    assert list(tmp_path.iterdir()) == []


def test_extras_of_others_are_left_alone(tmp_path):
    for extras in ("text", {"diffshadow": 3}, {"diffshadow": {"casts": "no"}}):
        content = gltf()
        content["nodes"][0]["extras"] = extras
        (tmp_path / "scene.gltf").write_text(json.dumps(content))
        assert io.read_scene(tmp_path / "scene.gltf").meshes[0].casts


def test_a_part_without_normals_has_those_of_its_faces(tmp_path):
    document = gltf()
    document["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}}]})
    document["nodes"].append({"mesh": 1, "translation": [0, 0, 5]})
    (tmp_path / "both.gltf").write_text(json.dumps(document))
    mesh = io.load_mesh(tmp_path / "both.gltf", None)
    # The first node turns -z to +y.
    np.testing.assert_allclose(mesh.corner_normals, np.repeat([[[0, -1, 0]], [[0, 0, 1]]], 3, axis=1), atol=1e-6)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    np.testing.assert_allclose((corners[1] - (0, 0, 5)).reshape(-1), TRIANGLE, atol=1e-6)
