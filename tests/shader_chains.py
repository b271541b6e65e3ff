"""Exported shaders run on this machine: GLSL by OpenGL, WGSL by WebGPU, and HLSL by way of SPIR-V and OpenGL."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _opengl import OpenGL

from diffshadow.shadow.layouts import AbstractFittedLight

GLSL_MAIN = """
uniform sampler2D positions, normals, ways, map, moments;
uniform mat4 world_to_eye[VIEWS], eye_to_clip[PROJECTIONS];
uniform vec2 warp;
out vec4 lit;
void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec2 pixel = vec2(texel);
    vec4 at = texelFetch(positions, texel, 0);
    vec3 position = at.xyz, normal = texelFetch(normals, texel, 0).xyz, way = texelFetch(ways, texel, 0).xyz;
    int layer = LAYER;
    lit = vec4(CALL);
}
"""
GLSL_PASS = """
uniform sampler2D map, moments;
out vec4 texel;
void main() { texel = PASS(ivec2(gl_FragCoord.xy)); }
"""
VERTEX = """
#version 330
in vec2 corner;
void main() { gl_Position = vec4(corner, 0.0, 1.0); }
"""
HLSL_MAIN = """
Texture2D<float4> positions : register(t0);
Texture2D<float4> normals : register(t1);
Texture2D<float4> ways : register(t2);
Texture2D<float> map : register(t3);
Texture2D<float4> moments : register(t4);
cbuffer matrices : register(b0) { float4x4 projections[PROJECTIONS]; float4x4 world_to_eye[VIEWS]; float2 warp; };
float4 main(float4 place : SV_Position) : SV_Target {
    int3 texel = int3(int(place.x), int(place.y), 0);
    float2 pixel = float2(texel.xy);
    float4 at = positions.Load(texel);
    float3 position = at.xyz;
    float3 normal = normals.Load(texel).xyz;
    float3 way = ways.Load(texel).xyz;
    int layer = LAYER;
    // One by one, since spirv-cross cannot copy arrays of matrices out of a block.
    float4x4 eye_to_clip[PROJECTIONS];
    for (int i = 0; i < PROJECTIONS; i++) { eye_to_clip[i] = projections[i]; }
    return CALL;
}
"""
HLSL_PASS = """
Texture2D<float> map : register(t0);
Texture2D<float4> moments : register(t1);
float4 main(float4 at : SV_Position) : SV_Target { return PASS(int2(int(at.x), int(at.y))); }
"""
WGSL_MAIN = """
struct Matrices { eye_to_clip: array<mat4x4f, PROJECTIONS>, world_to_eye: array<mat4x4f, VIEWS>, warp: vec2f }
@group(0) @binding(0) var map: texture_depth_2d;
@group(0) @binding(1) var<uniform> matrices: Matrices;
@group(0) @binding(2) var<storage, read> points: array<f32>;
@group(0) @binding(3) var<storage, read_write> lit: array<f32>;
@group(0) @binding(4) var moments: texture_2d<f32>;
fn vector(i: u32) -> vec3f { return vec3f(points[i], points[i + 1], points[i + 2]); }
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2f(f32(id.x % WIDTHu), f32(id.x / WIDTHu));
    let i = 10 * id.x;
    let at = vec4f(vector(i), points[i + 3]);
    let position = at.xyz;
    let normal = vector(i + 4);
    let way = vector(i + 7);
    let world_to_eye = matrices.world_to_eye;
    let eye_to_clip = matrices.eye_to_clip;
    let warp = matrices.warp;
    let layer = LAYER;
    lit[id.x] = CALL;
}
"""
WGSL_PASS = """
@group(0) @binding(0) var map: texture_depth_2d;
@group(0) @binding(1) var moments: texture_2d<f32>;
@group(0) @binding(2) var target_: texture_storage_2d<rgba32float, write>;
@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let size = vec2i(textureDimensions(target_));
    let texel = vec2i(id.xy);
    if (texel.x < size.x && texel.y < size.y) {
        textureStore(target_, vec2i(texel.x, size.y - 1 - texel.y), PASS(texel));
    }
}
"""
# A depth texture is written by a pass only.
WGSL_DEPTHS = """
@group(0) @binding(0) var<storage, read> depths: array<f32>;
@vertex fn corners(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(f32(i % 2) * 4 - 1, f32(i / 2) * 4 - 1, 0, 1);
}
@fragment fn stored(@builtin(position) at: vec4f) -> @builtin(frag_depth) f32 {
    return depths[u32(at.y) * WIDTHu + u32(at.x)];
}
"""


class Picture:
    """What a picture's shader reads: images of points (h, w, 3) from the bottom row, and the map with its matrices."""

    def __init__(self, shadow_map: Any, surface: Any, ways: Any, buffers: Any = ()):
        view, light = shadow_map.view, shadow_map.light
        is_fitted = isinstance(light, AbstractFittedLight)
        deep = light.depth(surface.position) if is_fitted else np.zeros_like(surface.position[..., 0])
        images = (np.concatenate([surface.position, deep[..., None]], axis=-1), surface.normal, ways)
        self.images = [np.ascontiguousarray(image, np.float32) for image in images]
        self.depths = np.asarray(shadow_map.depth, np.float32)
        self.world_to_eye = np.asarray(view.world_to_eye, np.float32).reshape(-1, 4, 4)
        self.eye_to_clip = np.asarray(view.eye_to_clip, np.float32).reshape(-1, 4, 4)
        self.warp = None if view.warp is None else (float(view.warp.strength), float(view.warp.center))
        self.buffers = buffers
        self._layer, arguments = "0", "world_to_eye[layer], eye_to_clip[0], position, normal, way, pixel, layer"
        if len(self.eye_to_clip) > 1:
            arguments = "world_to_eye[0], eye_to_clip, position, normal, way, pixel, at.w"
        elif self.warp is not None:
            arguments = "world_to_eye[0], eye_to_clip[0], warp, position, normal, way, pixel, at.w"
        elif len(self.world_to_eye) > 1:
            self._layer = "shadow_layer(-way)"
        self._arguments = arguments

    def main(self, text: str, shader: str) -> str:
        """A program's main function for this shader."""
        maps = "map, moments" if blurs(shader) else "map"
        filled = text.replace("CALL", f"shadow({maps}, {self._arguments})").replace("LAYER", self._layer)
        counts = {"VIEWS": len(self.world_to_eye), "PROJECTIONS": len(self.eye_to_clip)}
        for word, count in counts.items():
            filled = re.sub(rf"\b{word}\b", str(count), filled)
        return filled

    @property
    def stacked(self) -> np.ndarray:
        """The map, whose layers lie one above the other."""
        return self.depths.reshape(-1, self.depths.shape[-1])

    def matrices(self, from_zero: bool = False) -> bytes:
        """Projections, views and the warp, for a uniform block; projections to depths from 0 to 1 or from -1."""
        halved = np.diag([1.0, 1.0, 0.5, 1.0])
        halved[2, 3] = 0.5
        projections = halved @ self.eye_to_clip.astype(np.float64) if from_zero else self.eye_to_clip
        each = [*projections, *self.world_to_eye]
        columns = np.stack([matrix.T for matrix in each]).astype(np.float32)
        return columns.tobytes() + np.array([*(self.warp or (0, 0)), 0, 0], np.float32).tobytes()

    def pass_sizes(self, shader: str) -> tuple[tuple[int, int], tuple[int, int]]:
        """(height, width) of the targets of the two passes that blur."""
        found = re.search(r"SHADOW_BLUR_MARGIN\b.*= (\d+)", shader)
        assert found is not None
        margin, (height, width) = int(found[1]), self.depths.shape[-2:]
        layers = self.stacked.shape[0] // height
        return (layers * height, width + 2 * margin), (layers * (height + 2 * margin), width + 2 * margin)


