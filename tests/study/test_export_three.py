"""The documentation's code for three.js draws our shadow from an export's files, in a browser."""

import json
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from in_browser import in_browser
from rich.console import Console

from diffshadow.config import build_scene, build_technique, load_config
from diffshadow.raster import draw_surface
from diffshadow.study import export_shader

ROOT = Path(__file__).parent.parent.parent
HEIGHT, WIDTH, TEXELS = 192, 256, 512


@pytest.mark.browser
@pytest.mark.exhaustive
def test_three_js_draws_our_shadow(tmp_path):
    file = tmp_path / "knot.yaml"
    file.write_text(f"""
scene:
  meshes: [{{path: builtin:torus_knot, drop_to_ground: true}}, {{path: builtin:plane, options: {{size: 4}}}}]
  camera: {{eye: [2, 2, 3], target: [0, 0.3, 0], resolution: [{HEIGHT}, {WIDTH}]}}
  light: {{azimuth: -60, elevation: 45}}
shadow_map: {{resolution: [{TEXELS}, {TEXELS}]}}
bias: {{constant: 1, slope: 1, normal_offset: 0.3}}
filter: {{type: pcf, radius: 1.5}}
""")
    config = load_config(file, [])
    scene, technique = build_scene(config), build_technique(config, fitting=False)
    surface = draw_surface(scene.mesh, scene.camera)
    ours = np.asarray(technique.visibility(technique.prepare(scene), surface))
    folder = export_shader(config, tmp_path / "out", "glsl", console=Console(quiet=True))
    (code,) = re.findall(r"```js\n(.*?)```", (ROOT / "docs" / "export.md").read_text(), re.DOTALL)
    (folder / "add_shadow.mjs").write_text(code)
    view, towards = scene.camera.view(), np.asarray(scene.light.towards(jnp.zeros(3)))
    job = {
        "width": WIDTH,
        "height": HEIGHT,
        "world_to_eye": np.asarray(view.world_to_eye).tolist(),
        "eye_to_clip": np.asarray(view.eye_to_clip).tolist(),
        "size": TEXELS,
        "towards": (towards / np.linalg.norm(towards)).tolist(),
    }
    (folder / "job.json").write_text(json.dumps(job))
    messages = json.loads(in_browser("draw_with_three.mjs", folder, packages=("playwright-core", "three")))
    assert not [message for message in messages if "GL Driver Message" not in message]
    drawn = np.fromfile(folder / "lit.bin", np.float32).reshape(HEIGHT, WIDTH)
    mask = np.asarray(surface.mask) & (drawn >= 0)
    assert mask.sum() > 0.7 * np.asarray(surface.mask).sum()
    assert (np.abs(drawn - ours)[mask] <= 2 / 255).mean() > 0.985
    assert 0.03 < (ours < 0.5)[mask].mean() < 0.7
