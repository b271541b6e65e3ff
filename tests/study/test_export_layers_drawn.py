"""A renderer that follows an export's page through cascades, the passes of moments, and a warp: OpenGL draws all of it
from the files alone."""

import json

import numpy as np
import pytest
import trimesh
from rich.console import Console

from diffshadow.config import build_scene, build_technique, load_config
from diffshadow.raster import draw_surface
from diffshadow.study import export_shader

SIDE, TEXELS, LAYERS = 128, 256, 3
MAP = """
#version 330
uniform mat4 world_to_eye, eye_to_clip;
uniform vec2 warp;
in vec3 position;
out float depth;
void main() {
    vec4 clip = eye_to_clip * world_to_eye * vec4(position, 1.0);
    depth = 0.5 * clip.z + 0.5;
    gl_Position = clip + 0.5 * warp.x * (clip.y + clip.w) * vec4(warp.y, 1, -1, 1);
}
"""
DEPTH = """
#version 330
in float depth;
void main() { gl_FragDepth = depth; }
"""
WHOLE = """
#version 330
in vec2 corner;
void main() { gl_Position = vec4(corner, 0.0, 1.0); }
"""
PASS = """
uniform sampler2D image;
out vec4 texel;
void main() { texel = PASS(image, ivec2(gl_FragCoord.xy)); }
"""
PLACES = """
#version 330
uniform mat4 world_to_camera, camera_to_clip;
in vec3 position;
out vec3 world;
out float depth;
void main() {
    vec4 eye = world_to_camera * vec4(position, 1.0);
    world = position;
    depth = -eye.z;
    gl_Position = camera_to_clip * eye;
}
"""
SHADED = """
uniform sampler2D map, moments;
uniform mat4 world_to_eye, eye_to_clip[LAYERS];
uniform vec2 warp;
uniform vec3 to_light;
in vec3 world;
in float depth;
out float lit;
void main() {
    vec3 normal = normalize(cross(dFdx(world), dFdy(world)));
    vec2 pixel = floor(gl_FragCoord.xy);
    lit = shadow(MAPS, world_to_eye, VIEW, world, normal, to_light, pixel, depth);
}
"""
CASES = {
    "cascades": (LAYERS, "{type: cascades, count: 3, blend: 0.2, select: map}", "{type: evsm, radius: 2}"),
    "warp": (1, "{type: perspective_warp}", "{type: pcf, radius: 1.5}"),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CASES)
def test_a_renderer_with_the_exported_files_draws_our_picture(gl, tmp_path, name):
    layers, layout, kernel = CASES[name]
    file = tmp_path / "knot.yaml"
    file.write_text(f"""
scene:
  meshes: [{{path: builtin:torus_knot, drop_to_ground: true}}, {{path: builtin:plane, options: {{size: 4}}}}]
  camera: {{eye: [2, 2, 3], target: [0, 0.3, 0], resolution: [{SIDE}, {SIDE}]}}
  light: {{type: directional, azimuth: 120, elevation: 50}}
technique: {layout}
shadow_map: {{resolution: [{TEXELS}, {TEXELS}]}}
bias: {{constant: 1, slope: 1, normal_offset: 0.3}}
filter: {kernel}
""")
    config = load_config(file, [])
    scene, technique = build_scene(config), build_technique(config, fitting=False)
    surface = draw_surface(scene.mesh, scene.camera)
    ours = np.asarray(technique.visibility(technique.prepare(scene, surface), surface))
    folder = export_shader(config, tmp_path / "out", "glsl", console=Console(quiet=True))
    view = scene.camera.view()
    drawn = _drawn(gl, folder, layers, np.asarray(view.world_to_eye), np.asarray(view.eye_to_clip))
    mask = np.asarray(surface.mask) & (drawn >= 0)
    assert mask.sum() > 0.99 * np.asarray(surface.mask).sum()
    assert (np.abs(drawn - ours)[mask] <= 1 / 255).mean() > 0.995
    assert 0.03 < (ours < 0.5)[mask].mean() < 0.7


