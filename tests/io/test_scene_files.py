"""Scenes from files: what three.js and glTF store, and the message for each thing that can be wrong."""

import base64
import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from gltf_scene import TRIANGLE, gltf
from scipy.spatial.transform import Rotation

from diffshadow.geometry import face_normals
from diffshadow.io import FileError, MeshWarning, load_mesh, read_scene, write_ply
from diffshadow.io.scenes._three_geometries import GEOMETRIES, build_geometry

FOLDER = Path(__file__).parents[1] / "golden" / "imports"
SHAPES = json.loads((FOLDER / "shapes.json").read_text())
EXPECTED = json.loads((FOLDER / "expected.json").read_text())


def test_every_shape_is_tested():
    assert {shape["type"] for shape in SHAPES} == set(GEOMETRIES)


@pytest.mark.parametrize("index", range(len(SHAPES)))
def test_a_shape_has_the_engines_vertices_normals_and_triangles(index):
    shape = SHAPES[index]
    made, geometry = shape["made"], build_geometry(shape["type"], shape)
    vertices, normals = (np.reshape(made[name], (-1, 3)) for name in ("position", "normal"))
    np.testing.assert_allclose(geometry.vertices, vertices, atol=3e-7)
    np.testing.assert_allclose(geometry.normals, normals, atol=3e-7)
    corners = np.arange(len(vertices)) if made["index"] is None else made["index"]
    np.testing.assert_array_equal(geometry.faces.reshape(-1), corners)
    groups = [(group["start"], group["count"], group["materialIndex"]) for group in made["groups"]]
    assert [(3 * first, 3 * count, number) for first, count, number in geometry.groups] == groups


@pytest.mark.parametrize("name", EXPECTED)
def test_meshes_stand_where_the_engine_places_them(name):
    scene = read_scene(FOLDER / f"{name}.json")
    seen = [mesh for mesh in scene.meshes if mesh.layers & scene.cameras[0].layers]
    found = np.concatenate(
        [np.concatenate([mesh.vertices[mesh.faces], mesh.normals[mesh.faces]], axis=-1).reshape(-1, 6) for mesh in seen]
    )
    begin = 0
    for mesh in EXPECTED[name]["meshes"]:
        rows = found[begin : begin + mesh["count"]][:: mesh["every"]]
        expected = np.array(mesh["rows"])
        if mesh["name"] == "mirrored":
            # The winding is reversed, so that the front stays in front.
            rows = found[begin : begin + mesh["count"]].reshape(-1, 3, 6)[:, ::-1].reshape(-1, 6)[:: mesh["every"]]
        np.testing.assert_allclose(rows, expected, atol=2e-6)
        begin += mesh["count"]
    assert begin == len(found)


def test_faces_of_a_mirrored_mesh_turn_outwards():
    scene = read_scene(FOLDER / "yard.json")
    (mesh,) = (mesh for mesh in scene.meshes if mesh.name == "mirrored")
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert ((np.cross(b - a, c - a) * mesh.normals[mesh.faces].sum(axis=1)).sum(axis=-1) > 0).all()


def test_materials_name_the_sides():
    sides = {mesh.name: (mesh.side, mesh.shadow_side) for mesh in read_scene(FOLDER / "yard.json").meshes}
    assert sides["sheet 0"] == ("double", None)
    assert sides["sheet 1"] == ("front", "front")
    assert not next(mesh for mesh in read_scene(FOLDER / "stage.json").meshes if mesh.name == "ball").casts


# --- What older releases leave out, and what is left out ---

BOX = {"uuid": "g", "type": "BoxGeometry"}
SKIN = {"uuid": "m", "type": "MeshStandardMaterial"}
MESH = {"type": "Mesh", "name": "box", "geometry": "g", "material": "m", "castShadow": True, "receiveShadow": True}
SUN = {
    "type": "DirectionalLight",
    "name": "sun",
    "castShadow": True,
    "matrix": [1, *[0] * 4, 1, *[0] * 4, 1, 0, 2, 3, 4, 1],
}
EYE = {"type": "PerspectiveCamera", "name": "eye", "position": [0, 1, 5]}
PLAIN = {"metadata": {"version": 4.5, "type": "Object"}, "geometries": [BOX], "materials": [SKIN]}


