"""Draws clip-space triangles with OpenGL, in software and without a window."""

import ctypes
import os
from typing import NamedTuple

import numpy as np

# Every x86 machine computes alike with one thread and without the wider instructions, whose fused products round
# differently.
SETTINGS = {
    "EGL_PLATFORM": "surfaceless",
    "LIBGL_ALWAYS_SOFTWARE": "1",
    "GALLIUM_DRIVER": "llvmpipe",
    "LP_NUM_THREADS": "1",
    "LP_NATIVE_VECTOR_WIDTH": "128",
    "GALLIUM_OVERRIDE_CPU_CAPS": "sse4.1",
    "MESA_SHADER_CACHE_DISABLE": "true",
}

VERTEX_SHADER = """
#version 330
in vec4 position;
flat out int face;
void main() {
    gl_Position = position;
    face = gl_VertexID / 3;
}
"""

FRAGMENT_SHADER = """
#version 330
flat in int face;
out int winner;
void main() { winner = face; }
"""

# Constants of the OpenGL 3.3 specification.
GL_TEXTURE_2D, GL_TEXTURE_BORDER_COLOR = 0x0DE1, 0x1004
GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_BORDER = 0x2802, 0x2803, 0x812D
GL_DEPTH_COMPONENT, GL_DEPTH_COMPONENT32F = 0x1902, 0x8CAC
GL_RED_INTEGER = 0x8D94
GL_INT, GL_UNSIGNED_INT, GL_FLOAT = 0x1404, 0x1405, 0x1406
GL_COLOR, GL_DEPTH = 0x1800, 0x1801


Resolution = tuple[int, int]


class State(NamedTuple):
    """How triangles are drawn: what `glDepthFunc`, `glCullFace` and `glPolygonOffset` are given."""

    depth_function: str = "<"
    cull: str = "none"
    offset: tuple[float, float] = (0.0, 0.0)


class Drawing(NamedTuple):
    """What was drawn, row 0 at the bottom.

    - `winner`: (h, w), int32, the face seen at each pixel centre, -1 where there is none.
    - `depth`: (h, w); float32 window depth, or the whole number a 24-bit buffer holds as uint32.
    """

    winner: np.ndarray
    depth: np.ndarray


class OpenGL:
    """A software context that draws clip-space triangles."""

    def __init__(self):
        os.environ.update(SETTINGS)
        import moderngl  # reads the environment, and only this script needs it

        self.context = moderngl.create_context(standalone=True, backend="egl", require=330)
        self.renderer = self.context.info["GL_RENDERER"]
        self.version = self.context.info["GL_VERSION"]
        if "llvmpipe" not in self.renderer:
            raise RuntimeError(f"OpenGL is {self.renderer}; expected Mesa's llvmpipe: install libgl1-mesa-dri")
        self.program = self.context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
        self._address = ctypes.CDLL("libEGL.so.1").eglGetProcAddress
        self._address.restype = ctypes.c_void_p

    def _call(self, name: str, *arguments) -> None:
        # moderngl has no 32-bit float depth texture, no integer clear and no raw read of depth.
        ctypes.CFUNCTYPE(None, *map(type, arguments))(self._address(name.encode()))(*arguments)

    def draw(self, clip: np.ndarray, faces: np.ndarray, resolution: Resolution, bits: int, state: State) -> Drawing:
        """Draws `faces` (f, 3) of `clip` (v, 4), in order, to `resolution` with a depth buffer of 24 or 32 `bits`."""
        depth = self.depth_texture(clip, faces, resolution, bits, state)
        winner = self._read(resolution, GL_RED_INTEGER, GL_INT, np.int32)
        if bits == 32:
            z = self._read(resolution, GL_DEPTH_COMPONENT, GL_FLOAT, np.float32)
        else:
            # 24 bits come back in the upper part of 32.
            z = self._read(resolution, GL_DEPTH_COMPONENT, GL_UNSIGNED_INT, np.uint32) >> 8
        depth.release()
        return Drawing(winner, z)

    def depth_texture(self, clip, faces, resolution: Resolution, bits: int, state: State):
        """The texture of the depth buffer that the same drawing leaves; its framebuffer stays bound."""
        height, width = resolution
        gl = self.context
        colour = gl.texture((width, height), 1, dtype="i4")
        depth = gl.depth_texture((width, height))
        if bits == 32:
            i, e = ctypes.c_int, ctypes.c_uint
            self._call("glBindTexture", e(GL_TEXTURE_2D), e(depth.glo))
            arguments = (i(0), i(GL_DEPTH_COMPONENT32F), i(width), i(height), i(0), e(GL_DEPTH_COMPONENT), e(GL_FLOAT))
            self._call("glTexImage2D", e(GL_TEXTURE_2D), *arguments, ctypes.c_void_p(None))
        target = gl.framebuffer([colour], depth)
        target.use()
        self._clear()

        gl.enable_only(gl.DEPTH_TEST | (gl.CULL_FACE if state.cull != "none" else gl.NOTHING))
        gl.front_face = "ccw"
        gl.cull_face = state.cull if state.cull != "none" else "back"
        gl.depth_func = state.depth_function
        gl.polygon_offset = state.offset
        corners = gl.buffer(np.ascontiguousarray(clip[faces.reshape(-1)], np.float32).tobytes())
        gl.vertex_array(self.program, [(corners, "4f", "position")]).render(gl.TRIANGLES)
        gl.finish()
        return depth

    def clamp_to_border(self, texture, border: float) -> None:
        """Makes look-ups outside of `texture`, which is bound, find `border`."""
        e, i = ctypes.c_uint, ctypes.c_int
        for axis in (GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T):
            self._call("glTexParameteri", e(GL_TEXTURE_2D), e(axis), i(GL_CLAMP_TO_BORDER))
        colour = ctypes.cast((ctypes.c_float * 4)(*4 * [border]), ctypes.c_void_p)
        self._call("glTexParameterfv", e(GL_TEXTURE_2D), e(GL_TEXTURE_BORDER_COLOR), colour)

    def _clear(self) -> None:
        e, i = ctypes.c_uint, ctypes.c_int
        self._call("glClearBufferiv", e(GL_COLOR), i(0), ctypes.cast((ctypes.c_int * 4)(-1), ctypes.c_void_p))
        self._call("glClearBufferfv", e(GL_DEPTH), i(0), ctypes.cast((ctypes.c_float * 1)(1.0), ctypes.c_void_p))

    def _read(self, resolution: Resolution, layout: int, kind: int, dtype: type) -> np.ndarray:
        height, width = resolution
        pixels = np.empty((height, width), dtype)
        i, e = ctypes.c_int, ctypes.c_uint
        address = ctypes.c_void_p(pixels.ctypes.data)
        self._call("glReadPixels", i(0), i(0), i(width), i(height), e(layout), e(kind), address)
        return pixels
