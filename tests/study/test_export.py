"""Exported shaders: the folder's files, and what its page says."""

import json
import re

import numpy as np
import pytest
from rich.console import Console

from diffshadow import io
from diffshadow.config import ConfigError, load_config
from diffshadow.study import export_shader

LAMPS = """scene:
  meshes:
    - {path: builtin:box}
    - {path: builtin:plane, options: {size: 4}, casts: false}
  camera: {eye: [2, 2, 3], target: [0, 0, 0]}
  lights:
    - {type: directional, direction: [0.3, -1.0, 0.2]}
    - {type: spot, position: [1, 3, 1], target: [0, 0, 0], outer_angle: 30, near: 0.5, far: 6}
shadow_map: {resolution: [64, 128], cull: front, depth_format: unorm24}
bias: {constant: 0.25, slope: 0, normal_offset: 0}
filter: {type: bilinear}
"""


def export(tmp_path, text, language="glsl", *overrides):
    file = tmp_path / "lamps.yaml"
    file.write_text(text)
    config = load_config(file, overrides)
    return export_shader(config, tmp_path / "out", language, console=Console(quiet=True))


def test_folder_holds_a_shader_for_each_light_the_matrices_the_scene_and_a_page(tmp_path):
    folder = export(tmp_path, LAMPS)
    names = {"shadow_0.glsl", "shadow_1.glsl", "light.json", "README.md", "scene.glb"}
    assert {path.name for path in folder.iterdir()} == names
    assert len(io.read_scene(folder / "scene.glb").lights) == 2
    texts = [(folder / f"shadow_{i}.glsl").read_text() for i in (0, 1)]
    assert ["SHADOW_PERSPECTIVE = true" in text for text in texts] == [False, True]
    assert all("SHADOW_CONSTANT_BIAS = 0.25;" in text for text in texts)
    assert "SHADOW_NEAR = 0.5;" in texts[1]


def test_matrices_are_of_both_clip_spaces(tmp_path):
    light = json.loads((export(tmp_path, LAMPS) / "light.json").read_text())["shadow_1.glsl"]
    to_eye = np.array(light["world_to_eye"])
    # A metre before the lamp, on its axis.
    at = np.array([1, 3, 1]) - np.array([1, 3, 1]) / np.sqrt(11)
    eye = to_eye @ [*at, 1]
    assert eye == pytest.approx([0, 0, -1, 1], abs=1e-6)
    depth = 6 * (1 - 0.5) / (1 * (6 - 0.5))
    whole, half = (np.array(light[f"eye_to_clip, depths from {low} to 1"]) @ eye for low in (-1, 0))
    assert whole[2] / whole[3] == pytest.approx(2 * depth - 1, abs=1e-6)
    assert half[2] / half[3] == pytest.approx(depth, abs=1e-6)


def test_page_says_how_the_map_is_drawn(tmp_path):
    page = (export(tmp_path, LAMPS, "wgsl", "shadow_map.polygon_offset=[1.5, 4]") / "README.md").read_text()
    rows = dict(re.findall(r"^\| (.*?) \| (.*) \|$", page, re.MULTILINE))
    assert rows["size in texels"] == "128 x 64 | 128 x 64 | 128 x 64"
    assert rows["format"].startswith("`GL_DEPTH_COMPONENT24` | `depth24plus`")
    assert "`glCullFace(GL_FRONT)`" in page
    assert "`glPolygonOffset(1.5, 4)` | `depthBiasSlopeScale: 1.5, depthBias: 4`" in page
    assert "in WGSL (WebGPU)" in page
    assert "the light is at (1, 3, 1)" in page


def test_what_has_no_shader_is_refused_before_a_file_is_written(tmp_path):
    with pytest.raises(ConfigError, match="VarianceShadowMap, which has no shader"):
        export(tmp_path, LAMPS, "glsl", "filter.type=vsm")
    assert not (tmp_path / "out").exists()
