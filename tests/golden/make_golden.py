"""Draws the golden scenes with OpenGL and stores them beside this script.

    python tests/golden/make_golden.py

needs moderngl, and Mesa's libEGL and llvmpipe (on Debian: libegl1 and libgl1-mesa-dri).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from _opengl import OpenGL, State

FOLDER = Path(__file__).parent
# One for nearly all scenes, so that a test compiles little.
RESOLUTION = (72, 96)
ASPECT = 96 / 72


class Scene(NamedTuple):
    """Triangles in clip space and how to draw them: `clip` (v, 4), `faces` (f, 3), `resolution` (height, width)."""

    name: str
    clip: np.ndarray
    faces: np.ndarray
    resolution: tuple[int, int]
    state: State = State()


def perspective(points: np.ndarray, aspect: float, near: float = 0.5, far: float = 20.0) -> np.ndarray:
    """Clip coordinates of eye-space `points` (v, 3) under a vertical field of view of 60 degrees."""
    x, y, z = np.asarray(points, np.float64).T
    scale = np.sqrt(3)
    return np.stack([scale / aspect * x, scale * y, -((far + near) * z + 2 * far * near) / (far - near), -z], axis=1)


def orthographic(points: np.ndarray, aspect: float, height: float = 3.0, near: float = 0.5, far: float = 9.5):
    x, y, z = np.asarray(points, np.float64).T
    depth = -(2 * z + far + near) / (far - near)
    return np.stack([2 * x / (height * ASPECT), 2 * y / height, depth, np.ones_like(x)], axis=1)


def from_window(window: np.ndarray, resolution: tuple[int, int], z: np.ndarray | float = 0.0) -> np.ndarray:
    """Clip coordinates, `w` = 1, of window coordinates (v, 2) in pixels; `z` in [-1, 1]."""
    height, width = resolution
    x, y = np.asarray(window, np.float64).T
    return np.stack([2 * x / width - 1, 2 * y / height - 1, np.broadcast_to(z, x.shape), np.ones_like(x)], axis=1)


def turned(mesh: trimesh.Trimesh, towards: tuple[float, float, float], degrees: float, at: tuple[float, float, float]):
    matrix = trimesh.transformations.rotation_matrix(np.deg2rad(degrees), towards)
    return mesh.vertices @ matrix[:3, :3].T + at


def closed_meshes() -> Iterator[Scene]:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=28, minor_sections=16)
    box = trimesh.creation.box((1.4, 1.0, 1.8))
    points = turned(sphere, (1, 2, 3), 20, (0.3, -0.2, -3))
    yield Scene("sphere_perspective", perspective(points, ASPECT), sphere.faces, RESOLUTION)
    points = turned(box, (1, 2, 0.5), 50, (0, 0, -2.6))
    yield Scene("box_perspective", perspective(points, ASPECT), box.faces, RESOLUTION)
    yield Scene("box_orthographic", orthographic(points, ASPECT), box.faces, RESOLUTION)
    points = turned(torus, (1, 0.3, 0), 55, (0, 0, -3.4))
    for cull in ("none", "back", "front"):
        state = State(cull=cull)
        yield Scene(f"torus_cull_{cull}", perspective(points, ASPECT), torus.faces, RESOLUTION, state)
    yield Scene("torus_orthographic", orthographic(points, ASPECT), torus.faces, RESOLUTION)


def edges_through_centres() -> Iterator[Scene]:
    """Every inner edge passes through pixel centres; each must be owned by one of its two triangles."""
    columns, rows = np.meshgrid(np.arange(12), np.arange(8))
    corners = np.stack([columns.ravel() * 7 + 4.5, rows.ravel() * 7 + 4.5], axis=1)
    first = (rows[:-1, :-1] * 12 + columns[:-1, :-1]).ravel()
    rising = np.concatenate([np.stack([first, first + 1, first + 13], 1), np.stack([first, first + 13, first + 12], 1)])
    falling = np.concatenate(
        [np.stack([first, first + 1, first + 12], 1), np.stack([first + 1, first + 13, first + 12], 1)]
    )
    for name, faces in (("rising", rising), ("falling", falling)):
        yield Scene(f"grid_{name}_anticlockwise", from_window(corners, RESOLUTION), faces, RESOLUTION)
        yield Scene(f"grid_{name}_clockwise", from_window(corners, RESOLUTION), faces[:, ::-1], RESOLUTION)
    # Slopes of all small whole ratios, round a centre.
    rim = [(x, y) for x in range(-24, 25, 3) for y in (-24, 24)]
    rim += [(x, y) for x in (-24, 24) for y in range(-21, 22, 3)]
    rim = np.array(sorted(rim, key=lambda p: np.arctan2(p[1], p[0])))
    corners = np.concatenate([[[0, 0]], rim]) + np.array([40.5, 30.5])
    k = np.arange(len(rim))
    fan = np.stack([0 * k, 1 + k, 1 + (k + 1) % len(rim)], axis=1)
    depth = np.concatenate([[-0.5], np.full(len(rim), 0.5)])
    yield Scene("fan", from_window(corners, RESOLUTION, depth), fan, RESOLUTION)
    yield Scene("fan_clockwise", from_window(corners, RESOLUTION, depth), fan[:, ::-1], RESOLUTION)


def random_triangles() -> Iterator[Scene]:
    random = np.random.default_rng(20240501)
    size = np.where(np.arange(200) % 4 == 0, 1.5, np.where(np.arange(200) % 4 == 1, 40.0, 12.0))
    middle = random.uniform((6, 6), (90, 66), (200, 1, 2))
    corners = middle + size[:, None, None] * random.uniform(-1, 1, (200, 3, 2))
    slivers = np.arange(200) % 10 == 0
    # Moved onto the line through the other two, up to a hundredth of a pixel.
    along = random.uniform(0, 1, (200, 1)) * (corners[:, 1] - corners[:, 0]) + corners[:, 0]
    corners[slivers, 2] = (along + random.uniform(-0.01, 0.01, (200, 2)))[slivers]
    corners = np.clip(corners, 0.5, (95.5, 71.5)).reshape(-1, 2)
    depth = random.uniform(-0.95, 0.95, 600)
    clip = from_window(corners, RESOLUTION, depth)
    faces = np.arange(600).reshape(200, 3)
    yield Scene("soup", clip, faces, RESOLUTION)
    w = random.uniform(0.3, 5, (600, 1))
    yield Scene("soup_perspective", clip * w, faces, RESOLUTION)
    yield Scene("soup_cull_back", clip * w, faces, RESOLUTION, State(cull="back"))
    # Corners on all 1/512ths of a pixel, so that half of them lie midway between two of the 256.
    middle = random.integers(4 * 512, 60 * 512, (300, 1, 2))
    corners = (middle + random.integers(-1800, 1800, (300, 3, 2))).reshape(-1, 2) / 512
    # A width that is a power of two keeps the 512ths exact in clip space.
    square = (64, 64)
    clip = from_window(corners, square, random.uniform(-0.9, 0.9, 900))
    yield Scene("subpixel_ties", clip, np.arange(900).reshape(300, 3), square)


def clipped_triangles() -> Iterator[Scene]:
    """Triangles that reach beyond the frustum."""
    random = np.random.default_rng(7)
    floor = np.array([[-8, -1, -30], [8, -1, -30], [8, -1, 3], [-8, -1, 3], [-5, 2, 1], [6, 2, -9], [0, 1, -28]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5]])
    yield Scene("crossing_near_and_far", perspective(floor, ASPECT), faces, RESOLUTION)
    room = trimesh.creation.box((6, 4, 8))
    points = turned(room, (0, 1, 0), 25, (0.5, 0.3, 0))
    yield Scene("surrounding_the_eye", perspective(points, ASPECT, far=6.5), room.faces, RESOLUTION)
    soup = random.uniform((-4, -3, -8), (4, 3, 4), (120, 1, 3)) + random.normal(0, 1.2, (120, 3, 3))
    faces = np.arange(360).reshape(120, 3)
    yield Scene("soup_around_the_eye", perspective(soup.reshape(-1, 3), ASPECT), faces, RESOLUTION)
    behind = perspective(soup.reshape(-1, 3) * (1, 1, -0.2) + (0, 0, 1.5), ASPECT)
    wholly_behind = behind[behind[:, 3].reshape(-1, 3).max(axis=1).repeat(3) < 0]
    yield Scene("behind_the_eye", wholly_behind, faces[: len(wholly_behind) // 3], RESOLUTION)
    soup = random.uniform((-1.5, -1.2, -1.6), (1.5, 1.2, 1.6), (90, 3, 3)).reshape(-1, 3)
    yield Scene(
        "soup_through_all_planes",
        np.concatenate([soup, np.ones((270, 1))], axis=1),
        np.arange(270).reshape(90, 3),
        RESOLUTION,
    )
    for reach in (4, 5, 6):
        # Each has its corners some 10^reach pixels away, and an edge or its inside in the image.
        angle = random.uniform(0, 2 * np.pi, (12, 1)) + np.array([0, 2.1, 4.2])
        corners = 10**reach * random.uniform(0.3, 1, (12, 3))[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        inner = random.uniform((10, 10), (86, 62), (12, 2))
        corners[:, 0] = inner
        depth = random.uniform(-0.9, 0.9, 36)
        clip = from_window(corners.reshape(-1, 2), RESOLUTION, depth)
        yield Scene(f"reaching_1e{reach}_pixels", clip, np.arange(36).reshape(12, 3), RESOLUTION)


def depth_tests() -> Iterator[Scene]:
    crossed = np.array(
        [
            *([10, 10, -0.6], [90, 15, 0.7], [50, 70, 0.1]),
            *([90, 12, -0.5], [12, 14, 0.8], [45, 72, -0.2]),
            *([5, 40, 0.3], [95, 36, 0.31], [50, 5, -0.9]),
        ]
    )
    clip = from_window(crossed[:, :2], RESOLUTION, crossed[:, 2])
    yield Scene("interpenetrating", clip, np.arange(9).reshape(3, 3), RESOLUTION)
    quad = np.array([[12.3, 8.1], [70.7, 9.9], [73.2, 60.4], [15.5, 66.6]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    plane = quad @ (0.006, -0.004)
    twice = from_window(np.concatenate([quad, quad]), RESOLUTION, np.concatenate([plane, plane]))
    for name, function in (("less", "<"), ("lequal", "<=")):
        faces_twice = np.concatenate([faces, faces + 4])
        yield Scene(f"coincident_{name}", twice, faces_twice, RESOLUTION, State(function))
        # One at the near and one at the far plane, where the cleared depth is.
        ends = from_window(np.concatenate([quad, quad + np.array([15, 5])]), RESOLUTION, np.repeat([1.0, -1.0], 4))
        yield Scene(f"near_and_far_plane_{name}", ends, faces_twice, RESOLUTION, State(function))


def polygon_offsets() -> Iterator[Scene]:
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12)
    points = turned(torus, (1, 0.3, 0), 55, (0, 0, -3.4))
    for factor, units in ((0, 4), (2, 0), (1.1, 4), (-1.5, -8), (0, 4e6), (3, 1e6)):
        name = f"offset_{factor:g}_{units:g}".replace("+", "").replace("-", "minus_").replace(".", "_")
        state = State(offset=(factor, units))
        yield Scene(name, perspective(points, ASPECT), torus.faces, RESOLUTION, state)


def scenes() -> Iterator[Scene]:
    yield from closed_meshes()
    yield from edges_through_centres()
    yield from random_triangles()
    yield from clipped_triangles()
    yield from depth_tests()
    yield from polygon_offsets()


def main() -> None:
    gl = OpenGL()
    for old in FOLDER.glob("*.npz"):
        old.unlink()
    for scene in scenes():
        clip, faces = scene.clip.astype(np.float32), scene.faces.astype(np.int32)
        as_float = gl.draw(clip, faces, scene.resolution, 32, scene.state)
        as_unorm = gl.draw(clip, faces, scene.resolution, 24, scene.state)
        np.savez_compressed(
            FOLDER / f"{scene.name}.npz",
            clip=clip,
            faces=faces,
            depth_function=scene.state.depth_function,
            cull=scene.state.cull,
            offset=np.array(scene.state.offset, np.float32),
            winner=as_float.winner.astype(np.int16),
            depth=as_float.depth,
            winner_24=as_unorm.winner.astype(np.int16),
            depth_24=as_unorm.depth,
        )
        print(f"{scene.name}: {len(faces)} faces, {np.mean(as_float.winner >= 0):.0%} of {scene.resolution} covered")
    total = sum(path.stat().st_size for path in FOLDER.glob("*.npz"))
    print(f"{gl.renderer}, OpenGL {gl.version}: {total / 1e6:.2f} MB in {FOLDER}")


if __name__ == "__main__":
    main()
