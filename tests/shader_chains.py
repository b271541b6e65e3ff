"""Exported shaders run on this machine: GLSL by OpenGL, WGSL by WebGPU, and HLSL by way of SPIR-V and OpenGL."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _opengl import OpenGL

GLSL_MAIN = """
uniform sampler2D positions, normals, ways, depths;
uniform mat4 world_to_eye[SHADOW_LAYERS], eye_to_clip;
out float lit;
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec3 position = texelFetch(positions, pixel, 0).xyz, normal = texelFetch(normals, pixel, 0).xyz;
    vec3 way = texelFetch(ways, pixel, 0).xyz;
    int layer = LAYER(way);
    lit = shadow(depths, world_to_eye[layer], eye_to_clip, position, normal, way, vec2(pixel), layer);
}
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
Texture2D<float> depths : register(t3);
cbuffer matrices : register(b0) { float4x4 eye_to_clip; float4x4 world_to_eye[SHADOW_LAYERS]; };
float4 main(float4 at : SV_Position) : SV_Target {
    int3 pixel = int3(int(at.x), int(at.y), 0);
    float3 position = positions.Load(pixel).xyz;
    float3 normal = normals.Load(pixel).xyz;
    float3 way = ways.Load(pixel).xyz;
    int layer = LAYER(way);
    return shadow(depths, world_to_eye[layer], eye_to_clip, position, normal, way, float2(pixel.xy), layer);
}
"""
WGSL_MAIN = """
struct Matrices { eye_to_clip: mat4x4f, world_to_eye: array<mat4x4f, SHADOW_LAYERS> }
@group(0) @binding(0) var depths: texture_depth_2d;
@group(0) @binding(1) var<uniform> matrices: Matrices;
@group(0) @binding(2) var<storage, read> points: array<f32>;
@group(0) @binding(3) var<storage, read_write> lit: array<f32>;
fn vector(i: u32) -> vec3f { return vec3f(points[3 * i], points[3 * i + 1], points[3 * i + 2]); }
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2f(f32(id.x % WIDTHu), f32(id.x / WIDTHu));
    let i = 3 * id.x;
    let at = vector(i);
    let way = vector(i + 2);
    let layer = LAYER(way);
    let to_eye = matrices.world_to_eye[layer];
    lit[id.x] = shadow(depths, to_eye, matrices.eye_to_clip, at, vector(i + 1), way, pixel, layer);
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

    def __init__(self, shadow_map: Any, surface: Any, ways: Any):
        view = shadow_map.view
        images = (surface.position, surface.normal, ways)
        self.images = [np.ascontiguousarray(image, np.float32) for image in images]
        # Layers lie one above the other.
        self.depths = np.ascontiguousarray(shadow_map.depth, np.float32).reshape(-1, shadow_map.depth.shape[-1])
        self.world_to_eye = np.asarray(view.world_to_eye, np.float32).reshape(-1, 4, 4)
        self.eye_to_clip = np.asarray(view.eye_to_clip, np.float32)

    def main(self, text: str) -> str:
        """A program's main function, with the layer that it reads."""
        return text.replace("LAYER(way)", "shadow_layer(-way)" if len(self.world_to_eye) > 1 else "0")

    @property
    def eye_to_clip_from_zero(self) -> np.ndarray:
        """The projection to clip space with depths from 0 to 1."""
        halved = np.diag([1.0, 1.0, 0.5, 1.0])
        halved[2, 3] = 0.5
        return (halved @ self.eye_to_clip.astype(np.float64)).astype(np.float32)


