"""Scenes with shadow volumes, and OpenGL's two-sided stencil counts of them.

Volumes are made here by dictionaries of edges in float64, apart from those of the package.
"""

import ctypes
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import trimesh
from _opengl import GL_DEPTH_COMPONENT, GL_FLOAT, OpenGL

RESOLUTION = (72, 96)
ASPECT = 96 / 72
NEAR = 0.2

# Constants of the OpenGL 3.3 specification.
GL_FRAMEBUFFER, GL_RENDERBUFFER = 0x8D40, 0x8D41
GL_DEPTH32F_STENCIL8, GL_DEPTH_STENCIL, GL_DEPTH_STENCIL_ATTACHMENT = 0x8CAD, 0x84F9, 0x821A
GL_STENCIL_TEST, GL_STENCIL_INDEX, GL_UNSIGNED_BYTE = 0x0B90, 0x1901, 0x1401
GL_FRONT, GL_BACK, GL_ALWAYS, GL_KEEP = 0x0404, 0x0405, 0x0207, 0x1E00
GL_INCR_WRAP, GL_DECR_WRAP = 0x8507, 0x8508


class StencilScene(NamedTuple):
    """What is drawn, in clip space with the far plane at infinity.

    - `clip`: (v, 4), float32, `w` = 0 in eye space for vertices at infinity.
    - `faces`: (f, 3), what is seen.
    - `volume_faces`: (t, 3), those of the shadow volumes; `weights`: (t,), how often each counts, negative for those
        that count turned over.
    """

    name: str
    clip: np.ndarray
    faces: np.ndarray
    volume_faces: np.ndarray
    weights: np.ndarray


class Camera(NamedTuple):
    """Looks from `eye` to `target`; a vertical field of view of 50 degrees."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]

    def clip(self, points: np.ndarray) -> np.ndarray:
        """Clip coordinates (v, 4) of homogeneous `points` (v, 4), far plane at infinity."""
        backward = np.subtract(self.eye, self.target)
        backward /= np.linalg.norm(backward)
        right = np.cross((0, 1, 0), backward)
        right /= np.linalg.norm(right)
        rows = np.stack([right, np.cross(backward, right), backward])
        x, y, z = rows @ (points[:, :3] - points[:, 3:] * self.eye).T
        scale = 1 / np.tan(np.deg2rad(25))
        # In this order z equals w at infinity whatever the rounding.
        return np.stack([scale / ASPECT * x, scale * y, -z - 2 * NEAR * points[:, 3], -z], axis=1).astype(np.float32)


def orientations(vertices: np.ndarray, faces: np.ndarray, light: np.ndarray, closed: bool) -> np.ndarray:
    """+1 for faces whose front the homogeneous `light` (4,) sees, and for the others 0 if `closed`, else -1."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    to_light = light[:3] - light[3] * (a + b + c) / 3
    sees_front = np.sum(to_light * np.cross(b - a, c - b), axis=1) > 0
    return np.where(sees_front, 1, 0 if closed else -1)


