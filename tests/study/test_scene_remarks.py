"""Remarks on scenes: meshes that contribute nothing to the picture, meshes around lights, and what was left out of
files."""

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from diffshadow.config import build_scene, build_technique, parse_config
from diffshadow.raster import draw_surface
from diffshadow.study.remarks._scene import dark_scene, scene_remarks, side_remarks
from diffshadow.study.runs._progress import Progress
from diffshadow.study.runs._setup import draw, load

SCENE = """
scene:
  meshes:
    - {{path: builtin:plane, options: {{size: 4}}}}
    - {{path: builtin:box}}
    - {{{mesh}}}
  camera: {{eye: [0, 3, 5], target: [0, 0, 0], resolution: [64, 64]}}
  light: {{type: directional, azimuth: 30, elevation: 60}}
"""
COLLINEAR = "v 0 0 0\nv 1 0 1\nv 3 0 3\nf 1 2 3\n"


def remarks(mesh, folder, *overrides):
    config = parse_config(SCENE.format(mesh=mesh), overrides, folder=folder)
    with Progress(Console(quiet=True)) as progress:
        scene, messages, _ = load(config, progress)
    surface = draw_surface(scene.mesh, scene.camera)
    return [*messages, *scene_remarks(config, build_technique(config), [scene], surface)]


@pytest.mark.parametrize(
    ("mesh", "cause"),
    [
        ("path: builtin:box, scale: 1.0e-6, translate: [1, 0.1, 1]", "another unit, so set its size"),
        ("path: builtin:box, size: 1.0e-6, translate: [1, 0.1, 1]", "change its size or scale"),
        ("path: builtin:box, translate: [0, 3, 12]", "behind the camera"),
        ("path: builtin:box, translate: [9, -3, 0]", "outside the image"),
        ("path: line.obj, translate: [0, 0.5, 0]", "no area"),
    ],
)
def test_a_mesh_that_contributes_nothing_is_named_with_its_cause(mesh, cause, tmp_path):
    (tmp_path / "line.obj").write_text(COLLINEAR)
    (remark,) = remarks(mesh, tmp_path)
    assert remark.startswith("scene.meshes.2 (")
    assert "covers no pixel and casts no shadow into the image: " in remark
    assert cause in remark


@pytest.mark.parametrize(
    "mesh",
    [
        "path: builtin:box, translate: [1, 0, 1]",
        # Out of the picture, with a shadow in it; and seen, but too low to cast one.
        "path: builtin:box, translate: [2, 6, 3.464]",
        "path: builtin:plane, options: {size: 1}, translate: [1, 0.001, 1]",
    ],
)
def test_a_mesh_that_is_seen_or_whose_shadow_is_seen_gets_no_remark(mesh, tmp_path):
    assert remarks(mesh, tmp_path) == []


LAMP = "scene.light={type: point, position: [1, 1.5, 1]}"
BULB = "path: builtin:sphere, options: {radius: 0.2}, translate: [1, 1.3, 1]"


@pytest.mark.exhaustive
def test_a_mesh_that_hides_a_light_from_all_is_named_with_the_key(tmp_path):
    (remark,) = remarks(BULB, tmp_path, LAMP)
    assert remark.startswith("scene.light is inside scene.meshes.2 (builtin:sphere), which hides it from all")
    assert "set scene.meshes.2.casts to false" in remark
    assert remarks(f"{BULB}, casts: false", tmp_path, LAMP) == []
    (remark,) = remarks(f"{BULB}, casts: false", tmp_path, LAMP, "reference={blockers: all}")
    assert "set reference.blockers to casters" in remark
    # A room, whose walls light and camera share; and one with a window, through which the camera looks.
    room = "path: builtin:box, options: {size: [20, 20, 20]}, translate: [0, -1, 0]"
    assert remarks(room, tmp_path, LAMP) == []
    hall = "path: builtin:box, options: {size: [6, 6, 6]}, translate: [0, -0.1, 0]"
    assert remarks(hall, tmp_path, LAMP, "scene.camera.eye=[0, 3, 9]", "scene.camera.near=7.2") == []


LARGE = "path: builtin:sphere, options: {radius: 3}, translate: [0, -1, -2]"


