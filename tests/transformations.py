"""Changes of a scene after which its shadows follow from those before.

Each leaves the picture as it is, turns it or mirrors it. So whatever a technique draws before must be drawn after, too,
without knowing what is right.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from diffshadow.geometry import (
    DirectionalLight,
    MatrixCamera,
    MatrixLight,
    Mesh,
    Scene,
)
from diffshadow.shadow import AbstractEngineShadows, Pattern

Image = Any
"""Of rows and columns (h, w, ...)."""


def similarity(
    turn: float = 0.0, axis: Any = (0, 1, 0), scale: float = 1.0, move: Any = (0, 0, 0), mirror: Any = (1, 1, 1)
) -> np.ndarray:
    """The matrix (4, 4) that mirrors, turns by so many degrees, scales and moves, in this order."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    angle, cross = np.deg2rad(turn), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    linear = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * linear @ np.diag(mirror), move
    return matrix


# --- All of a scene moved ---


class _Moved(NamedTuple):
    """A similarity: how points move, and how directions do, which keep their length."""

    matrix: np.ndarray
    linear: np.ndarray
    scale: float
    mirrors: bool

    @classmethod
    def by(cls, matrix: Any) -> "_Moved":
        matrix = np.asarray(matrix, float)
        determinant = np.linalg.det(matrix[:3, :3])
        scale = float(np.cbrt(abs(determinant)))
        return cls(matrix, matrix[:3, :3] / scale, scale, bool(determinant < 0))

    def point(self, points: Any) -> np.ndarray:
        return np.asarray(points, float) @ self.matrix[:3, :3].T + self.matrix[:3, 3]

    def way(self, directions: Any) -> np.ndarray:
        return np.asarray(directions, float) @ self.linear.T

    def view(self, world_to_eye: Any, eye_to_clip: Any) -> tuple[np.ndarray, np.ndarray]:
        flip, size = np.diag([-1.0 if self.mirrors else 1.0, 1, 1, 1]), np.diag([self.scale] * 3 + [1.0])
        pose = flip @ size @ np.asarray(world_to_eye, float) @ np.linalg.inv(self.matrix)
        return pose, flip @ np.asarray(eye_to_clip, float) @ np.linalg.inv(size) @ flip


def placed(scene: Scene, matrix: Any) -> Scene:
    """All of the scene moved by a similarity `matrix` (4, 4). If it mirrors, pictures and maps become mirrored, from
    left to right."""
    to = _Moved.by(matrix)
    meshes, lights = (
        [_placed_mesh(mesh, to) for mesh in scene.meshes],
        [_placed_light(each, to) for each in scene.lights],
    )
    return Scene(meshes, _placed_camera(scene.camera, to), lights, scene.casts, scene.receives)


def _placed_mesh(mesh: Mesh, to: _Moved) -> Mesh:
    order = [0, 2, 1] if to.mirrors else [0, 1, 2]
    faces, normals = np.asarray(mesh.faces)[:, order], to.way(mesh.corner_normals)[:, order]
    return Mesh(to.point(mesh.vertices), faces, normals, mesh.albedo)


def _placed_camera(camera: Any, to: _Moved) -> Any:
    if isinstance(camera, MatrixCamera):
        moved = to.view(camera.world_to_eye, camera.eye_to_clip)
        return MatrixCamera(*moved, camera.resolution, camera.is_perspective)
    parts = {"eye": to.point(camera.eye), "target": to.point(camera.target), "up": to.way(camera.up)}
    parts |= {name: getattr(camera, name) * to.scale for name in ("near", "far", "height") if hasattr(camera, name)}
    return dataclasses.replace(camera, **parts)


def _placed_light(light: Any, to: _Moved) -> Any:
    if isinstance(light, MatrixLight):
        return MatrixLight(*to.view(light.world_to_eye, light.eye_to_clip), light.is_perspective)
    how = {"position": to.point, "center": to.point, "direction": to.way, "up": to.way}
    how |= dict.fromkeys(("near", "far", "extent", "radius"), lambda size: size * to.scale)
    return dataclasses.replace(
        light, **{name: of(getattr(light, name)) for name, of in how.items() if hasattr(light, name)}
    )


# --- The same scene, described in another way ---


def with_map_turned(scene: Scene) -> Scene:
    """The light's map turned by half a turn; a directional light's place, moved back along its rays."""
    light = dataclasses.replace(scene.light, up=-scene.light.up)
    if isinstance(light, DirectionalLight):
        ray = np.asarray(light.direction, float) / np.linalg.norm(light.direction)
        light = dataclasses.replace(light, center=light.center - 1.7 * ray, near=light.near + 1.7, far=light.far + 1.7)
    return dataclasses.replace(scene, lights=light)


def with_map_exchanged(scene: Scene) -> Scene:
    """The light's map turned by a quarter: its width becomes its height."""
    light = scene.light
    right = np.asarray(light.view().world_to_eye, float)[0, :3]
    return dataclasses.replace(scene, lights=dataclasses.replace(light, up=right, extent=light.extent[::-1]))


def with_light_copied(scene: Scene, right: float, up: float) -> Scene:
    """The light given by its matrices, its window moved by parts of its width and height."""
    view, shift = scene.light.view(), np.eye(4)
    shift[:2, 3] = -2 * right, -2 * up
    moved = shift @ np.asarray(view.eye_to_clip, float)
    return dataclasses.replace(scene, lights=MatrixLight(view.world_to_eye, moved))


