"""Passes of OpenGL with which the rasterizer is compared: in software (Mesa's llvmpipe), or on a GPU."""

import os
from typing import NamedTuple

import numpy as np

SETTINGS = {
    "EGL_PLATFORM": "surfaceless",
    "LIBGL_ALWAYS_SOFTWARE": "1",
    "GALLIUM_DRIVER": "llvmpipe",
}
DEPTH_SHADERS = (
    """
#version 330
in vec4 clip;
void main() { gl_Position = clip; }
""",
    """
#version 330
void main() {}
""",
)
SURFACE_SHADERS = (
    """
#version 330
in vec4 clip;
in vec3 position, normal;
out vec3 world_position, world_normal;
void main() {
    gl_Position = clip;
    world_position = position;
    world_normal = normal;
}
""",
    """
#version 330
in vec3 world_position, world_normal;
layout(location = 0) out vec4 position_and_depth;
layout(location = 1) out vec4 normal_and_face;
void main() {
    position_and_depth = vec4(world_position, gl_FragCoord.z);
    normal_and_face = vec4(world_normal, float(gl_PrimitiveID));
}
""",
)


class Triangles(NamedTuple):
    """`clip` (v, 4) and `position` (v, 3) of the vertices, `faces` (f, 3), and `normals` (f, 3, 3) of their corners."""

    clip: np.ndarray
    position: np.ndarray
    faces: np.ndarray
    normals: np.ndarray

    def by_vertex(self) -> tuple[np.ndarray, np.ndarray]:
        """Unique rows of clip coordinates, position and normal (n, 10), and the corners' indices into them (3 f,)."""
        corners = np.concatenate(
            [self.clip[self.faces], self.position[self.faces], self.normals], axis=-1, dtype=np.float32
        ).reshape(-1, 10)
        # Rows are compared as bytes, which sorts far faster than column by column.
        keys = np.ascontiguousarray(corners).view(np.dtype((np.void, corners.itemsize * 10))).reshape(-1)
        _, first, index = np.unique(keys, return_index=True, return_inverse=True)
        return corners[first], index.astype(np.int32)


class OpenGL:
    """A depth pass and a surface pass, with their triangles already uploaded.

    The depth pass writes depth alone; the surface pass also writes depth, position, normal and face to float targets,
    32 bytes per pixel, from vertices that have a normal each.

    The GPU draws with `on_gpu`, and llvmpipe without.

    **Raises** moderngl's errors if there is no EGL, `ImportError` without moderngl, and `RuntimeError` if the driver is
    not the one asked for.
    """

    def __init__(self, triangles: Triangles, resolution: tuple[int, int], cull: str, on_gpu: bool = False):
        if not on_gpu:
            os.environ.update(SETTINGS)
        import moderngl  # optional; it reads the environment when it is first used

        height, width = resolution
        # The stub's type of `backend` is wrong.
        self.context = gl = moderngl.create_context(
            standalone=True,
            backend="egl",  # pyright: ignore[reportArgumentType]
            require=330,
        )
        self.name = f"{gl.info['GL_RENDERER']}, {gl.info['GL_VERSION']}"
        if on_gpu == ("llvmpipe" in self.name):
            expected = "a GPU's driver for EGL" if on_gpu else "Mesa's llvmpipe: install libgl1-mesa-dri"
            raise RuntimeError(f"OpenGL is {self.name}; expected {expected}")
        self.resolution, self.mode = resolution, gl.TRIANGLES

        program = gl.program(*DEPTH_SHADERS)
        clip = gl.buffer(np.ascontiguousarray(triangles.clip, np.float32).tobytes())
        indices = gl.buffer(np.ascontiguousarray(triangles.faces, np.int32).tobytes())
        self.depth_triangles = gl.vertex_array(program, [(clip, "4f", "clip")], index_buffer=indices)
        self.depth_target = gl.framebuffer([], gl.depth_renderbuffer((width, height)))

        program = gl.program(*SURFACE_SHADERS)
        vertices, index = (gl.buffer(values.tobytes()) for values in triangles.by_vertex())
        layout = [(vertices, "4f 3f 3f", "clip", "position", "normal")]
        self.surface_triangles = gl.vertex_array(program, layout, index_buffer=index)
        colours = [gl.texture((width, height), 4, dtype="f4") for _ in range(2)]
        self.surface_target = gl.framebuffer(colours, gl.depth_renderbuffer((width, height)))

        gl.enable_only(gl.DEPTH_TEST | gl.CULL_FACE)
        gl.front_face, gl.cull_face, gl.depth_func = "ccw", cull, "<"

    def draw_depth(self) -> None:
        self._draw(self.depth_target, self.depth_triangles)

    def draw_surface(self) -> None:
        self._draw(self.surface_target, self.surface_triangles)

    def _draw(self, target, triangles) -> None:
        target.use()
        target.clear(depth=1.0)
        triangles.render(self.mode)
        self.context.finish()

    def depth(self) -> np.ndarray:
        """The map that the depth pass drew last, (h, w), row 0 at the bottom."""
        stored = self.depth_target.read(components=1, attachment=-1, dtype="f4")
        return np.frombuffer(stored, "f4").reshape(self.resolution)

    def surface(self) -> np.ndarray:
        """What the surface pass drew last, (h, w, 8): position, depth, normal and face; row 0 at the bottom."""
        parts = [self.surface_target.read(components=4, attachment=k, dtype="f4") for k in range(2)]
        return np.concatenate([np.frombuffer(part, "f4").reshape(*self.resolution, 4) for part in parts], axis=-1)
