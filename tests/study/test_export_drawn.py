"""A renderer of one's own that follows an export's page: OpenGL draws the map and the picture from its files alone."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from rich.console import Console

from diffshadow.config import build_scene, build_technique, load_config
from diffshadow.raster import draw_surface
from diffshadow.study import export_shader

ROOT = Path(__file__).parent.parent.parent
SIDE, TEXELS = 128, 256
DEPTHS = """
#version 330
uniform mat4 world_to_clip;
in vec3 position;
void main() { gl_Position = world_to_clip * vec4(position, 1.0); }
"""
NOTHING = """
#version 330
void main() {}
"""
PLACES = """
#version 330
uniform mat4 world_to_clip;
in vec3 position;
out vec3 world;
void main() { world = position; gl_Position = world_to_clip * vec4(position, 1.0); }
"""
# The fragment shader of the documentation, which has a place for the exported one.
(SHADED,) = re.findall(r"```glsl\n(#version 330\n.*?)```", (ROOT / "docs" / "export.md").read_text(), re.DOTALL)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kernel", ["{type: pcf, radius: 1.5}", "{type: random_disk, radius: 2.5}"])
def test_a_renderer_with_the_exported_files_draws_our_picture(gl, tmp_path, kernel):
    file = tmp_path / "knot.yaml"
    file.write_text(f"""
scene:
  meshes: [{{path: builtin:torus_knot, drop_to_ground: true}}, {{path: builtin:plane, options: {{size: 4}}}}]
  camera: {{eye: [2, 2, 3], target: [0, 0.3, 0], resolution: [{SIDE}, {SIDE}]}}
  light: {{type: spot, position: [1, 3, 1.5], target: [0, 0, 0]}}
shadow_map: {{resolution: [{TEXELS}, {TEXELS}], depth_format: unorm24}}
bias: {{constant: 1, slope: 1, normal_offset: 0.3}}
filter: {kernel}
""")
    config = load_config(file, [])
    scene, technique = build_scene(config), build_technique(config, fitting=False)
    surface = draw_surface(scene.mesh, scene.camera)
    ours = np.asarray(technique.visibility(technique.prepare(scene), surface))
    folder = export_shader(config, tmp_path / "out", "glsl", console=Console(quiet=True))

    triangles = trimesh.load_scene(folder / "scene.glb").to_mesh().triangles.astype(np.float32)
    light = json.loads((folder / "light.json").read_text())["shadow.glsl"]
    to_eye, to_clip = (np.array(light[name]) for name in ("world_to_eye", "eye_to_clip, depths from -1 to 1"))
    view = scene.camera.view()
    drawn = _drawn(gl, triangles, (folder / "shadow.glsl").read_text(), to_eye, to_clip, np.asarray(view.matrix))

    mask = np.asarray(surface.mask) & (drawn >= 0)
    assert mask.sum() > 0.99 * np.asarray(surface.mask).sum()
    assert (np.abs(drawn - ours)[mask] <= 1 / 255).mean() > 0.995
    assert 0.03 < (ours < 0.5)[mask].mean() < 0.7


def _drawn(gl, triangles, shader, to_eye, to_clip, world_to_camera):
    """The picture (h, w); -1 where nothing is seen."""
    corners = gl.buffer(np.ascontiguousarray(triangles).tobytes())
    written = lambda matrix: np.ascontiguousarray(matrix.T, np.float32).tobytes()
    depths = gl.depth_texture((TEXELS, TEXELS))
    depths.compare_func = ""
    depths.filter = (gl.NEAREST, gl.NEAREST)
    to_map = gl.program(vertex_shader=DEPTHS, fragment_shader=NOTHING)
    to_map["world_to_clip"].write(written(to_clip @ to_eye))
    gl.enable_only(gl.DEPTH_TEST)
    gl.depth_func, gl.polygon_offset = "<", (0.0, 0.0)
    gl.framebuffer(depth_attachment=depths).use()
    gl.clear(depth=1.0)
    gl.vertex_array(to_map, [(corners, "3f", "position")]).render(gl.TRIANGLES)

    shading = gl.program(vertex_shader=PLACES, fragment_shader=SHADED.replace("// shadow.glsl", shader))
    lamp = np.linalg.inv(to_eye)[:3, 3]
    values = {"world_to_clip": world_to_camera, "world_to_eye": to_eye, "eye_to_clip": to_clip}
    for name, matrix in values.items():
        shading[name].write(written(matrix))
    shading["lamp"] = tuple(map(float, lamp))
    depths.use(0)
    shading["depths"] = 0
    picture = gl.framebuffer([gl.texture((SIDE, SIDE), 1, dtype="f4")], gl.depth_renderbuffer((SIDE, SIDE)))
    picture.use()
    picture.clear(red=-1.0)
    gl.vertex_array(shading, [(corners, "3f", "position")]).render(gl.TRIANGLES)
    return np.frombuffer(picture.read(components=1, dtype="f4"), np.float32).reshape(SIDE, SIDE)
