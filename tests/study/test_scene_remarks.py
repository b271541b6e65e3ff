"""Remarks on scenes: meshes that contribute nothing to the picture, meshes around lights, and what was left out of
files."""

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from diffshadow.config import build_scene, build_technique, parse_config
from diffshadow.raster import draw_surface
from diffshadow.study.runs._framing import dark_scene
from diffshadow.study.runs._progress import Stages
from diffshadow.study.runs._scene_remarks import scene_remarks
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
    with Stages(Console(quiet=True)) as stages:
        scene, messages = load(config, stages)
    return [*messages, *scene_remarks(config, [scene], draw_surface(scene.mesh, scene.camera))]


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


def test_a_mesh_that_is_mostly_out_of_the_picture_is_named_with_a_size(tmp_path):
    (remark,) = [each for each in remarks(LARGE, tmp_path) if "in the picture" in each]
    assert remark.startswith("scene.meshes.2 (builtin:sphere) is 6 × 6 × 6 world units large, with ")
    assert "set scene.meshes.2.size, to 3 for example, or move the camera at [0.0, 3.0, 5.0]" in remark
    # A ground is, too.
    assert not any(
        "in the picture" in each
        for each in remarks("path: builtin:plane, options: {size: 90}, translate: [0, 0.01, 0]", tmp_path)
    )


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
        (LARGE, ["scene.light.azimuth=180", "scene.light.elevation=0"], "is 6 × 6 × 6 world units large, with "),
        (
            BULB,
            [LAMP],
            "scene.light is inside scene.meshes.2 (builtin:sphere), which hides it from all that the camera",
        ),
        (CARD, ["scene.light.elevation=-60"], "all of it is turned away from the light, or in shadow; expected"),
    ],
    ids=["inside", "dark side", "bulb", "from below"],
)
def test_a_scene_that_no_light_reaches_has_nothing_to_compare(mesh, overrides, cause, tmp_path):
    said = darkness(tmp_path, *overrides, mesh=mesh)
    assert said is not None
    assert said.startswith("no light reaches what the camera sees, so that there is nothing to compare: ")
    assert cause in said


def test_a_scene_that_one_of_its_lights_reaches_can_be_compared(tmp_path):
    assert darkness(tmp_path) is None
    below, above = "{type: directional, elevation: -60}", "{type: directional, elevation: 60}"
    assert darkness(tmp_path, f"scene.lights=[{below}, {above}]", "scene.light=null") is None
    said = darkness(tmp_path, f"scene.lights=[{below}, {below}]", "scene.light=null")
    assert said is not None
    assert said.startswith("none of its lights reaches what the camera sees")


def test_what_a_mesh_file_holds_beside_triangles_is_left_out_with_a_remark(tmp_path):
    (tmp_path / "cage.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nl 1 3\nl 2 4\n")
    (remark,) = remarks("path: cage.obj, translate: [1, 0.2, 1]", tmp_path)
    assert remark == f"the mesh file {tmp_path / 'cage.obj'} is loaded without its 2 lines"


def test_what_a_reference_says_of_its_pixels_is_remarked_on_once(tmp_path):
    Image.fromarray(np.full((64, 64), 255, np.uint8)).save(tmp_path / "reference.png", icc_profile=bytes(200))
    text = (
        SCENE.format(mesh="path: builtin:box, translate: [1, 0, 1]") + "reference: {type: image, path: reference.png}\n"
    )
    config = parse_config(text, folder=tmp_path)
    with Stages(Console(quiet=True)) as stages:
        (drawn,) = draw(config, load(config, stages), build_technique(config), stages)
    (remark,) = drawn.remarks
    assert remark.startswith(f"the visibility file {tmp_path / 'reference.png'} has the chunk iCCP")