def with_image_turned(scene: Scene) -> Scene:
    """The picture turned by half a turn."""
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, up=-scene.camera.up))


def with_meshes_cut(scene: Scene) -> Scene:
    """Quads cut along their other diagonal, each mesh parted in two, and their faces in another order."""
    meshes, rng = [], np.random.default_rng(0)
    for mesh in scene.meshes:
        faces = np.asarray(mesh.faces)
        if faces.tolist() == [[0, 1, 2], [0, 2, 3]]:
            faces = np.array([[1, 2, 3], [1, 3, 0]])
        for part in np.array_split(rng.permutation(faces), 2):
            own, number = np.unique(part, return_inverse=True)
            meshes.append(Mesh(np.asarray(mesh.vertices)[own], number.reshape(-1, 3)))
    twice = lambda flags: None if flags is None else tuple(flag for flag in flags for _ in range(2))
    return Scene(meshes, scene.camera, scene.lights, twice(scene.casts), twice(scene.receives))


def with_camera_copied(scene: Scene, right: float = 0.0, up: float = 0.0) -> Scene:
    """The camera given by its matrices, its window moved by so many pixels."""
    view, (height, width) = scene.camera.view(), scene.camera.resolution
    shift = np.eye(4)
    # By 2 / size for a pixel, times w.
    shift[:2, 3] = -2 * right / width, -2 * up / height
    projection = shift @ np.asarray(view.eye_to_clip, float)
    return dataclasses.replace(scene, camera=MatrixCamera(view.world_to_eye, projection, (height, width)))


def with_eye_behind(scene: Scene) -> Scene:
    """A parallel camera's eye moved along its axis, behind all that it sees."""
    camera = scene.camera
    ray = np.asarray(camera.target - camera.eye, float)
    ray /= np.linalg.norm(ray)
    away = float(camera.far)
    moved = {"eye": camera.eye + away * ray, "near": camera.near - away, "far": camera.far - away}
    return dataclasses.replace(scene, camera=dataclasses.replace(camera, **moved, target=camera.target + away * ray))


# --- What a change does to a picture ---


class Change(NamedTuple):
    """A change of a scene.

    - `scene`: changes it; `back`: turns the picture afterwards into that before, or a part of it; `seen`: that part of
        the picture before.
    - `technique`: what the technique must become, such as patterns that are mirrored too.
    """

    scene: Callable[[Scene], Scene]
    back: Callable[[Image], Image] = lambda image: image
    technique: Callable[[Any], Any] = lambda technique: technique
    seen: Callable[[Image], Image] = lambda image: image


def with_patterns(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Any], Any]:
    is_pattern = lambda leaf: isinstance(leaf, Pattern)
    changed = lambda leaf: (
        Pattern(jnp.asarray(change(np.asarray(leaf.offsets))), leaf.rotated) if is_pattern(leaf) else leaf
    )
    return lambda technique: jax.tree.map(changed, technique, is_leaf=is_pattern)


def _with_sides_exchanged(technique: Any) -> Any:
    return dataclasses.replace(
        technique, map=dataclasses.replace(technique.map, resolution=technique.map.resolution[::-1])
    )


def _scaled_by(scale: float) -> Callable[[Any], Any]:
    """Settings of engines in world units."""

    def change(technique: Any) -> Any:
        if not isinstance(technique, AbstractEngineShadows):
            return technique
        return dataclasses.replace(technique, normal_bias=technique.normal_bias * scale)

    return change


# Tiles of patterns fit into the picture a whole number of times.
CHANGES = {
    "elsewhere": Change(
        lambda scene: placed(scene, similarity(33.0, (1, 2, -1), 3.7, (20, -11, 5))), technique=_scaled_by(3.7)
    ),
    # Engines' maps follow the world's y axis, and cube maps its three.
    "upright elsewhere": Change(
        lambda scene: placed(scene, similarity(33.0, (0, 1, 0), 3.7, (20, -11, 5))), technique=_scaled_by(3.7)
    ),
    "a quarter turn": Change(lambda scene: placed(scene, similarity(90.0))),
    "mirrored": Change(
        lambda scene: placed(scene, similarity(mirror=(-1, 1, 1))),
        lambda image: image[:, ::-1],
        with_patterns(lambda offsets: offsets[:, :, ::-1] * np.array([-1.0, 1.0])),
    ),
    "map turned": Change(with_map_turned, technique=with_patterns(lambda offsets: -offsets)),
    "map exchanged": Change(with_map_exchanged, technique=_with_sides_exchanged),
    # By whole texels of the maps that are used.
    "light copied": Change(lambda scene: with_light_copied(scene, -1 / 8, -1 / 16)),
    "image turned": Change(
        with_image_turned, lambda image: image[::-1, ::-1], with_patterns(lambda offsets: offsets[:, ::-1, ::-1])
    ),
    "meshes cut": Change(with_meshes_cut),
    "camera copied": Change(with_camera_copied),
    "camera shifted": Change(
        lambda scene: with_camera_copied(scene, 12, -8),
        lambda image: image[8:, :-12],
        seen=lambda image: image[:-8, 12:],
    ),
    "eye behind": Change(with_eye_behind),
}
