"""Exported shaders: the folder's files, and what its page says."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from diffshadow import geometry, io, shadow
from diffshadow.config import ConfigError, load_config
from diffshadow.study import compared_with, export_shader

ROOT = Path(__file__).parent.parent.parent
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


def export(tmp_path, text, language="glsl", *overrides, page=False):
    file = tmp_path / "lamps.yaml"
    file.write_text(text)
    config = load_config(file, overrides)
    compared = compared_with(config, file, overrides) if page else None
    return export_shader(config, tmp_path / "out", language, console=Console(quiet=True), compared=compared)


def test_folder_holds_a_shader_for_each_light_the_matrices_the_scene_and_a_page(tmp_path):
    folder = export(tmp_path, LAMPS)
    names = {"shadow_0.glsl", "shadow_1.glsl", "light.json", "README.md", "scene.glb"}
    assert {path.name for path in folder.iterdir()} == names
    assert len(io.read_scene(folder / "scene.glb").lights) == 2
    texts = [(folder / f"shadow_{i}.glsl").read_text() for i in (0, 1)]
    assert "SHADOW_0_PERSPECTIVE = false" in texts[0]
    assert "SHADOW_1_PERSPECTIVE = true" in texts[1]
    assert all(f"SHADOW_{i}_CONSTANT_BIAS = 0.25;" in text for i, text in enumerate(texts))
    assert "SHADOW_1_NEAR = 0.5;" in texts[1]
    assert "float shadow_1(sampler2D map, mat4" in texts[1]


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


SUN = """scene:
  meshes: [{path: builtin:box}, {path: builtin:plane, options: {size: 4}}]
  camera: {eye: [2, 2, 3], target: [0, 0, 0], resolution: [16, 16]}