def blurs(shader: str) -> bool:
    """Whether a shader has passes that blur the map."""
    return "shadow_blur_rows" in shader


PASSES = ("shadow_blur_rows(map, ", "shadow_blur_columns(moments, ")


class ByOpenGL:
    def __init__(self) -> None:
        try:
            self.context = OpenGL().context
        except Exception as error:
            pytest.skip(f"there is no OpenGL here: {error}")

    def __call__(self, shader: str, picture: Picture) -> np.ndarray:
        return self._of(shader, picture, picture.stacked, picture.matrices(), GLSL_PASS, GLSL_MAIN)

    def _of(
        self, shader: str, picture: Picture, depths: np.ndarray, matrices: bytes, blur: str, main: str
    ) -> np.ndarray:
        images = {"map": depths[..., None]}
        if blurs(shader):
            for call, size in zip(PASSES, picture.pass_sizes(shader), strict=True):
                drawn = self._drawn(self.compiled(shader + blur.replace("PASS(", call)), images, size)
                # Direct3D stores the top row first.
                images["moments"] = self.as_stored(drawn)
        images |= dict(zip(("positions", "normals", "ways"), picture.images, strict=True))
        whole = self.compiled(shader + picture.main(main, shader))
        return self._drawn(whole, images, picture.images[0].shape[:2], matrices, len(picture.eye_to_clip))[..., 0]

    def compiled(self, text: str) -> str:
        return f"#version 330\n{text}"

    def as_stored(self, image: np.ndarray) -> np.ndarray:
        return image

    def _drawn(
        self, fragment: str, images: dict[str, np.ndarray], size: tuple[int, int], matrices: bytes = b"", count: int = 0
    ) -> np.ndarray:
        import moderngl

        context = self.context
        program = context.program(vertex_shader=VERTEX, fragment_shader=fragment)
        if "matrices" in program:
            context.buffer(matrices).bind_to_uniform_block(0)
            program["matrices"].binding = 0
        parts = {
            "eye_to_clip": matrices[: 64 * count],
            "world_to_eye": matrices[64 * count : -16],
            "warp": matrices[-16:-8],
        }
        for name, data in parts.items():
            if name in program:
                program[name].write(data)
        for unit, (name, image) in enumerate(images.items()):
            height, width, channels = image.shape
            texture = context.texture((width, height), channels, np.ascontiguousarray(image).tobytes(), dtype="f4")
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.use(unit)
            # Which spirv-cross gives a longer name.
            for each in program:
                if re.search(rf"(^|Combined){name}($|SPIRV)", each):
                    program[each] = unit
        corners = context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
        height, width = size
        target = context.framebuffer([context.texture((width, height), 4, dtype="f4")])
        target.use()
        context.enable_only(context.NOTHING)
        context.vertex_array(program, [(corners, "2f", "corner")]).render(context.TRIANGLES)
        return np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(height, width, 4)