def stored(tmp_path, *children, **changes):
    content = {**PLAIN, "object": {"type": "Scene", "children": list(children)}, **changes}
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(content))
    return path


def test_a_light_that_shines_at_itself_is_remarked(tmp_path):
    target = {"uuid": "t", "type": "Object3D", "matrix": SUN["matrix"]}
    scene = read_scene(stored(tmp_path, MESH, {**SUN, "target": "t"}, target, EYE))
    assert scene.lights[0].direction == (0, 0, -1)
    assert any(remark.startswith("sun: its target is at its own position") for remark in scene.remarks)
    scene = read_scene(stored(tmp_path, MESH, {**SUN, "target": "t"}, {**target, "matrix": None}, EYE))
    assert not any("where it stands" in remark for remark in scene.remarks)


def test_normals_of_a_skin_stay_upright_on_its_surface(tmp_path):
    """The joint turns and stretches the mesh. The normals must be the normals of the moved faces."""
    content = gltf()
    slant = np.array([(0, 0, 0), (1, 0, 1), (0, 1, 0)], "<f4")
    normal = np.array([-1, 0, 1]) / math.sqrt(2)
    data = np.concatenate([slant.reshape(-1), np.tile(normal, 3).astype("<f4"), np.tile([1, 0, 0, 0], 3).astype("<f4")])
    data = data.tobytes() + bytes(12)
    content["buffers"] = [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}]
    content["bufferViews"] = [{"buffer": 0, "byteLength": len(data)}]
    joints = {"bufferView": 0, "byteOffset": 120, "componentType": 5121, "count": 3, "type": "VEC4"}
    content["accessors"] += [joints, {**joints, "byteOffset": 72, "componentType": 5126}]
    content["meshes"][0]["primitives"][0]["attributes"] |= {"JOINTS_0": 2, "WEIGHTS_0": 3}
    content["nodes"][0]["skin"] = 0
    content["nodes"].append({"rotation": [0, 0.6, 0, 0.8], "scale": [1, -2, 4], "translation": [0, 3, 0]})
    content["skins"] = [{"joints": [len(content["nodes"]) - 1]}]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(content))
    mesh = load_mesh(path, None)
    turn = Rotation.from_quat([0, 0.6, 0, 0.8])
    expected = np.array([0, 3, 0]) + turn.apply(slant * [1, -2, 4])
    order = [np.abs(expected - vertex).sum(axis=1).argmin() for vertex in np.asarray(mesh.vertices)]
    np.testing.assert_allclose(mesh.vertices, expected[order], atol=1e-6)
    np.testing.assert_allclose(mesh.corner_normals[0], np.tile(face_normals(mesh), (3, 1)), atol=1e-6)
    # The mirror turns its face's corners, not its outside.
    assert np.asarray(mesh.corner_normals)[0, 0] @ turn.apply(normal / [1, -2, 4]) > 0


def test_left_out_settings_are_the_engines_defaults(tmp_path):
    spot, point = ({**SUN, "type": f"{kind}Light"} for kind in ("Spot", "Point"))
    scene = read_scene(stored(tmp_path, MESH, SUN, spot, point, EYE))
    sun, spot, point = (light.shadow for light in scene.lights)
    for shadow in (sun, spot, point):
        assert (shadow.near, shadow.far, shadow.map_size, shadow.radius, shadow.intensity) == (
            0.5,
            500,
            (512, 512),
            1,
            1,
        )
        assert shadow.bias == shadow.normal_bias == 0
        assert shadow.blur_samples == 8
    assert sun.window == (-5, 5, 5, -5)
    assert spot.half_angle == pytest.approx(60)
    assert scene.lights[0].position == (2, 3, 4)
    assert scene.lights[0].direction == (-2, -3, -4)
    assert (scene.cameras[0].fov_y, scene.cameras[0].near, scene.cameras[0].far) == (pytest.approx(50), 0.1, 2000)
    assert "sun: its target is not in the scene, so the origin is used" in scene.remarks