class ByOpenGL:
    def __init__(self) -> None:
        try:
            self.context = OpenGL().context
        except Exception as error:
            pytest.skip(f"there is no OpenGL here: {error}")

    def __call__(self, shader: str, picture: Picture) -> np.ndarray:
        return self._drawn(
            f"#version 330\n{shader}{picture.main(GLSL_MAIN)}", picture, picture.depths, picture.eye_to_clip
        )

    def _drawn(self, fragment: str, picture: Picture, depths: np.ndarray, eye_to_clip: np.ndarray) -> np.ndarray:
        import moderngl

        context = self.context
        program = context.program(vertex_shader=VERTEX, fragment_shader=fragment)
        to_eye = b"".join(matrix.T.tobytes() for matrix in picture.world_to_eye)
        if "matrices" in program:
            context.buffer(eye_to_clip.T.tobytes() + to_eye).bind_to_uniform_block(0)
            program["matrices"].binding = 0
        else:
            program["world_to_eye"].write(to_eye)
            program["eye_to_clip"].write(eye_to_clip.T.tobytes())
        names = ("positions", "normals", "ways", "depths")
        for unit, (name, image) in enumerate(zip(names, [*picture.images, depths[..., None]], strict=True)):
            height, width, channels = image.shape
            texture = context.texture((width, height), channels, np.ascontiguousarray(image).tobytes(), dtype="f4")
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.use(unit)
            found = next(each for each in program if name in each)
            program[found] = unit
        corners = context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
        height, width = picture.images[0].shape[:2]
        target = context.framebuffer([context.texture((width, height), 1, dtype="f4")])
        target.use()
        context.enable_only(context.NOTHING)
        context.vertex_array(program, [(corners, "2f", "corner")]).render(context.TRIANGLES)
        return np.frombuffer(target.read(components=1, dtype="f4"), np.float32).reshape(height, width)


class BySpirv(ByOpenGL):
    """HLSL, which glslangValidator and spirv-cross turn into GLSL."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        for tool in ("glslangValidator", "spirv-cross"):
            if shutil.which(tool) is None:
                pytest.skip(f"{tool} is not installed")

    def __call__(self, shader: str, picture: Picture) -> np.ndarray:
        source, binary = self.folder / "shader.hlsl", self.folder / "shader.spv"
        source.write_text(shader + picture.main(HLSL_MAIN))
        run = lambda *command: subprocess.run(list(map(str, command)), capture_output=True, text=True)
        compiled = run("glslangValidator", "-D", "-S", "frag", "-e", "main", "-V", source, "-o", binary)
        assert compiled.returncode == 0, compiled.stdout
        assert "WARNING" not in compiled.stdout
        crossed = run("spirv-cross", binary, "--version", "330", "--no-es")
        assert crossed.returncode == 0, crossed.stderr
        return self._drawn(crossed.stdout, picture, picture.depths[::-1], picture.eye_to_clip_from_zero)


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
        points = np.concatenate(picture.images, axis=-1).reshape(-1, 9)
        matrices = np.stack([picture.eye_to_clip_from_zero.T, *(each.T for each in picture.world_to_eye)])
        uniform = device.create_buffer_with_data(data=np.ascontiguousarray(matrices), usage=usage.UNIFORM)
        inputs = device.create_buffer_with_data(data=points, usage=usage.STORAGE)
        lit = device.create_buffer(size=4 * len(points), usage=usage.STORAGE | usage.COPY_SRC)
        code = shader + picture.main(WGSL_MAIN).replace("WIDTH", str(width))
        module = device.create_shader_module(code=code)
        pipeline = device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})
        parts = [self._depths(picture.depths).create_view(), *({"buffer": each} for each in (uniform, inputs, lit))]
        encoder = device.create_command_encoder()
        step = encoder.begin_compute_pass()
        step.set_pipeline(pipeline)
        step.set_bind_group(0, self._group(pipeline, parts))
        step.dispatch_workgroups(len(points) // 64)
        step.end()
        device.queue.submit([encoder.finish()])
        return np.frombuffer(device.queue.read_buffer(lit), np.float32).reshape(height, width)

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
        step.set_bind_group(0, self._group(pipeline, [{"buffer": buffer}]))
        step.draw(3)
        step.end()
        self.device.queue.submit([encoder.finish()])
        return texture

    def _group(self, pipeline: Any, parts: list[Any]) -> Any:
        entries = [{"binding": i, "resource": part} for i, part in enumerate(parts)]
        return self.device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries)
