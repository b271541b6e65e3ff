"""The page of an export: what it holds, and in a browser what it draws, beside a render."""

import json

import numpy as np
import pytest
from in_browser import in_browser
from PIL import Image
from rich.console import Console

from diffshadow.config import build_scene, build_shading, build_technique, load_config
from diffshadow.raster import draw_surface
from diffshadow.shading import to_srgb
from diffshadow.study import compared_with, export_shader

TINY = """scene:
  meshes:
    - {path: builtin:box, drop_to_ground: true, albedo: [0.8, 0.4, 0.2]}
    - {path: builtin:plane, options: {size: 4}, casts: false}
  camera: {eye: [2, 2, 3], target: [0, 0.3, 0], resolution: [96, 128]}
  light: {type: spot, position: [1, 3, 1.5], target: [0, 0, 0], outer_angle: 30, near: 0.5, far: 6}
shadow_map: {resolution: [128, 128]}
bias: {constant: 0.25, slope: 0, normal_offset: 0}
filter: {type: pcf, radius: 1.5}
"""
# Each differs from `TINY` in these lines.
SCENES = {
    "a box under a spot light with a cone": ("scene.light.inner_angle=20", "shading.attenuation={quadratic: 0.1}"),
    "a sun, and a rotated disk": (
        "scene.light={azimuth: 40, elevation: 45}",
        "filter={type: random_disk, radius: 3, pattern: vogel, rotated: true}",
        "shading={model: phong, specular: 0.4, shininess: 20}",
    ),
    "a table of points, in a fixed-point map": ("filter={type: random_disk}", "shadow_map.depth_format=unorm16"),
    "a point light": ("scene.light={type: point, position: [0.9, 1.6, 0.9]}", "shadow_map.cull=front"),
    "shadow that darkens all light": ("shading={type: modulated, factor: 0.3}", "shadow_map.depth_format=unorm24"),
    "an orthographic camera, and an offset stored in the map": (
        "scene.camera.type=orthographic",
        "scene.camera.height=3",
        "shadow_map.polygon_offset=[1.5, 2]",
    ),
    "two lights": (
        "scene.lights=[{azimuth: 40, elevation: 45}, {type: spot, position: [-1, 3, 1], target: [0, 0, 0]}]",
        "scene.light=null",
        "shading.intensities=[0.9, [0.2, 0.4, 0.6]]",
    ),
}


def exported(folder, file, *overrides):
    """The folder of an export with a page, and its configuration."""
    config = load_config(file, overrides)
    compared = compared_with(config, file, overrides)
    return export_shader(config, folder, "glsl", console=Console(quiet=True), compared=compared), config, compared


def rendered(config):
    """The picture of a render, (h, w, 3) from its top row, from 0 to 255."""
    scene, technique = build_scene(config), build_technique(config, fitting=False)
    surface = draw_surface(scene.mesh, scene.camera)
    seen = [
        technique.visibility(technique.prepare(each), surface) for each in map(scene.lit_by, range(len(scene.lights)))
    ]
    linear = build_shading(config)(surface, seen, scene.lights, scene.camera)
    return 255 * to_srgb(np.clip(np.asarray(linear, np.float64), 0, 1))[::-1]


def equal_share(config, picture):
    """The share of pixels in a picture's file that differ from a render by at most 2 / 255."""
    return float((np.abs(np.asarray(Image.open(picture))[..., :3] - rendered(config)) <= 2).all(axis=-1).mean())


def look(folder, *pages):
    """What the browser finds on pages."""
    return json.loads(in_browser("draw_shader_pages.mjs", folder, *pages))


@pytest.mark.browser
@pytest.mark.exhaustive
def test_pages_draw_the_pictures_of_renders(tmp_path):
    file = tmp_path / "tiny.yaml"
    file.write_text(TINY)
    cases = [exported(tmp_path / str(i), file, *overrides) for i, overrides in enumerate(SCENES.values())]
    found = look(tmp_path, *(folder / "page.html" for folder, _, _ in cases))
    for i, (name, seen) in enumerate(zip(SCENES, found, strict=True)):
        assert 0 < seen["ms"][0] <= seen.pop("ms")[1]
        assert seen == {"requests": [], "errors": [], "messages": [], "failure": "", "back": True}, name
        _, config, compared = cases[i]
        pictures = [tmp_path / f"{i}_{k}.png" for k in (0, 1)]
        shares = [equal_share(each, picture) for each, picture in zip((compared.config, config), pictures, strict=True)]
        assert min(shares) > 0.995, (name, shares)
        # The settings differ, and so do the pictures.
        assert equal_share(config, pictures[0]) < 0.99, name