def test_a_lights_range_replaces_far_and_zoom_narrows(tmp_path):
    shadow = {
        "camera": {"near": 1, "far": 9, "left": -1, "right": 3, "zoom": 2},
        "focus": 0.5,
        "mapSize": [64, 32],
        "aspect": 3,
    }
    sun, spot, lamp = (
        {**SUN, "type": f"{kind}Light", "distance": 7, "angle": 0.8, "shadow": shadow}
        for kind in ("Directional", "Spot", "Point")
    )
    wide = {**EYE, "zoom": 2, "fov": 90}
    flat = {"type": "OrthographicCamera", "left": -1, "right": 3, "top": 2, "bottom": -1, "zoom": 2}
    scene = read_scene(stored(tmp_path, MESH, sun, spot, lamp, wide, flat))
    sun, spot, lamp = (light.shadow for light in scene.lights)
    assert (sun.far, spot.far, lamp.far) == (9, 7, 7)
    assert sun.window == (0, 2, 2.5, -2.5)
    assert math.tan(math.radians(spot.half_angle)) == pytest.approx(math.tan(0.4) / 2)
    assert spot.aspect == pytest.approx(6)
    assert math.tan(math.radians(scene.cameras[0].fov_y) / 2) == pytest.approx(0.5)
    flat = scene.cameras[1]
    assert (flat.height, flat.aspect, flat.eye) == (1.5, pytest.approx(4 / 3), (1, 0.5, 0))


def test_every_kind_of_thing_that_is_left_out_is_named(tmp_path):
    skin = {**SKIN, "alphaTest": 0.5, "map": "t", "displacementMap": "d", "transparent": True, "opacity": 0.5}
    unlit = {"uuid": "u", "type": "MeshBasicMaterial"}
    shader = {"uuid": "s", "type": "ShaderMaterial"}
    soup = {
        "uuid": "b",
        "type": "BufferGeometry",
        "data": {"attributes": {"position": {"itemSize": 3, "array": [0, 0, 0, 1, 0, 0, 0, 1, 0]}}},
    }
    children = [
        MESH,
        {**MESH, "type": "SkinnedMesh", "name": "skinned", "geometry": "b"},
        {**MESH, "name": "unlit", "material": "u"},
        {**MESH, "name": "shader", "material": "s"},
        *({"type": kind} for kind in ("HemisphereLight", "Points", "Sprite", "BatchedMesh")),
        {**EYE, "view": {"enabled": True}},
    ]
    scene = read_scene(stored(tmp_path, *children, geometries=[BOX, soup], materials=[skin, unlit, shader]))
    said = "\n".join(scene.remarks)
    for word in (
        "alpha test",
        "texture",
        "displacement",
        "transparent",
        "skinned: its skin",
        "skinned: it has no normals",
    ):
        assert word in said
    for word in (
        "unlit: its MeshBasicMaterial",
        "shader: its ShaderMaterial",
        "view offset",
        "hemisphere",
        "cloud",
        "sprite",
    ):
        assert word in said
    assert "batched mesh" in said


def test_what_is_hidden_is_left_out_and_named(tmp_path):
    group = {"type": "Group", "visible": False, "children": [{**MESH, "name": "ghost"}, {**SUN, "name": "moon"}]}
    scene = read_scene(stored(tmp_path, MESH, {**MESH, "name": "twin", "visible": False}, group))
    assert [mesh.name for mesh in scene.meshes] == ["box"]
    assert scene.lights == []
    assert "twin, ghost, moon: visible = false, here or in a group around; left out" in scene.remarks


