"""Configurations of imported scenes: the engine's own cameras, settings, and what is said about the rest."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from gltf_scene import gltf
from rich.console import Console

from diffshadow import geometry, io
from diffshadow.cli import main
from diffshadow.config import build_scene, build_technique, dump_resolved, load_config, parse_config
from diffshadow.geometry import PointLight
from diffshadow.io import FileError, read_scene
from diffshadow.settings import engines
from diffshadow.shadow import EngineLight, ThreeJs
from diffshadow.shadow.engines._axes import engine_light
from diffshadow.study import import_scene

FOLDER = Path(__file__).parents[1] / "golden" / "imports"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
# Of three.js' matrices, which act on column vectors.
matrix = lambda values: np.reshape(values, (4, 4)).T


def imported(tmp_path, name, **options):
    """The configuration of a scene, and what was said."""
    with (tmp_path / "said.txt").open("w") as file:
        made = import_scene(FOLDER / f"{name}.json", console=Console(file=file, width=300), output=tmp_path, **options)
    return load_config(made, fitting=True), (tmp_path / "said.txt").read_text()


@pytest.mark.parametrize("name", EXPECTED)
def test_camera_and_light_are_the_engines(tmp_path, name):
    config, _ = imported(tmp_path, name)
    # With the aspect of the engine's own image.
    config = load_config(tmp_path / f"{name}.yaml", ["scene.camera.resolution=[80, 100]"])
    scene, expected = build_scene(config), EXPECTED[name]
    view = scene.camera.view()
    np.testing.assert_allclose(view.world_to_eye, matrix(expected["view"]), atol=2e-6)
    np.testing.assert_allclose(view.eye_to_clip, matrix(expected["projection"]), atol=2e-6)
    light = engine_light(scene.light, 1e-4)
    if isinstance(light, PointLight):
        np.testing.assert_allclose(light.position, [0.1, 1.35, 0.25], atol=1e-7)
        assert (float(light.near), float(light.far)) == (pytest.approx(0.15), 5.0)
        return
    shadow = light.view().eye_to_clip @ light.view().world_to_eye
    to_window = np.array([[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5], [0, 0, 0, 1]])
    np.testing.assert_allclose(to_window @ np.asarray(shadow), matrix(expected["shadow"]), atol=3e-6)


SUN = ThreeJs.directional_light(
    (-1.6, 3.0, 1.4), (0.0, 0.2, 0.0), left=-1.5, right=1.8, top=1.6, bottom=-1.9, near=1.0, far=6.5
)
CONE = {"angle": 0.5, "penumbra": 0.3, "focus": 0.9, "aspect": 1.2, "distance": 6.0, "resolution": (128, 96)}
SPOT = ThreeJs.spot_light((-1.3, 2.6, 1.2), near=0.8, **CONE)
LAMP = ThreeJs.point_light((0.1, 1.35, 0.25), near=0.15, far=5.0)


@pytest.mark.parametrize(("name", "given"), [("yard", SUN), ("stage", SPOT), ("room", LAMP)])
def test_the_light_is_the_light_of_the_files_numbers(tmp_path, name, given):
    config, _ = imported(tmp_path, name)
    found = build_scene(config).light
    assert type(found) is type(given)
    # Files have no size of lights.
    for field in {*vars(given)} - {"radius", "angular_radius", "direction"}:
        np.testing.assert_allclose(getattr(found, field), getattr(given, field), rtol=1e-6, err_msg=field)
    if name != "room":
        directions = [one.direction / np.linalg.norm(one.direction) for one in (found, given)]
        np.testing.assert_allclose(*directions, atol=1e-6)


def test_settings_of_the_shadow_are_taken_over(tmp_path):
    config, said = imported(tmp_path, "yard")
    technique = config.technique
    assert isinstance(technique, engines.ThreeJs)
    assert (technique.bias, technique.normal_bias, technique.radius) == (-0.002, 0.004, 2.5)
    assert technique.side == ("front", "front", "front", "double", "front", "front")
    # A material without shadowSide casts what the engine chooses.
    assert technique.shadow_side == ("front", "front", "front", None, "front", "front")
    assert config.shadow_map.resolution == (128, 160)
    for name, bounds in config.fit.parameters.items():
        assert bounds.lower <= getattr(technique, name.removeprefix("technique.")) <= bounds.upper
    assert parse_config(dump_resolved(config)).scene.light == config.scene.light
    for line in (
        "taken: 6 meshes, 858 triangles: ground, knot, mirrored, sheet 0, sheet 1, posts",
        "taken: directional light sun: map of 160 × 128 texels, bias -0.002, normalBias 0.004, radius 2.5",
        "note: on another layer: not in the camera's layers; left out",
        "note: 1 × line: left out",
    ):
        assert line in said


def test_a_mesh_is_taken_over_with_its_normals(tmp_path):
    config, _ = imported(tmp_path, "yard")
    stored = next(mesh for mesh in read_scene(FOLDER / "yard.json").meshes if mesh.name == "knot")
    mesh = build_scene(config).meshes[1]
    np.testing.assert_allclose(mesh.vertices[mesh.faces], stored.vertices[stored.faces], atol=2e-6)
    np.testing.assert_allclose(mesh.corner_normals, stored.normals[stored.faces], atol=1e-6)


def test_meshes_that_do_not_cast_or_receive_are_marked(tmp_path):
    config, _ = imported(tmp_path, "stage")
    assert [mesh.casts for mesh in config.scene.meshes] == [True, True, True, True, False]
    assert all(mesh.receives for mesh in config.scene.meshes)
    assert config.technique.intensity == 0.8


def test_a_material_without_shadow_side_casts_what_the_engine_chooses(tmp_path):
    config, _ = imported(tmp_path, "room")
    assert config.technique.side == ("front", "front", "double", "front")
    assert config.technique.shadow_side == ("front", "front", None, None)
    assert build_technique(config).casting_sides(build_scene(config)) == ("front", "front", "double", "back")


def test_bounds_hold_what_is_given(tmp_path):
    def strong(children):
        for light in children:
            if light["type"] == "SpotLight":
                light["shadow"] |= {"bias": -0.3, "normalBias": 2, "radius": 40}

    made = import_scene(scene_file(tmp_path, strong), console=Console(quiet=True), output=tmp_path)
    config = load_config(made, fitting=True)
    for name, bounds in config.fit.parameters.items():
        assert bounds.lower < getattr(config.technique, name.removeprefix("technique.")) < bounds.upper


def test_shadow_mapping_takes_the_same_map(tmp_path):
    config, said = imported(tmp_path, "yard", technique="shadow_map")
    assert config.technique.type == "shadow_map"
    assert config.scene.light.shadow_camera.far == 6.5
    assert "bias, normalBias and radius of the light's shadow: left out" in said


def scene_file(tmp_path, change):
    content = json.loads((FOLDER / "stage.json").read_text())
    change(content["object"]["children"])
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(content))
    return path


def without(kind):
    return lambda children: children.__setitem__(slice(None), [one for one in children if one["type"] != kind])


def unset(key, kinds):
    def change(children):
        for one in children:
            if one["type"] in kinds:
                one[key] = False

    return change


@pytest.mark.parametrize(
    ("kind", "said"), [("PerspectiveCamera", "the file has no camera"), ("SpotLight", "the file has no light")]
)
def test_a_camera_and_a_light_that_a_scene_lacks_are_added(tmp_path, capsys, kind, said):
    made = tmp_path / "made"
    with pytest.raises(SystemExit) as caught:
        main(["import", str(scene_file(tmp_path, without(kind))), "--output", str(made)])
    assert caught.value.code == 0
    assert f"note: {said}" in capsys.readouterr().out
    config = load_config(made / "changed.yaml", fitting=True)
    assert config.scene.camera.eye is not None
    assert config.scene.light is not None


def test_a_mesh_file_alone_becomes_a_scene(tmp_path, capsys):
    mesh = geometry.library_mesh("chair")
    io.write_ply(tmp_path / "chair.ply", 100 * np.asarray(mesh.vertices), np.asarray(mesh.faces))
    with pytest.raises(SystemExit) as caught:
        main(["import", str(tmp_path / "chair.ply"), "--output", str(tmp_path / "made")])
    assert caught.value.code == 0
    out = capsys.readouterr().out
    for what in ("camera", "light", "ground"):
        assert f"note: the file has no {what}" in out
    config = load_config(tmp_path / "made" / "chair.yaml", fitting=True)
    assert len(config.scene.meshes) == 2
    # Rounded edges stay smooth: the mesh keeps the normals that its creases give it.
    assert config.scene.meshes[0].normals == "file"
    assert build_scene(config).meshes[0].faces.shape[0] == mesh.faces.shape[0]


MISTAKES = {
    "no casting light": (unset("castShadow", ["SpotLight"]), [], "(1 without castShadow)"),
    "no meshes": (without("Mesh"), [], "the scene has no mesh that casts shadows (no triangles"),
    "no casters": (
        unset("castShadow", ["Mesh"]),
        [],
        "the scene has no mesh that casts shadows (5 without castShadow)",
    ),
    "another camera": (lambda _: None, ["--camera", "side"], "--camera is 'side', and the scene has view"),
    "another light": (lambda _: None, ["--light", "moon"], "--light is 'moon', and the scene has spot"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_scene_that_cannot_be_lit_gets_one_message(tmp_path, capsys, name):
    change, options, expected = MISTAKES[name]
    path = scene_file(tmp_path, change)
    with pytest.raises(SystemExit) as caught:
        main(["import", str(path), "--output", str(tmp_path / "made"), *options])
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.startswith("error: ")
    assert not (tmp_path / "made").exists()


def flattened(children):
    """The boxes of the stage have positions of two numbers, and its other meshes cast no shadows."""
    for one in children:
        if one["type"] == "Mesh":
            one["castShadow"] = False
    first = next(one for one in children if one["type"] == "Mesh")
    first |= {"name": "flat", "castShadow": True, "geometry": "flat"}


def test_an_error_comes_after_the_notes_and_counts_what_was_left_out(tmp_path, capsys):
    path = scene_file(tmp_path, flattened)
    content = json.loads(path.read_text())
    position = {"itemSize": 2, "type": "Float32Array", "array": [0, 0, 1, 0, 0, 1]}
    content["geometries"].append(
        {"uuid": "flat", "type": "BufferGeometry", "data": {"attributes": {"position": position}}}
    )
    path.write_text(json.dumps(content))
    with pytest.raises(SystemExit):
        main(["import", str(path), "--output", str(tmp_path / "made")])
    out, error = capsys.readouterr()
    assert "note: flat: left out, because the file" in " ".join(out.split())
    assert "(4 without castShadow, and 1 left out); expected one: fix the omitted parts as in the notes" in error


def test_a_scene_beyond_the_limits_gets_the_same_message_twice_and_leaves_nothing(tmp_path, capsys):
    def huge(children):
        for light in children:
            if light["type"] == "SpotLight":
                light["shadow"]["mapSize"] = [16384, 16384]

    path = scene_file(tmp_path, huge)
    errors = []
    for _ in range(2):
        with pytest.raises(SystemExit):
            main(["import", str(path), "--output", str(tmp_path / "new" / "made")])
        errors.append(capsys.readouterr().err)
    assert errors[0] == errors[1]
    assert errors[0].startswith(f"error: {path}: shadow_map.resolution.0: is 16384; expected")
    assert "it comes from the scene: change it there" in errors[0]
    assert list(tmp_path.iterdir()) == [path]


def test_an_import_that_cannot_write_leaves_nothing(tmp_path, monkeypatch):
    def is_full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("diffshadow.io.write_ply", is_full)
    (tmp_path / "mine.txt").write_text("")
    for folder in (tmp_path, tmp_path / "new"):
        with pytest.raises(FileError, match="No space left on device"):
            import_scene(FOLDER / "room.json", console=Console(quiet=True), output=folder)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "meshes").write_text("")
    with pytest.raises(FileError, match="meshes exists and is not a folder"):
        import_scene(FOLDER / "room.json", console=Console(quiet=True), output=tmp_path)


def test_an_edited_configuration_is_not_written_over(tmp_path):
    made = import_scene(FOLDER / "room.json", console=Console(quiet=True), output=tmp_path)
    made.write_text(made.read_text() + "# mine\n")
    with pytest.raises(FileError, match=r"room.yaml exists already.*--output"):
        import_scene(FOLDER / "room.json", console=Console(quiet=True), output=tmp_path)
    assert made.read_text().endswith("# mine\n")


def test_a_name_that_could_be_a_number_is_read_back(tmp_path):
    path = tmp_path / "1e3.json"
    path.write_text((FOLDER / "room.json").read_text())
    made = import_scene(path, console=Console(quiet=True), output=tmp_path / "made")
    assert load_config(made, fitting=True).name == "1e3"


def test_the_command_names_the_configuration_last(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["import", str(FOLDER / "room.json"), "--output", str(tmp_path)])
    assert caught.value.code == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "room.yaml")


def test_a_camera_may_have_its_own_file(tmp_path):
    path = scene_file(tmp_path, without("PerspectiveCamera"))
    made = import_scene(path, console=Console(quiet=True), camera=str(FOLDER / "yard.json"), output=tmp_path)
    assert load_config(made).scene.camera.eye == (1.9, 1.9, 2.4)


def test_the_code_of_an_imported_light_has_its_own_camera(tmp_path):
    def middle(children):
        for light in children:
            if light["type"] == "SpotLight":
                camera = {"left": -2, "right": 2, "top": 3, "bottom": -3, "near": 0.7, "far": 8}
                light |= {"type": "DirectionalLight", "shadow": {"camera": camera}}

    made = import_scene(scene_file(tmp_path, middle), console=Console(quiet=True), output=tmp_path)
    given = EngineLight.of(build_scene(load_config(made)).light, (512, 512))
    assert given.position == pytest.approx([-1.3, 2.6, 1.2], abs=1e-6)
    assert given.window == pytest.approx({"left": -2, "right": 2, "top": 3, "bottom": -3}, abs=1e-5)
    assert (given.near, given.far) == (pytest.approx(0.7), pytest.approx(8))


def three_far(by):
    content = json.loads((FOLDER / "yard.json").read_text())
    content["object"]["matrix"][12:15] = by
    return content


def gltf_far(by):
    """With the local coordinates as they were, below a node that is far away."""
    content = gltf()
    content["nodes"][0]["translation"] = [-0.3, 5, -0.3]
    content["nodes"].append({"translation": by, "children": [*range(len(content["nodes"]))]})
    return content


@pytest.mark.parametrize("content", [three_far, gltf_far])
def test_a_scene_far_from_the_worlds_origin_is_taken_over_with_all_digits(tmp_path, content):
    built = []
    for number, by in enumerate(([0, 0, 0], [6e6, -8e3, 3e6])):
        path = tmp_path / f"{number}.json"
        path.write_text(json.dumps(content(by)))
        made = import_scene(path, console=Console(quiet=True), output=tmp_path / f"made {number}")
        built.append(build_scene(load_config(made, fitting=True)))
    near, far = built
    # The texts of both have nine digits or more of the scene.
    for ours, theirs in zip(jax.tree.leaves(near), jax.tree.leaves(far), strict=True):
        at = np.asarray(far.origin) - [6e6, -8e3, 3e6] if ours.shape[-1:] == (3,) else 0
        assert min(np.abs(theirs - ours).max(), np.abs(theirs + at - ours).max()) < 2e-6 * max(np.abs(ours).max(), 1)


def written(tmp_path, content):
    path = tmp_path / "scene.gltf"
    path.write_text(json.dumps(content))
    return path


def test_a_gltf_file_without_meshes_is_refused_with_its_own_remedy(tmp_path):
    content = gltf()
    for node in content["nodes"]:
        node.pop("mesh", None)
        # Whatever else is missing, the mesh is what cannot be added.
        node.pop("camera", None)
    with pytest.raises(ValueError, match=r"has no mesh.*; expected one: export the scene with its meshes"):
        import_scene(written(tmp_path, content), console=Console(quiet=True), output=tmp_path)


@pytest.mark.parametrize("what", ["light", "camera"])
def test_a_gltf_file_gets_what_it_lacks(tmp_path, what):
    content = gltf()
    for node in content["nodes"]:
        node.pop(what, None)
        if what == "light":
            node.pop("extensions", None)
    with (tmp_path / "said").open("w+") as said:
        import_scene(written(tmp_path, content), console=Console(file=said, width=300), output=tmp_path)
        said.seek(0)
        assert f"note: the file has no {what}" in said.read()


BULB = {"uuid": "bulb", "type": "SphereGeometry", "radius": 0.05}
SHINING = [
    {"uuid": "basic", "type": "MeshBasicMaterial"},
    {"uuid": "shining", "type": "MeshStandardMaterial", "emissive": 0xFFDD88},
    {"uuid": "dim", "type": "MeshStandardMaterial", "emissive": 0xFFDD88, "emissiveIntensity": 0},
]
ROOM = {"uuid": "room", "type": "BoxGeometry", "width": 4, "height": 3, "depth": 4}


def room(tmp_path, *meshes, **lamp):
    """The radius of a lamp that stands in the middle of a room, and what is said of it."""
    placed = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *lamp.pop("at", (0, 0, 0)), 1]
    base = {"type": "Mesh", "castShadow": True, "material": "basic"}
    small = [0.1, 0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0.1, 0, 0.5, -1, 0, 1]
    children = [
        {"type": "PerspectiveCamera", "position": [1, 1, 1]},
        {"type": "PointLight", "name": "lamp", "castShadow": True, "matrix": placed, **lamp},
        {**base, "name": "room", "geometry": "room", "castShadow": False},
        {**base, "name": "box", "geometry": "room", "matrix": small},
        *({**base, "castShadow": False, "matrix": placed, **mesh} for mesh in meshes),
    ]
    content = {"object": {"type": "Scene", "children": children}, "geometries": [BULB, ROOM], "materials": SHINING}
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(content))
    with (tmp_path / "said.txt").open("w") as file:
        made = import_scene(path, console=Console(file=file, width=300), output=tmp_path)
    said = next(line for line in (tmp_path / "said.txt").read_text().splitlines() if "have no size" in line)
    return load_config(made, fitting=True).scene.light.radius, said


@pytest.mark.parametrize("at", [(0, 0, 0), (1e-17, 0, 0), (0.2, 1, 0)])
def test_a_lamp_in_a_room_is_seen_under_a_degree_from_its_walls(tmp_path, at):
    radius, said = room(tmp_path, at=at)
    # The distances of the walls' middles from the middle of the room are 1.5 to 2.
    assert 1.5 <= radius / np.tan(np.radians(0.5)) <= 2.6
    assert "seen under 1 degree from" in said


@pytest.mark.parametrize("material", ["basic", "shining"])
def test_a_lamp_is_as_large_as_its_own_mesh(tmp_path, material):
    radius, said = room(tmp_path, {"name": "bulb", "geometry": "bulb", "material": material})
    assert radius == pytest.approx(0.05, rel=0.02)
    assert "its light's radius is 0.05 world units, the radius of its mesh bulb;" in said


@pytest.mark.parametrize(
    "mesh",
    [
        {"material": "dim"},
        {"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.3, 0, 0, 1]},
        {"geometry": "room"},
    ],
    ids=["not shining", "elsewhere", "a room"],
)
def test_other_meshes_are_no_lamps(tmp_path, mesh):
    _, said = room(tmp_path, {"name": "other", "geometry": "bulb", "material": "basic", **mesh})
    assert "seen under 1 degree from" in said


def test_a_shining_mesh_around_a_lamp_of_gltf_does_not_cast(tmp_path):
    content = gltf()
    content["materials"].append({"emissiveFactor": [1, 1, 1], "doubleSided": True})
    content["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}, "material": 1}]})
    small = {"mesh": 1, "scale": [0.01] * 3, "translation": [0, 0, 1]}
    content["nodes"] = [{"name": "bulb", **small}, *content["nodes"]]
    content["nodes"][1]["scale"] = [4, 4, 4]
    with (tmp_path / "said.txt").open("w") as file:
        console = Console(file=file, width=300)
        made = import_scene(written(tmp_path, content), console=console, light="light 1", output=tmp_path)
    assert (
        "note: bulb: it is the mesh of the light light 1, and casts no shadow here"
        in (tmp_path / "said.txt").read_text()
    )
    assert [mesh.casts for mesh in load_config(made).scene.meshes] == [False, True]


def test_a_lamp_of_gltf_amid_its_scene_has_bounds(tmp_path):
    content = gltf()
    content["nodes"][0]["translation"] = [-0.5, 0, 0.5]
    content["nodes"][3]["translation"] = [0, 0, 1]
    made = import_scene(written(tmp_path, content), console=Console(quiet=True), light="light 1", output=tmp_path)
    bounds = load_config(made, fitting=True).fit.parameters["technique.bias"]
    assert -0.5 < bounds.lower < 0


@pytest.mark.parametrize(("light", "kind"), [("light 0", "directional"), ("light 1", "point"), ("light 2", "spot")])
def test_a_scene_of_gltf_gets_the_techniques_defaults(tmp_path, light, kind):
    content = gltf()
    # The triangle faces the lights and the camera, which look up.
    content["nodes"][0]["translation"] = [-0.3, 5, -0.3]
    path = tmp_path / "scene.gltf"
    path.write_text(json.dumps(content))
    with (tmp_path / "said.txt").open("w") as file:
        made = import_scene(path, console=Console(file=file, width=300), light=light, output=tmp_path)
    config = load_config(made, fitting=True)
    assert config.scene.light.type == kind
    assert (config.technique.bias, config.technique.radius, config.technique.side) == (0, 1, "double")
    scene, said = build_scene(config), (tmp_path / "said.txt").read_text()
    assert "the file has no settings of shadows" in said
    assert "it has no aspect ratio" in said
    np.testing.assert_allclose(scene.meshes[0].corner_normals, [[[0, -1, 0]] * 3], atol=1e-6)
    towards = np.asarray(scene.lights[0].towards(scene.mesh.vertices))
    assert (towards[:, 1] < 0).all()


@pytest.mark.parametrize("technique", ["playcanvas", "bevy", "godot_compatibility"])
def test_another_engines_technique_has_its_own_defaults_and_what_to_fit(technique, tmp_path):
    scene = Path(__file__).parents[1] / "golden" / "imports" / "stage.json"
    console = Console(record=True, width=300)
    made = import_scene(scene, console=console, technique=technique, output=tmp_path / technique)
    config = load_config(made, ())
    assert config.technique.type == technique
    # The map of the scene is oblong, and theirs are square.
    assert config.shadow_map.resolution == (128, 128)
    assert set(config.fit.parameters) == {f"technique.{key}" for key in config.technique.biases}
    assert f"left out with technique {technique}" in console.export_text()