def _drawn(gl, folder, layers, world_to_camera, camera_to_clip):
    """The picture (h, w); -1 where nothing is seen."""
    triangles = trimesh.load_scene(folder / "scene.glb").to_mesh().triangles.astype(np.float32)
    shader = (folder / "shadow.glsl").read_text()
    light = json.loads((folder / "light.json").read_text())["shadow.glsl"]
    to_eye, warp = np.array(light["world_to_eye"]), light.get("warp", [0.0, 0.0])
    to_clip = np.array(light["eye_to_clip, depths from -1 to 1"]).reshape(-1, 4, 4)
    corners = gl.buffer(np.ascontiguousarray(triangles).tobytes())
    screen = gl.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
    written = lambda matrix: np.ascontiguousarray(np.swapaxes(matrix, -1, -2), np.float32).tobytes()

    depths = gl.depth_texture((TEXELS, layers * TEXELS))
    depths.compare_func = ""
    depths.filter = (gl.NEAREST, gl.NEAREST)
    program = gl.program(vertex_shader=MAP, fragment_shader=DEPTH)
    program["world_to_eye"].write(written(to_eye))
    program["warp"] = tuple(warp)
    gl.enable_only(gl.DEPTH_TEST)
    gl.depth_func, gl.polygon_offset = "<", (0.0, 0.0)
    target = gl.framebuffer(depth_attachment=depths)
    target.use()
    target.clear(depth=1.0)
    for layer, projection in enumerate(to_clip):
        target.viewport = (0, layer * TEXELS, TEXELS, TEXELS)
        program["eye_to_clip"].write(written(projection))
        gl.vertex_array(program, [(corners, "3f", "position")]).render(gl.TRIANGLES)

    read = {"map": depths}
    page = (folder / "README.md").read_text()
    for step in ("shadow_blur_rows", "shadow_blur_columns"):
        row = next((line for line in page.splitlines() if f"`{step}(" in line), None)
        if row is None:
            continue
        width, height = map(int, row.split("|")[-2].split("x"))
        image = gl.texture((width, height), 4, dtype="f4")
        image.filter = (gl.NEAREST, gl.NEAREST)
        blur = gl.program(vertex_shader=WHOLE, fragment_shader=f"#version 330\n{shader}{PASS.replace('PASS', step)}")
        read.get("moments", depths).use(0)
        blur["image"] = 0
        gl.enable_only(gl.NOTHING)
        gl.framebuffer([image]).use()
        gl.vertex_array(blur, [(screen, "2f", "corner")]).render(gl.TRIANGLES)
        read["moments"] = image

    text = SHADED.replace("LAYERS", str(layers)).replace("MAPS", ", ".join(read))
    text = text.replace("VIEW", "eye_to_clip" if layers > 1 else "eye_to_clip[0], warp")
    shading = gl.program(vertex_shader=PLACES, fragment_shader=f"#version 330\n{shader}{text}")
    each = {"world_to_eye": to_eye, "eye_to_clip": to_clip}
    for name, matrix in {**each, "world_to_camera": world_to_camera, "camera_to_clip": camera_to_clip}.items():
        shading[name].write(written(matrix))
    shading["to_light"] = tuple(map(float, to_eye[2, :3]))
    if "warp" in shading:
        shading["warp"] = tuple(warp)
    for unit, (name, image) in enumerate(read.items()):
        image.use(unit)
        shading[name] = unit
    gl.enable_only(gl.DEPTH_TEST)
    picture = gl.framebuffer([gl.texture((SIDE, SIDE), 1, dtype="f4")], gl.depth_renderbuffer((SIDE, SIDE)))
    picture.use()
    picture.clear(red=-1.0)
    gl.vertex_array(shading, [(corners, "3f", "position")]).render(gl.TRIANGLES)
    return np.frombuffer(picture.read(components=1, dtype="f4"), np.float32).reshape(SIDE, SIDE)