shadow_map: {resolution: [64, 64]}
bias: {constant: 1, slope: 1, normal_offset: 0}
filter: {type: msm, radius: 1.5}
"""


def test_page_says_how_moments_of_cascades_are_drawn(tmp_path):
    folder = export(tmp_path, SUN, "hlsl", "technique={type: cascades, count: 3}")
    page = (folder / "README.md").read_text()
    # The blur reads one texel on each side, and the moments are two wider.
    assert "| 1 | `shadow_blur_rows(map, texel)` | the shadow map | 68 x 192 |" in page
    assert "| 2 | `shadow_blur_columns(rows, texel)` | the target of pass 1 | 68 x 204 |" in page
    assert "`texel`: `int2(int(at.x), height - 1 - int(at.y))`" in page
    assert "| size in texels | 64 x 192, 3 layers of 64 x 64 |" in page
    assert "shadow(map, moments, world_to_eye, eye_to_clip, position, normal, to_light, pixel, depth);" in page
    matrices = json.loads((folder / "light.json").read_text())["shadow.hlsl"]
    assert np.shape(matrices["eye_to_clip, depths from 0 to 1"]) == (3, 4, 4)
    assert np.shape(matrices["world_to_eye"]) == (4, 4)


@pytest.mark.exhaustive
def test_page_says_how_a_warped_map_is_drawn(tmp_path):
    kernel = "filter={type: random_disk, samples: 16, pattern_size: 4}"
    folder = export(tmp_path, SUN, "wgsl", "technique={type: perspective_warp}", kernel)
    page = (folder / "README.md").read_text()
    assert "shadow(map, world_to_eye, eye_to_clip, warp, position, normal, to_light, pixel, depth);" in page
    assert "clip + 0.5 * warp.x * (clip.y + clip.w) * vec4(warp.y, 1, 0, 1)" in page
    assert len(json.loads((folder / "light.json").read_text())["shadow.wgsl"]["warp"]) == 2
    ((name, buffer),) = json.loads((folder / "buffers.json").read_text()).items()
    assert (name, buffer["group"], buffer["binding"], len(buffer["values"])) == ("SHADOW_PATTERN", 1, 0, 2 * 16 * 4**2)


CONFIGS = {
    "quickstart": (),
    "room": (),
    "corridor": ("technique={type: cascades, select: map, blend: 0.2}", "filter={type: pcf, radius: 2}"),
    "street": ("filter={type: evsm, radius: 2}",),
    "terrain": ("technique={type: perspective_warp}", "filter={type: pcss, light_size: 0.5, max_radius: 4}"),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CONFIGS)
def test_exports_of_configurations_compile_without_a_warning(name, tmp_path):
    for tool in ("glslangValidator", "naga"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    config = load_config(Path(__file__).parents[2] / f"configs/{name}.yaml", CONFIGS[name])
    main = {"glsl": "void main() {}", "hlsl": "float4 main() : SV_Target { return 0; }", "wgsl": ""}
    heads = {"glsl": "#version 300 es\nprecision highp float;\nprecision highp sampler2D;\n"}
    compilers = {
        "glsl": "glslangValidator -S frag",
        "hlsl": "glslangValidator -D -S frag -e main -V -o /dev/null",
        "wgsl": "naga",
    }
    for language, command in compilers.items():
        folder = export_shader(config, tmp_path / language, language, console=Console(quiet=True))
        for file in folder.glob(f"shadow*.{language}"):
            whole = tmp_path / f"whole.{language}"
            whole.write_text(heads.get(language, "") + file.read_text() + main[language])
            ran = subprocess.run([*command.split(), whole], capture_output=True, text=True)
            said = ran.stdout + ran.stderr
            assert ran.returncode == 0, said
            assert "warning" not in said.lower()


def test_what_has_no_shader_is_refused_before_a_file_is_written(tmp_path):
    with pytest.raises(ConfigError, match=r"IrregularZBuffer, which has no shader: .*; the most similar is"):
        export(tmp_path, SUN, "glsl", "technique={type: irregular_z_buffer}")
    with pytest.raises(ConfigError, match=r"map.silhouettes is true, .*: the most similar is a map of more texels"):
        export(tmp_path, SUN, "glsl", "filter={type: pcf}", "shadow_map.silhouettes=true")
    assert not (tmp_path / "out").exists()


def test_page_holds_the_exported_shader_and_values_beside_the_defaults(tmp_path):
    folder = export(tmp_path, LAMPS, "glsl", page=True)
    page = (folder / "page.html").read_text()
    data = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])
    before, after = (setting["shaders"] for setting in data["settings"])
    for number, lines in enumerate(after):
        _, _, text = (folder / f"shadow_{number}.glsl").read_text().partition("\n")
        # Each light has a program of its own, and its function the plain name.
        text = re.sub(f"(?i)(shadow)_?{number}([A-Z_(])", r"\1\2", text)
        assert "\n".join(data["lines"][line] for line in lines) == text
    assert "const float SHADOW_CONSTANT_BIAS = 0.25;" not in [data["lines"][i].split("  //")[0] for i in before[0]]
    assert re.search(r"<th>bias.constant</th><td[^>]*>[\d.]+</td><td[^>]*>0.25</td><td>texels</td>", page)
    assert data["mesh"]["faces"] == 14
    assert data["mesh"]["casters"] == 12
    assert not re.findall(r"https?://", page)
    assert len(page) < 100_000


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("shadow_map.depth_layer=midpoint", "depth_layer is 'midpoint'"),
        ("shading.type=modulated", "modulated with 2 lights"),
    ],
)
def test_what_the_page_does_not_draw_is_refused_before_a_file_is_written(tmp_path, override, words):
    with pytest.raises(ConfigError, match=words):
        export(tmp_path, LAMPS, "glsl", override, "shadow_map.cull=none", page=True)
    assert not (tmp_path / "out").exists()


def test_a_fit_is_compared_with_its_start(tmp_path):
    fit = "reference: {samples: 1}\nfit: {parameters: {bias.constant: {initial: 3, lower: 0, upper: 8}}}\n"
    (tmp_path / "config.yaml").write_text(f"{LAMPS}{fit}")
    (tmp_path / "fitted.yaml").write_text(LAMPS.replace("constant: 0.25", "constant: 1.5"))
    config = load_config(tmp_path / "fitted.yaml", ["filter.type=nearest"])
    start = compared_with(config, tmp_path / "fitted.yaml", ["filter.type=nearest"])
    assert (start.start, start.config.bias.constant, start.config.filter.type) == ("before the fit", 3, "nearest")


def test_steps_of_the_documentation_are_exported_code():
    page = (ROOT / "docs" / "export.md").read_text()
    steps = page[page.index("## A shadow map, step by step") : page.index("## What can be exported")]
    light = geometry.DirectionalLight((0.5, -1.0, -0.3), (0.0, 0.0, 0.0), (4.0, 4.0), -4.0, 4.0)
    kernels = shadow.Nearest(), shadow.PercentageCloser(1.5), shadow.RandomDisk(3.0, shadow.vogel(16, rotated=True))
    mappings = [shadow.ShadowMapping(kernel, shadow.Bias(1.0, 1.0, 0.5)) for kernel in kernels]
    exported = {line.strip() for each in mappings for line in shadow.to_shader(each, light).split("\n")}
    shown = [line for block in re.findall(r"```glsl\n(.*?)```", steps, re.DOTALL) for line in block.splitlines()]
    # The first is of the vertex shader that draws the map.
    assert len(shown) > 10
    assert not [line for line in shown[1:] if line.strip() not in exported]
    assert not [name for name in re.findall(r"\((images/\S+)\)", steps) if not (ROOT / "docs" / name).is_file()]