def test_only_the_finest_level_of_detail_is_drawn(tmp_path):
    fine, coarse = {**MESH, "uuid": "1", "name": "fine"}, {**MESH, "uuid": "2", "name": "coarse"}
    levels = [{"object": "2", "distance": 10}, {"object": "1", "distance": 0}]
    scene = read_scene(stored(tmp_path, {"type": "LOD", "levels": levels, "children": [coarse, fine]}))
    assert [mesh.name for mesh in scene.meshes] == ["fine"]


def test_an_editors_project_holds_its_camera_apart(tmp_path):
    inner = {**PLAIN, "object": {"type": "Scene", "children": [MESH, SUN]}}
    path = tmp_path / "project.json"
    path.write_text(json.dumps({"project": {}, "scene": inner, "camera": {"object": EYE}}))
    scene = read_scene(path)
    assert (len(scene.meshes), len(scene.lights), scene.cameras[0].name) == (1, 1, "eye")


def test_a_scene_of_unmoved_objects_is_remarked(tmp_path):
    still = {**SUN, "matrix": [1, *[0] * 4, 1, *[0] * 4, 1, 0, 0, 1, 0, 1]}
    scene = read_scene(stored(tmp_path, MESH, still))
    assert any("updateMatrixWorld" in remark for remark in scene.remarks)


def soup_of(attributes, **rest):
    return {"uuid": "g", "type": "BufferGeometry", "data": {"attributes": attributes, **rest}}


POSITION = {"itemSize": 3, "type": "Float32Array", "array": TRIANGLE}


def test_normalized_integers_are_fractions(tmp_path):
    position = {
        "itemSize": 3,
        "type": "Int16Array",
        "array": [-32767, 0, 0, 32767, 0, 0, 0, 32767, 0],
        "normalized": True,
    }
    scene = read_scene(stored(tmp_path, MESH, geometries=[soup_of({"position": position})]))
    np.testing.assert_allclose(scene.meshes[0].vertices[:, 0], [-1, 1, 0])