@pytest.mark.exhaustive
def test_a_mesh_that_is_mostly_out_of_the_picture_is_named_with_a_size(tmp_path):
    (remark,) = [each for each in remarks(LARGE, tmp_path) if "in the picture" in each]
    assert remark.startswith("scene.meshes.2 (builtin:sphere) is 6 × 6 × 6 world units large, with ")
    assert "set scene.meshes.2.size, to 3 for example, or move the camera at [0.0, 3.0, 5.0]" in remark
    # A ground is, too.
    assert not any(
        "in the picture" in each
        for each in remarks("path: builtin:plane, options: {size: 90}, translate: [0, 0.01, 0]", tmp_path)
    )


# A coarse sphere, which shares the programs that the other scenes compile.
FACETED = "path: builtin:low_poly_sphere, options: {radius: 3}, translate: [0, -1, -2]"
CARD = "path: builtin:plane, options: {size: 1}, translate: [1, 0.5, 1]"


def darkness(folder, *overrides, mesh=CARD):
    config = parse_config(SCENE.format(mesh=mesh), overrides, folder=folder)
    scene = build_scene(config)
    surface = draw_surface(scene.mesh, scene.camera)
    lit = [scene.lit_by(i) for i in range(len(scene.lights))]
    return dark_scene(config, lit, surface, [np.asarray(surface.mask)] * len(lit))


@pytest.mark.parametrize(
    ("mesh", "overrides", "cause"),
    [
        (
            "path: builtin:box, options: {size: [9, 6, 12]}, translate: [0, -0.1, 0]",
            ["scene.camera.near=0.01"],
            "scene.meshes.2 (builtin:box) is 9 × 6 × 12 world units large, around the camera, with ",
        ),
        (FACETED, ["scene.light.azimuth=180", "scene.light.elevation=0"], "is 6 × 6 × 6 world units large, with "),
        (
            BULB,
            [LAMP],
            "scene.light is inside scene.meshes.2 (builtin:sphere), which hides it from all that the camera",
        ),
        (CARD, ["scene.light.elevation=-60"], "all of it faces away from the light, or is in shadow; expected"),
    ],
    ids=["inside", "dark side", "bulb", "from below"],
)
def test_a_scene_that_no_light_reaches_has_nothing_to_compare(mesh, overrides, cause, tmp_path):
    said = darkness(tmp_path, *overrides, mesh=mesh)
    assert said is not None
    assert said.startswith("no light reaches the camera's view, so there is nothing to compare: ")
    assert cause in said


def test_a_scene_that_one_of_its_lights_reaches_can_be_compared(tmp_path):
    assert darkness(tmp_path) is None
    below, above = "{type: directional, elevation: -60}", "{type: directional, elevation: 60}"
    assert darkness(tmp_path, f"scene.lights=[{below}, {above}]", "scene.light=null") is None
    said = darkness(tmp_path, f"scene.lights=[{below}, {below}]", "scene.light=null")
    assert said is not None
    assert said.startswith("none of its lights reaches the camera's view")


def test_what_a_mesh_file_holds_beside_triangles_is_left_out_with_a_remark(tmp_path):
    (tmp_path / "cage.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nl 1 3\nl 2 4\n")
    (remark,) = remarks("path: cage.obj, translate: [1, 0.2, 1]", tmp_path)
    assert remark == f"the mesh file {tmp_path / 'cage.obj'} is loaded without its 2 lines"


