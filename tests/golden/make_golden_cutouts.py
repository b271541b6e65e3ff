"""Draws golden scenes with an alpha test, by `discard` in a fragment shader, and stores them in `cutouts`.

    python tests/golden/make_golden_cutouts.py

needs what `make_golden.py` needs.
"""

import ctypes
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _opengl import (
    GL_DEPTH_COMPONENT,
    GL_DEPTH_COMPONENT32F,
    GL_FLOAT,
    GL_INT,
    GL_RED_INTEGER,
    GL_TEXTURE_2D,
    OpenGL,
)
from make_golden import ASPECT, RESOLUTION, perspective

FOLDER = Path(__file__).parent / "cutouts"
CUTOFFS = (0.5, 0.35)

VERTEX_SHADER = """
#version 330
in vec4 position;
in vec2 uv;
in float index;
out vec2 at;
flat out int face;
flat out int number;
void main() {
    gl_Position = position;
    at = uv;
    face = gl_VertexID / 3;
    number = int(index);
}
"""

FRAGMENT_SHADER = """
#version 330
uniform sampler2D first;
uniform sampler2D second;
uniform vec2 cutoffs;
in vec2 at;
flat in int face;
flat in int number;
out int winner;
void main() {
    if (number == 0 && texture(first, at).r < cutoffs.x) discard;
    if (number == 1 && texture(second, at).r < cutoffs.y) discard;
    winner = face;
}
"""


class Scene(NamedTuple):
    """Triangles in clip space: `clip` (v, 4), `faces` (f, 3), `uv` (f, 3, 2), and the texture of each, -1 for none."""

    name: str
    clip: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    index: np.ndarray


def textures() -> list[np.ndarray]:
    """The alpha (h, w) of a fence, and of foliage: row 0 is the bottom row."""
    row, column = np.indices((16, 24))
    fence = ((column % 6 < 2) | (row % 8 == 3)).astype(np.float32)
    return [fence, np.random.default_rng(3).uniform(0, 1, (8, 16)).astype(np.float32)]


def quad(corners: list[tuple[float, float, float]], repeats: tuple[float, float]):
    u, v = repeats
    uv = np.array([(0, 0), (u, 0), (u, v), (0, v)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return np.array(corners, float), faces, uv[faces]


def scenes() -> Iterator[Scene]:
    parts = [
        quad([(-1.5, -1, -2.2), (1.2, -1, -3.6), (1.2, 0.9, -3.6), (-1.5, 0.9, -2.2)], (3.0, 2.0)),
        quad([(-1.2, -1, -3.4), (1.4, -1, -2.4), (1.4, 0.8, -2.4), (-1.2, 0.8, -3.4)], (2.5, 3.5)),
        quad([(-4, -1, 2), (4, -1, 2), (4, -1, -12), (-4, -1, -12)], (1.0, 1.0)),
    ]
    yield _scene("fences", parts, [0, 1, -1])
    # A fence beside the eye, which reaches behind it.
    parts = [
        quad([(-0.9, -0.8, 1.0), (0.6, -0.8, -6.0), (0.6, 0.8, -6.0), (-0.9, 0.8, 1.0)], (6.0, 1.5)),
        quad([(1.0, -0.7, 0.5), (0.7, -0.7, -7.0), (0.7, 0.7, -7.0), (1.0, 0.7, 0.5)], (-40.25, 7.5)),
        quad([(-3, -2, -9), (3, -2, -9), (3, 2, -9), (-3, 2, -9)], (1.0, 1.0)),
    ]
    yield _scene("behind_the_eye", parts, [0, 1, -1])
    random = np.random.default_rng(11)
    soup = random.uniform((-2, -1.6, -7), (2, 1.6, -2), (80, 1, 3)) + random.normal(0, 0.5, (80, 3, 3))
    faces = np.arange(240).reshape(80, 3)
    clip = perspective(soup.reshape(-1, 3), ASPECT)
    yield Scene("leaves", clip, faces, random.uniform(-2, 2, (80, 3, 2)), random.integers(-1, 2, 80))


def _scene(name: str, parts, index: list[int]) -> Scene:
    starts = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    faces = np.concatenate([own + start for (_, own, _), start in zip(parts, starts, strict=False)])
    clip = perspective(np.concatenate([points for points, _, _ in parts]), ASPECT)
    uv = np.concatenate([uv for _, _, uv in parts])
    return Scene(name, clip, faces, uv, np.repeat(index, [len(own) for _, own, _ in parts]))


def draw(gl: OpenGL, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The face that each pixel sees, -1 for none, and the depth."""
    height, width = RESOLUTION
    context = gl.context
    program = context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
    for unit, (name, alpha) in enumerate(zip(("first", "second"), textures(), strict=True)):
        texture = context.texture(alpha.shape[::-1], 1, alpha.tobytes(), dtype="f4")
        texture.filter, texture.repeat_x, texture.repeat_y = (context.LINEAR, context.LINEAR), True, True
        texture.use(unit)
        program[name] = unit
    program["cutoffs"] = CUTOFFS
    colour, depth = context.texture((width, height), 1, dtype="i4"), context.depth_texture((width, height))
    i, e = ctypes.c_int, ctypes.c_uint
    gl._call("glActiveTexture", e(0x84C0 + 5))
    gl._call("glBindTexture", e(GL_TEXTURE_2D), e(depth.glo))
    size = i(width), i(height), i(0), e(GL_DEPTH_COMPONENT), e(GL_FLOAT), ctypes.c_void_p(None)
    gl._call("glTexImage2D", e(GL_TEXTURE_2D), i(0), i(GL_DEPTH_COMPONENT32F), *size)
    context.framebuffer([colour], depth).use()
    gl._clear()
    context.enable_only(context.DEPTH_TEST)
    context.depth_func = "<"
    clip = scene.clip[scene.faces.reshape(-1)].astype(np.float32)
    uv, index = scene.uv.reshape(-1, 2).astype(np.float32), np.repeat(scene.index, 3)[:, None].astype(np.float32)
    corners = context.buffer(np.concatenate([clip, uv, index], axis=1).astype(np.float32).tobytes())
    context.vertex_array(program, [(corners, "4f 2f 1f", "position", "uv", "index")]).render(context.TRIANGLES)
    context.finish()
    winner = gl._read(RESOLUTION, GL_RED_INTEGER, GL_INT, np.int32)
    return winner, gl._read(RESOLUTION, GL_DEPTH_COMPONENT, GL_FLOAT, np.float32)


def main() -> None:
    gl = OpenGL()
    FOLDER.mkdir(exist_ok=True)
    fence, foliage = textures()
    for scene in scenes():
        winner, depth = draw(gl, scene)
        np.savez_compressed(
            FOLDER / f"{scene.name}.npz",
            clip=scene.clip.astype(np.float32),
            faces=scene.faces.astype(np.int32),
            uv=scene.uv.astype(np.float32),
            index=scene.index.astype(np.int32),
            fence=fence,
            foliage=foliage,
            cutoffs=np.array(CUTOFFS, np.float32),
            winner=winner.astype(np.int16),
            depth=depth,
        )
        print(f"{scene.name}: {len(scene.faces)} faces, {np.mean(winner >= 0):.0%} covered")


if __name__ == "__main__":
    main()