FAULTS = {
    "no JSON": ("{", "is neither JSON nor GLB"),
    "a list": ("[]", "a JSON value that is not an object"),
    "something else": ('{"a": 1}', "it has neither object nor asset"),
    "a lone geometry": ('{"metadata": {"type": "BufferGeometry"}}', "its metadata.type is 'BufferGeometry'"),
    "an old format": ('{"metadata": {"version": 3}, "object": {}}', "is of three.js' format 3"),
    "a broken matrix": ('{"object": {"matrix": [1, 2]}}', "matrix"),
    "deep": ('{"object": ' + '{"children": [' * 3000 + "]}" * 3000 + "}", "is nested too deeply"),
    "too deep to be validated": ('{"object": ' + '{"children": [' * 400 + "]}" * 400 + "}", "is nested too deeply"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_file_that_is_no_scene_gets_one_message(tmp_path, name):
    text, expected = FAULTS[name]
    path = tmp_path / "scene.json"
    path.write_text(text)
    with pytest.raises(FileError, match=r"scene\.json") as caught:
        read_scene(path)
    assert expected in str(caught.value)


GEOMETRY_FAULTS = {
    "an unknown shape": (
        {"uuid": "g", "type": "TubeGeometry"},
        "has a TubeGeometry, stored as parameters alone",
    ),
    "no segments": ({**BOX, "widthSegments": 0}, "BoxGeometry has widthSegments = 0"),
    "no number": ({**BOX, "width": "wide"}, "BoxGeometry has width = 'wide'"),
    "NaN": (
        soup_of({"position": {**POSITION, "array": [None, *TRIANGLE[1:]]}}),
        "position is NaN or infinite at vertex 0",
    ),
    "no positions": (soup_of({}), "no attribute position"),
    "no triples": (soup_of({"position": {**POSITION, "array": TRIANGLE[1:]}}), "8 numbers; expected a multiple of 3"),
    "words": (soup_of({"position": {**POSITION, "array": ["a"] * 9}}), "expected a list of numbers"),
    "an unknown type": (soup_of({"position": {**POSITION, "type": "BigInt64Array"}}), "of type 'BigInt64Array'"),
    "an index beyond": (
        soup_of({"position": POSITION}, index={"type": "Uint16Array", "array": [0, 1, 3]}),
        "0 to 3, with 3",
    ),
    "a lost buffer": (
        soup_of({"position": {"isInterleavedBufferAttribute": True, "itemSize": 3, "data": "x"}}),
        "is in a buffer that the file lacks",
    ),
    "other normals": (
        soup_of({"position": POSITION, "normal": {**POSITION, "array": [0, 0, 1]}}),
        "3 vertices and 1 normals",
    ),
}


@pytest.mark.parametrize("name", GEOMETRY_FAULTS)
def test_a_damaged_geometry_gets_one_message(tmp_path, name):
    geometry, expected = GEOMETRY_FAULTS[name]
    with pytest.raises(FileError) as caught:
        read_scene(stored(tmp_path, MESH, geometries=[geometry]))
    assert expected in str(caught.value)


def test_an_odd_mesh_is_left_out_and_named_with_its_fault(tmp_path):
    empty, tube = {**soup_of({}), "uuid": "e"}, {"uuid": "t", "type": "TubeGeometry"}
    few = {"itemSize": 16, "type": "Float32Array", "array": [0] * 16}
    odd = [
        {**MESH, "name": "label", "geometry": "e"},
        *({**MESH, "name": f"pipe {i}", "geometry": "t"} for i in range(6)),
        {**MESH, "name": "lost", "geometry": "nowhere"},
        {**MESH, "name": "posts", "type": "InstancedMesh", "count": 2, "instanceMatrix": few},
    ]
    bare = {**soup_of({"position": {**POSITION, "array": []}}), "uuid": "b"}
    odd.append({**MESH, "name": "bare", "geometry": "b"})
    scene = read_scene(stored(tmp_path, odd[0], MESH, *odd[1:], geometries=[BOX, empty, tube, bare]))
    assert [mesh.name for mesh in scene.meshes] == ["box"]
    assert "bare: it has no triangles; left out" in scene.remarks
    said = [remark for remark in scene.remarks if "left out, because" in remark]
    assert [remark.partition(": left out, because the file ")[0] for remark in said] == [
        "label",
        "pipe 0, pipe 1, pipe 2, pipe 3 and 2 others",
        "lost",
        "posts",
    ]
    for remark, fault in zip(
        said, ("has a BufferGeometry with no", "has a Tube", "is damaged: its mesh", "is damaged"), strict=True
    ):
        assert f"because the file {fault}" in remark


HALF = {"itemSize": 3, "type": "Uint16Array"}
# 0, 0.5, 1 and -0.5.
BITS = [0, 14336, 15360, 15360, 0, 47104, 0, 15360, 0]


def interleaved_halves():
    words = np.array([*BITS, 0], np.uint16).view(np.uint32).tolist()
    position = {"isInterleavedBufferAttribute": True, "itemSize": 3, "data": "i", "offset": 0, "type": ""}
    buffers = {"interleavedBuffers": {"i": {"buffer": "b", "type": "Uint16Array", "stride": 3}}}
    return soup_of({"position": position}, **buffers, arrayBuffers={"b": words})


@pytest.mark.parametrize(
    ("geometry", "attributes"),
    [
        (soup_of({"position": {**HALF, "array": BITS}}), "position"),
        (soup_of({"position": {**HALF, "array": BITS}, "normal": {**HALF, "array": BITS}}), "position and normal"),
        (interleaved_halves(), "position"),
        (soup_of({"position": {**HALF, "array": BITS, "normalized": True}}), None),
        # Half floats have no such bits.
        (soup_of({"position": {**HALF, "array": [*BITS[:-1], 32000]}}), None),
        (soup_of({"position": POSITION}), None),
    ],
    ids=["positions", "both", "interleaved", "normalized", "not half floats", "floats"],
)
def test_whole_numbers_that_may_be_half_floats_are_named_once(geometry, attributes, tmp_path):
    scene = read_scene(stored(tmp_path, MESH, {**MESH, "name": "twin"}, geometries=[geometry]))
    said = [remark for remark in scene.remarks if "16 bits" in remark]
    start = f"box: its attribute {attributes} holds whole numbers of 16 bits, and is read as these"
    assert [remark.startswith(start) for remark in said] == ([True] if attributes else [])


def test_a_missing_geometry_is_named(tmp_path):
    with pytest.raises(FileError, match="its mesh box refers to a geometry that the file lacks"):
        read_scene(stored(tmp_path, MESH, geometries=[]))


# --- glTF ---


def as_file(tmp_path, content):
    path = tmp_path / "scene.gltf"
    path.write_text(json.dumps(content))
    return path


def test_lights_and_cameras_of_gltf_look_along_their_nodes(tmp_path):
    scene = read_scene(as_file(tmp_path, gltf()))
    (mesh,), (camera,) = scene.meshes, scene.cameras
    assert (mesh.name, mesh.side) == ("triangle", "double")
    np.testing.assert_allclose(mesh.normals, [[0, -1, 0]] * 3, atol=1e-7)
    np.testing.assert_allclose(camera.forward, [0, 1, 0], atol=1e-7)
    np.testing.assert_allclose(camera.up, [0, 0, 1], atol=1e-7)
    assert (camera.fov_y, camera.near, camera.far, camera.aspect) == (pytest.approx(math.degrees(1)), 0.1, None, None)
    sun, lamp, spot = scene.lights
    assert (sun.type, lamp.type, spot.type) == ("directional", "point", "spot")
    np.testing.assert_allclose(sun.direction, [0, 1, 0], atol=1e-7)
    assert lamp.direction is None
    assert (spot.inner_angle, spot.outer_angle) == (0, pytest.approx(math.degrees(0.5)))
    assert spot.position == (0, 0, 2)
    assert any("alpha test" in remark for remark in scene.remarks)


def test_a_parallel_camera_of_gltf_has_its_height_and_shape(tmp_path):
    content = gltf()
    # Its sizes are half of what it shows.
    box = {"xmag": 3.0, "ymag": 0.5, "znear": 0.25, "zfar": 8.0}
    content["cameras"] = [{"type": "orthographic", "orthographic": box}]
    (camera,) = read_scene(as_file(tmp_path, content)).cameras
    assert (camera.height, camera.aspect, camera.near, camera.far, camera.fov_y) == (1.0, 6.0, 0.25, 8.0, None)


GLTF_FAULTS = {
    "no such light": (lambda it: it["extensions"]["KHR_lights_punctual"]["lights"].pop(), "refers to light 2"),
    "no such camera": (lambda it: it["cameras"].pop(), "refers to camera 0"),
    "a camera without a lens": (lambda it: it["cameras"][0].pop("perspective"), "is perspective, without the settings"),
    "an unknown light": (
        lambda it: it["extensions"]["KHR_lights_punctual"]["lights"][0].update(type="sky"),
        "KHR_lights_punctual.0.type",
    ),
}


@pytest.mark.parametrize("name", GLTF_FAULTS)
def test_damage_of_a_gltf_scene_gets_one_message(tmp_path, name):
    change, expected = GLTF_FAULTS[name]
    content = copy.deepcopy(gltf())
    change(content)
    with pytest.raises(FileError) as caught:
        read_scene(as_file(tmp_path, content))
    assert expected in str(caught.value)


def named(content, name):
    return next(node for node in content["nodes"] if node.get("name") == name)


HIDDEN = {"KHR_node_visibility": {"visible": False}}


def test_what_is_below_a_hidden_node_is_left_out_and_named(tmp_path):
    content = gltf()
    named(content, "light 0")["extensions"] |= HIDDEN
    for extensions in (HIDDEN, {"KHR_node_visibility": {"hidden": True}}):
        above = {"name": "above", "extensions": extensions, "children": [len(content["nodes"]) + 1]}
        # What is below a hidden node is hidden, too.
        ghost = {"name": "ghost", "mesh": 0, "extensions": {"KHR_node_visibility": {"visible": True}}}
        content["nodes"] += [above, ghost]
    content["nodes"].append({"name": "spare", "camera": 0, "extensions": HIDDEN})
    scene = read_scene(as_file(tmp_path, content))
    assert [mesh.name for mesh in scene.meshes] == ["triangle"]
    assert [light.name for light in scene.lights] == ["light 1", "light 2"]
    assert len(scene.cameras) == 1
    said = [remark for remark in scene.remarks if "KHR_node_visibility" in remark]
    assert said == [f"{name}: hidden by KHR_node_visibility; left out" for name in ("light 0", "ghost", "spare")]
    with pytest.warns(MeshWarning, match="is loaded without its 2 hidden meshes"):
        assert load_mesh(tmp_path / "scene.gltf").faces.shape[0] == 1


def test_a_hidden_camera_serves_where_there_is_no_other(tmp_path):
    content = gltf()
    content["nodes"][1]["extensions"] = HIDDEN
    scene = read_scene(as_file(tmp_path, content))
    assert len(scene.cameras) == 1
    assert "camera: hidden by KHR_node_visibility; used anyway, because there is no other camera" in scene.remarks


def test_extensions_and_animations_that_are_not_obeyed_are_named(tmp_path):
    content = gltf()
    content["extensionsUsed"] += [
        "ACME_curtains",
        "KHR_materials_clearcoat",
        "EXT_meshopt_compression",
        "ACME_curtains",
    ]
    content["animations"] = [{}, {}]
    content["materials"][0] |= {"alphaMode": "BLEND", "extensions": {"KHR_materials_unlit": {}}}
    scene = read_scene(as_file(tmp_path, content))
    for remark in (
        "1 × extension ACME_curtains: left out",
        "2 × animation: left out",
        "triangle: it is transparent, but opaque here; in shadow maps it is also opaque in three.js",
        "triangle: its material is unlit (KHR_materials_unlit) and shows no shadows; here it shows them",
    ):
        assert scene.remarks.count(remark) == 1
    assert not any("clearcoat" in remark or "meshopt" in remark for remark in scene.remarks)


def test_an_odd_primitive_of_gltf_is_left_out_and_named(tmp_path):
    content = gltf()
    content["meshes"].append({"primitives": [{"attributes": {"POSITION": 9}}, {"attributes": {"COLOR_0": 0}}]})
    content["nodes"].append({"name": "odd", "mesh": 1})
    scene = read_scene(as_file(tmp_path, content))
    assert [mesh.name for mesh in scene.meshes] == ["triangle"]
    assert (
        "odd: left out, because the file is damaged: it refers to accessor 9, but has 2; export it again"
        in scene.remarks
    )
    assert "1 × primitive without positions: left out" in scene.remarks
    content["nodes"][0]["mesh"] = 1
    with pytest.raises(FileError, match=r"scene\.gltf is damaged: it refers to accessor 9, .* \(in triangle\)"):
        read_scene(as_file(tmp_path, content))


# --- Files' own normals ---


def test_a_written_mesh_is_read_back_to_the_bit(tmp_path):
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(30, 3)).astype(np.float32)
    normals = rng.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    faces = np.arange(30).reshape(10, 3)[:, ::-1].copy()
    write_ply(tmp_path / "mesh.ply", vertices.astype(np.float64), faces, normals)
    mesh = load_mesh(tmp_path / "mesh.ply", None)
    np.testing.assert_array_equal(np.asarray(mesh.vertices)[np.asarray(mesh.faces)], vertices[faces])
    np.testing.assert_allclose(np.asarray(mesh.corner_normals), normals[faces], atol=1e-7)


def test_normals_of_a_gltf_file_turn_with_their_node(tmp_path):
    mesh = load_mesh(as_file(tmp_path, gltf()), None)
    np.testing.assert_allclose(np.asarray(mesh.corner_normals), [[[0, -1, 0]] * 3], atol=1e-6)


def test_degenerate_faces_do_not_shift_normals(tmp_path):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.0]])
    normals = np.eye(3)[[0, 1, 2, 0]]
    write_ply(tmp_path / "mesh.ply", vertices, np.array([[0, 1, 3], [0, 1, 2]]), normals)
    mesh = load_mesh(tmp_path / "mesh.ply", None)
    np.testing.assert_allclose(np.asarray(mesh.corner_normals), np.eye(3)[None])