# Upright, with their fronts to the camera and the light: a card of two triangles, and half a pipe that is open behind.
CARD = "v -0.5 0 0\nv 0.5 0 0\nv 0.5 1 0\nv -0.5 1 0\nf 1 2 3 4\n"
PIPE = "v -0.5 0 0\nv 0 0 0.5\nv 0.5 0 0\nv -0.5 1 0\nv 0 1 0.5\nv 0.5 1 0\nf 1 2 5 4\nf 2 3 6 5\n"
SIDES = """
scene:
  meshes:
    - {{path: builtin:plane, options: {{size: 4}}}}
    - {{path: {mesh}}}
    - {{path: builtin:box, size: 0.2, translate: [1.5, 0, 0]}}
  camera: {{eye: [-4, 3, 1], target: [0, 0, 0], resolution: [64, 64]}}
  light: {light}
{technique}
"""
SUN, POINT = "{type: directional, azimuth: 0, elevation: 45}", "{type: point, position: [0, 2, 2]}"
FROM_BEHIND = "{type: directional, azimuth: 180, elevation: 45}"
THREE, BABYLON = "technique: {type: three.js", "technique: {type: babylon.js"
UNSET = "technique.side is front and technique.shadow_side is not set"
# The light, the technique, the key and its value, and the side that casts; the last two are none without a remark.
LOST = {
    "three.js' defaults": (SUN, THREE, UNSET, "back"),
    "under a lamp": (POINT, THREE, UNSET, "back"),
    "from behind": (FROM_BEHIND, THREE, None, None),
    "a back side from behind": (FROM_BEHIND, f"{THREE}, side: back", UNSET.replace("front", "back"), "front"),
    "a shadow side": (SUN, f"{THREE}, shadow_side: back", "technique.shadow_side is back", "back"),
    "a side of each": (SUN, f"{THREE}, shadow_side: [front, back, front]", "technique.shadow_side.1 is back", "back"),
    "a side of some": (
        SUN,
        f"{THREE}, shadow_side: [front, null, front]",
        "technique.side is front and technique.shadow_side.1 is not set",
        "back",
    ),
    "both sides": (SUN, f"{THREE}, side: double", None, None),
    "VSM": (SUN, f"{THREE}, shadow_type: VSMShadowMap", None, None),
    "VSM from behind": (FROM_BEHIND, f"{THREE}, shadow_type: VSMShadowMap", UNSET, "front"),
    "Babylon.js": (SUN, BABYLON, None, None),
    "Babylon.js from behind": (FROM_BEHIND, BABYLON, "technique.back_face_culling is true", "front"),
    "Babylon.js without culling": (FROM_BEHIND, f"{BABYLON}, back_face_culling: false", None, None),
    "Babylon.js, back faces only": (
        SUN,
        f"{BABYLON}, force_back_faces_only: true",
        "technique.back_face_culling is true and technique.force_back_faces_only is true",
        "back",
    ),
    "a map that culls": (FROM_BEHIND, "shadow_map: {cull: back", "shadow_map.cull is back", "front"),
    "a map that culls, from the front": (SUN, "shadow_map: {cull: back", None, None),
    "a map": (SUN, "shadow_map: {cull: none", None, None),
    "shadow volumes": (SUN, "technique: {type: shadow_volumes", None, None),
}


def side_remarks_on(mesh, light, technique, folder):
    (folder / "open.obj").write_text(mesh)
    text = SIDES.format(mesh="open.obj", light=light, technique=f"{technique}}}")
    config = parse_config(text, folder=folder)
    with Progress(Console(quiet=True)) as progress:
        scene = load(config, progress).scene
    return list(side_remarks(config, build_technique(config), [scene]))


@pytest.mark.parametrize("name", LOST)
def test_an_open_mesh_that_casts_nothing_is_named_with_the_key_that_says_so(name, tmp_path):
    light, technique, key, side = LOST[name]
    found = side_remarks_on(CARD, light, technique, tmp_path)
    if key is None:
        assert found == []
        return
    (remark,) = found
    start = f"scene.meshes.1 ({tmp_path / 'open.obj'}) is an open mesh and casts no shadow: {key}, so only faces that "
    assert remark.startswith(f"{start}show their {side} to the light cast; set ")


def test_an_open_mesh_that_casts_only_a_part_of_its_shadow_is_named(tmp_path):
    # From the left, one half shows its front to the light, and the other its back.
    light = "{type: directional, azimuth: -60, elevation: 20}"
    (remark,) = side_remarks_on(PIPE, light, THREE, tmp_path)
    assert "is an open mesh and casts only a part of its shadow: technique.side is front" in remark
    assert side_remarks_on(PIPE, light, f"{THREE}, shadow_side: double", tmp_path) == []


@pytest.mark.exhaustive
def test_what_a_reference_says_of_its_pixels_is_remarked_on_once(tmp_path):
    Image.fromarray(np.full((64, 64), 255, np.uint8)).save(tmp_path / "reference.png", icc_profile=bytes(200))
    text = (
        SCENE.format(mesh="path: builtin:box, translate: [1, 0, 1]") + "reference: {type: image, path: reference.png}\n"
    )
    config = parse_config(text, folder=tmp_path)
    with Progress(Console(quiet=True)) as progress:
        (drawn,) = draw(config, load(config, progress), build_technique(config), progress)
    (remark,) = drawn.remarks
    assert remark.startswith(f"the image file {tmp_path / 'reference.png'} has the chunk iCCP")