class BySpirv(ByOpenGL):
    """HLSL, which glslangValidator and spirv-cross turn into GLSL."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        for tool in ("glslangValidator", "spirv-cross"):
            if shutil.which(tool) is None:
                pytest.skip(f"{tool} is not installed")

    def __call__(self, shader: str, picture: Picture) -> np.ndarray:
        # Pixels and passes are counted from the lower end here, and only what is stored from the top.
        depths = picture.stacked[::-1]
        return self._of(shader, picture, depths, picture.matrices(from_zero=True), HLSL_PASS, HLSL_MAIN)

    def as_stored(self, image: np.ndarray) -> np.ndarray:
        return image[::-1]

    def compiled(self, text: str) -> str:
        source, binary = self.folder / "shader.hlsl", self.folder / "shader.spv"
        source.write_text(text)
        run = lambda *command: subprocess.run(list(map(str, command)), capture_output=True, text=True)
        compiled = run("glslangValidator", "-D", "-S", "frag", "-e", "main", "-V", source, "-o", binary)
        assert compiled.returncode == 0, compiled.stdout
        assert "WARNING" not in compiled.stdout
        crossed = run("spirv-cross", binary, "--version", "330", "--no-es")
        assert crossed.returncode == 0, crossed.stderr
        return crossed.stdout


class ByWebGPU:
    def __init__(self) -> None:
        wgpu = pytest.importorskip("wgpu")
        try:
            self.device = wgpu.gpu.request_adapter_sync().request_device_sync()
        except Exception as error:
            pytest.skip(f"there is no WebGPU here: {error}")

    def __call__(self, shader: str, picture: Picture) -> np.ndarray:
        import wgpu

        device, usage = self.device, wgpu.BufferUsage
        height, width = picture.images[0].shape[:2]
        points = np.concatenate(picture.images, axis=-1).reshape(-1, 10)
        made = lambda data, kind: {"buffer": device.create_buffer_with_data(data=data, usage=kind)}
        uniform, inputs = made(picture.matrices(from_zero=True), usage.UNIFORM), made(points, usage.STORAGE)
        lit = device.create_buffer(size=4 * len(points), usage=usage.STORAGE | usage.COPY_SRC)
        view = self._depths(picture.stacked).create_view()
        parts = [view, uniform, inputs, {"buffer": lit}]
        if blurs(shader):
            rows, columns = picture.pass_sizes(shader)
            first = self._blurred(shader, PASSES[0], {0: view}, rows)
            parts.append(self._blurred(shader, PASSES[1], {1: first}, columns))
        tables = [made(np.asarray(values, np.float32), usage.STORAGE) for values in picture.buffers]
        code = shader + picture.main(WGSL_MAIN, shader).replace("WIDTH", str(width))
        groups = [dict(enumerate(parts)), *([dict(enumerate(tables))] if tables else [])]
        self._computed(code, groups, len(points) // 64)
        return np.frombuffer(device.queue.read_buffer(lit), np.float32).reshape(height, width)

    def _blurred(self, shader: str, call: str, read: dict[int, Any], size: tuple[int, int]) -> Any:
        import wgpu

        height, width = size
        usage = wgpu.TextureUsage.STORAGE_BINDING | wgpu.TextureUsage.TEXTURE_BINDING
        target = self.device.create_texture(size=(width, height, 1), format="rgba32float", usage=usage).create_view()
        code = shader + WGSL_PASS.replace("PASS(", call)
        self._computed(code, [{**read, 2: target}], -(-width // 8), -(-height // 8))
        return target

    def _computed(self, code: str, groups: list[dict[int, Any]], *workgroups: int) -> None:
        module = self.device.create_shader_module(code=code)
        pipeline = self.device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})
        encoder = self.device.create_command_encoder()
        step = encoder.begin_compute_pass()
        step.set_pipeline(pipeline)
        for i, parts in enumerate(groups):
            step.set_bind_group(i, self._group(pipeline, parts, i))
        step.dispatch_workgroups(*workgroups)
        step.end()
        self.device.queue.submit([encoder.finish()])

    def _depths(self, depths: np.ndarray) -> Any:
        """A depth texture of these depths, whose first row is the bottom row."""
        import wgpu

        height, width = depths.shape
        usage = wgpu.TextureUsage.RENDER_ATTACHMENT | wgpu.TextureUsage.TEXTURE_BINDING
        texture = self.device.create_texture(size=(width, height, 1), format="depth32float", usage=usage)
        rows = np.ascontiguousarray(depths[::-1])
        buffer = self.device.create_buffer_with_data(data=rows, usage=wgpu.BufferUsage.STORAGE)
        module = self.device.create_shader_module(code=WGSL_DEPTHS.replace("WIDTH", str(width)))
        pipeline = self.device.create_render_pipeline(
            layout="auto",
            vertex={"module": module, "entry_point": "corners"},
            fragment={"module": module, "entry_point": "stored", "targets": []},
            depth_stencil={"format": "depth32float", "depth_write_enabled": True, "depth_compare": "always"},
            primitive={},
        )
        encoder = self.device.create_command_encoder()
        target = {"view": texture.create_view(), "depth_clear_value": 1.0}
        target |= {"depth_load_op": "clear", "depth_store_op": "store"}
        step = encoder.begin_render_pass(color_attachments=[], depth_stencil_attachment=target)
        step.set_pipeline(pipeline)
        step.set_bind_group(0, self._group(pipeline, {0: {"buffer": buffer}}))
        step.draw(3)
        step.end()
        self.device.queue.submit([encoder.finish()])
        return texture

    def _group(self, pipeline: Any, parts: dict[int, Any], number: int = 0) -> Any:
        entries = [{"binding": binding, "resource": part} for binding, part in parts.items()]
        return self.device.create_bind_group(layout=pipeline.get_bind_group_layout(number), entries=entries)