def test_a_file_without_normals_is_reported(tmp_path):
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FileError, match="has no normals of vertices"):
        load_mesh(tmp_path / "mesh.obj", None)


# --- Places ---


def about(axis, angle):
    """A turn about x, y or z, as a matrix (4, 4)."""
    turn, (i, j) = np.eye(4), [(1, 2), (2, 0), (0, 1)][axis]
    turn[[i, j, i, j], [i, j, j, i]] = [math.cos(angle), math.cos(angle), -math.sin(angle), math.sin(angle)]
    return turn


def moved(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


PLACED = moved(1, 2, 3) @ about(0, 0.3) @ about(1, 0.5) @ about(2, 0.7) @ np.diag([2, 1, 3, 1])
"""By three.js' order of angles: the last turns first."""


def assert_placed(mesh, own, matrix):
    """The mesh's vertices equal its `own` vertices, moved by `matrix`."""
    np.testing.assert_allclose(mesh.vertices, (np.c_[own, np.ones(len(own))] @ matrix.T)[:, :3], atol=1e-6)


def test_objects_are_turned_about_x_last_and_moved_by_what_they_stand_in(tmp_path):
    pose = {"position": [1, 2, 3], "rotation": [0.3, 0.5, 0.7, "XYZ"], "scale": [2, 1, 3]}
    child = {**MESH, "matrix": (moved(4, 0, 0) @ about(2, 0.9)).T.ravel().tolist()}
    scene = read_scene(stored(tmp_path, {"type": "Group", **pose, "children": [child]}, MESH, SUN, EYE))
    inner, plain = scene.meshes
    assert_placed(inner, plain.vertices, PLACED @ moved(4, 0, 0) @ about(2, 0.9))


def test_instances_stand_where_their_object_stands(tmp_path):
    each = [moved(4, 0, 0) @ about(2, 0.9), moved(0, 5, 0)]
    numbers = np.concatenate([matrix.T.ravel() for matrix in each]).tolist()
    stamp = {"itemSize": 16, "type": "Float32Array", "array": numbers}
    many = {**MESH, "type": "InstancedMesh", "count": 2, "instanceMatrix": stamp, "matrix": PLACED.T.ravel().tolist()}
    whole, plain = read_scene(stored(tmp_path, many, MESH, SUN, EYE)).meshes
    for part, matrix in zip(np.split(whole.vertices, 2), each, strict=True):
        assert_placed(whole._replace(vertices=part), plain.vertices, PLACED @ matrix)


def test_nodes_of_gltf_are_moved_by_those_above_them(tmp_path):
    content = gltf()
    quarter = [0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)]
    above = {"children": [1], "rotation": quarter, "scale": [2, 1, 1], "translation": [5, 6, 7]}
    content["nodes"] = [above, {"mesh": 0, "translation": [0, 3, 0], "rotation": quarter}]
    (mesh,) = read_scene(as_file(tmp_path, content)).meshes
    turn = about(2, math.pi / 2)
    matrix = moved(5, 6, 7) @ turn @ np.diag([2, 1, 1, 1]) @ moved(0, 3, 0) @ turn
    assert_placed(mesh, np.reshape(TRIANGLE, (3, 3)), matrix)