def volumes(
    vertices: np.ndarray, faces: np.ndarray, light: np.ndarray, closed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Homogeneous vertices at infinity (v, 4), one for each of `vertices`, and the volumes' faces and weights."""
    turn = orientations(vertices, faces, light, closed)
    at_infinity = np.concatenate([light[3] * vertices - light[:3], np.zeros((len(vertices), 1))], axis=1)
    sides = Counter()
    for face, weight in zip(faces.tolist(), turn.tolist(), strict=True):
        for start, end in zip(face, face[1:] + face[:1], strict=True):
            sides[min(start, end), max(start, end)] += weight if start < end else -weight
    n = len(vertices)
    triangles, weights = [], []
    for (a, b), weight in sorted(sides.items()):
        if weight:
            triangles += [(b, a, a + n), (b, a + n, b + n)]
            weights += [weight, weight]
    counted = turn != 0
    caps = faces[counted]
    triangles = np.concatenate([np.array(triangles).reshape(-1, 3), caps, caps + n])
    return at_infinity, triangles, np.concatenate([weights, turn[counted], -turn[counted]]).astype(np.int8)


def scene(name: str, casters: trimesh.Trimesh, light: tuple[float, ...], camera: Camera, closed: bool) -> StencilScene:
    """`casters` over a ground that receives only."""
    vertices, faces = np.asarray(casters.vertices, np.float64), np.asarray(casters.faces)
    at_infinity, volume_faces, weights = volumes(vertices, faces, np.array(light, np.float64), closed)
    ground = np.array([[-6, -1.2, -6], [-6, -1.2, 6], [6, -1.2, 6], [6, -1.2, -6]])
    finite = lambda points: np.concatenate([points, np.ones((len(points), 1))], axis=1)
    clip = camera.clip(np.concatenate([finite(vertices), at_infinity, finite(ground)]))
    below = 2 * len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    small = np.int16 if len(clip) < 1 << 15 else np.int32
    return StencilScene(name, clip, np.concatenate([faces, below]).astype(small), volume_faces.astype(small), weights)


def fins() -> trimesh.Trimesh:
    """Five sheets that meet in one upright edge, of which two are wound the other way."""
    angles = np.deg2rad([10, 80, 150, 215, 290])
    rim = [[np.cos(a), y, np.sin(a)] for a in angles for y in (-0.8, 0.9)]
    vertices = np.array([[0, -0.8, 0], [0, 0.9, 0], *rim])
    faces = []
    for k in range(len(angles)):
        low, high = 2 + 2 * k, 3 + 2 * k
        sheet = [[0, low, high], [0, high, 1]]
        faces += [face[::-1] for face in sheet] if k % 2 else sheet
    return trimesh.Trimesh(vertices, faces, process=False)


def bowl() -> trimesh.Trimesh:
    """Half of a sphere, open, on its side."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    middle = ball.triangles_center
    return trimesh.Trimesh(ball.vertices, ball.faces[middle @ [0.8, 0.5, 0.3] > 0.1], process=False)


def scenes() -> Iterator[StencilScene]:
    sun, lamp = (-0.5, 1.0, 0.3, 0.0), (-1.5, 3.2, 1.1, 1.0)
    torus = trimesh.creation.torus(0.9, 0.35, major_sections=24, minor_sections=12)
    box = trimesh.creation.box((1.1, 1.3, 0.9))
    aside, inside = Camera((2.2, 1.9, 3.4), (0.2, -0.5, 0)), Camera((1.0, -0.85, -0.45), (0.1, -0.7, 0.2))
    yield scene("box_sun", box, sun, aside, closed=True)
    yield scene("box_lamp", box, lamp, aside, closed=True)
    yield scene("torus_sun", torus, sun, aside, closed=True)
    yield scene("torus_lamp", torus, lamp, aside, closed=True)
    yield scene("torus_eye_inside", torus, (-1.6, 2.0, 1.2, 1.0), inside, closed=True)
    yield scene("box_eye_inside", box, lamp, Camera((0.9, -0.9, -0.8), (-3.0, -1.6, 2.4)), closed=True)
    yield scene("bowl_sun", bowl(), sun, aside, closed=False)
    yield scene("bowl_lamp", bowl(), lamp, aside, closed=False)
    yield scene("fins_sun", fins(), sun, aside, closed=False)
    yield scene("fins_lamp", fins(), lamp, aside, closed=False)


class Stencil:
    """Counts fragments of shadow volumes with OpenGL `gl`, against a 32-bit float depth buffer."""

    def __init__(self, gl: OpenGL):
        self.gl = gl

    def counts(self, scene: StencilScene, when: str) -> np.ndarray:
        """Front less back faces of the volumes at each pixel, (h, w) int8, that `pass` or `fail` the depth test."""
        height, width = RESOLUTION
        gl, call = self.gl.context, self.gl._call
        e, i, f = ctypes.c_uint, ctypes.c_int, ctypes.c_float
        target = gl.framebuffer([gl.texture((width, height), 1, dtype="i4")])
        target.use()
        number = e(0)
        call("glGenRenderbuffers", i(1), ctypes.cast(ctypes.byref(number), ctypes.c_void_p))
        call("glBindRenderbuffer", e(GL_RENDERBUFFER), number)
        call("glRenderbufferStorage", e(GL_RENDERBUFFER), e(GL_DEPTH32F_STENCIL8), i(width), i(height))
        attach = (e(GL_FRAMEBUFFER), e(GL_DEPTH_STENCIL_ATTACHMENT), e(GL_RENDERBUFFER), number)
        call("glFramebufferRenderbuffer", *attach)
        # moderngl, which does not know of the buffer, has just switched this off.
        call("glDepthMask", ctypes.c_ubyte(1))
        call("glClearBufferfi", e(GL_DEPTH_STENCIL), i(0), f(1), i(0))

        gl.enable_only(gl.DEPTH_TEST)
        gl.depth_func = "<"
        gl.front_face = "ccw"
        self._draw(scene.clip, scene.faces)

        call("glDepthMask", ctypes.c_ubyte(0))
        call("glEnable", e(GL_STENCIL_TEST))
        call("glStencilFunc", e(GL_ALWAYS), i(0), e(0xFF))
        for side, change in ((GL_FRONT, GL_INCR_WRAP), (GL_BACK, GL_DECR_WRAP)):
            failed, passed = (change, GL_KEEP) if when == "fail" else (GL_KEEP, change)
            call("glStencilOpSeparate", e(side), e(GL_KEEP), e(failed), e(passed))
        for sign, front in ((1, "ccw"), (-1, "cw")):
            gl.front_face = front
            for least in range(1, int(np.abs(scene.weights).max()) + 1):
                self._draw(scene.clip, scene.volume_faces[sign * scene.weights >= least])
        counts = self._read(GL_STENCIL_INDEX, GL_UNSIGNED_BYTE, np.int8)
        depth = self._read(GL_DEPTH_COMPONENT, GL_FLOAT, np.float32)
        if not ((depth > 0) & (depth < 1)).any():
            raise RuntimeError(f"nothing of {scene.name} was drawn; expected a framebuffer with depth and stencil")

        call("glDisable", e(GL_STENCIL_TEST))
        call("glDepthMask", ctypes.c_ubyte(1))
        call("glDeleteRenderbuffers", i(1), ctypes.cast(ctypes.byref(number), ctypes.c_void_p))
        target.release()
        return counts

    def _draw(self, clip: np.ndarray, faces: np.ndarray) -> None:
        if len(faces):
            gl = self.gl.context
            corners = gl.buffer(np.ascontiguousarray(clip[faces.reshape(-1)], np.float32).tobytes())
            gl.vertex_array(self.gl.program, [(corners, "4f", "position")]).render(gl.TRIANGLES)
            gl.finish()

    def _read(self, layout: int, kind: int, dtype: type) -> np.ndarray:
        return self.gl._read(RESOLUTION, layout, kind, dtype)
