"""Finds a scene's ground, its up direction, and whether it is a room, from its triangles alone.

All functions take the corners of triangles, (f, 3, 3), in any unit. Except for `up_of`, they expect `+y` up.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._types import HostArray

Corners = Float[HostArray, "f 3 3"]
Directions = Float[HostArray, "d 3"]

# A face is level if its normal is this close to vertical. It is at the bottom within this fraction of the scene's
# largest side.
_LEVEL, _AT_BOTTOM = 0.99, 0.01
# A ground covers this fraction of the scene's outline. The objects on it cover at most this fraction of the ground.
_COVERED, _STANDING = 0.5, 0.7
# A foot of an object covers this fraction of the outline, and is this many times as large as along another axis.
_FOOT, _MORE = 0.05, 3.0
# A room hides this fraction of all directions, and shows its faces' front sides in this fraction of these.
_CLOSED, _FRONT = 0.8, 0.9
# The walls of a room are this far from its centre, as a fraction of half the scene's smaller width. The parts of a
# machine are closer.
_TO_WALLS, _ASIDE = 0.35, 16
# A height field covers this fraction of the outline, has at most this many layers at one position, and is at most this
# high.
_SPREAD, _LAYERS, _RELIEF = 0.85, 1.05, 0.35
# Cells per side of the grid of its heights.
_CELLS = 32
# The candidates for a point inside a room, as fractions of the box, with central ones first.
_ACROSS, _HEIGHTS = (0.5, 0.3, 0.7), (0.5, 0.7)
_DIRECTIONS = 96
_TINY = float(np.finfo(float).tiny)
# Pairs of rays and triangles that are tested at once.
_PAIRS = 1 << 21


class Ground(NamedTuple):
    """A ground: its height, its minimum and maximum x and z, and its faces (f,).

    `relief`: for a height field, the heights in cells of equal size between `low` and `high`, as [x, z]. Its `height`
    is their mean.
    """

    height: float
    low: Float[HostArray, "2"]
    high: Float[HostArray, "2"]
    faces: Bool[HostArray, " f"]
    relief: Float[HostArray, "n n"] | None = None

    def under(self, points: Float[HostArray, "p 3"]) -> float | Float[HostArray, " p"]:
        """The height of the ground under the points."""
        if self.relief is None:
            return self.height
        cells = _cells(points[:, (0, 2)], self.low, self.high)
        return self.relief[cells[:, 0], cells[:, 1]]


class Inside(NamedTuple):
    """A point inside a room with the most space around it, and the heights of floor and ceiling there."""

    point: Float[HostArray, "3"]
    floor: float
    ceiling: float


def ground_of(corners: Corners) -> Ground | None:
    """The level ground that everything else in a scene rests on, or `None`.

    The bottom of an object is not a ground: objects cover less area than the ground that they rest on.
    """
    size = _size(corners)
    bottom, level = _level_at_bottom(corners)
    if not level.any() or level.all():
        # A level surface alone is an object.
        return None
    flat = corners[level][..., (0, 2)]
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    above = corners[corners[..., 1].max(axis=1) > bottom + _AT_BOTTOM * size][..., (0, 2)]
    if len(above) == 0:
        return None
    outline = np.prod(np.ptp(corners[..., (0, 2)], axis=(0, 1)))
    standing = np.prod(np.ptp(above, axis=(0, 1)))
    area = np.abs(_cross(flat)).sum() / 2
    if area < _COVERED * outline or standing > _STANDING * np.prod(high - low):
        return None
    # Feet of objects are also level. The ground is the largest face.
    return Ground(float(corners[level][np.abs(_cross(flat)).argmax(), :, 1].mean()), low, high, level)


def height_field_of(corners: Corners) -> Ground | None:
    """The surface that everything else in a scene rests on, such as a terrain with trees, or `None`.

    It is one connected surface that covers the scene's outline once. A closed object covers its own outline twice.
    """
    low, high = corners[..., (0, 2)].min(axis=(0, 1)), corners[..., (0, 2)].max(axis=(0, 1))
    outline = np.prod(high - low)
    signed = _cross(corners[..., (0, 2)]) / 2
    # The areas of a closed object cancel, so large ones are not examined.
    if not abs(signed.sum()) > _SPREAD * outline:
        return None
    areas = np.abs(signed)
    piece = _pieces(corners)
    largest = np.bincount(piece, areas).argmax()
    faces = piece == largest
    flat, covered = corners[faces], areas[faces].sum()
    if not _SPREAD * outline < covered < _LAYERS * outline or np.ptp(flat[..., 1]) > _RELIEF * max(high - low):
        return None
    # Triangles finer than cells leave no cell empty. Coarser triangles are sampled at their corners and centres.
    points = np.concatenate([flat, flat.mean(axis=1, keepdims=True)], axis=1).reshape(-1, 3)
    cells = _cells(points[:, (0, 2)], low, high)
    total, count = np.zeros((2, _CELLS, _CELLS))
    np.add.at(total, tuple(cells.T), points[:, 1])
    np.add.at(count, tuple(cells.T), 1)
    mean = float(points[:, 1].mean())
    return Ground(mean, low, high, faces, np.where(count > 0, total / np.maximum(count, 1), mean))


def _cells(flat: Float[HostArray, "p 2"], low: HostArray, high: HostArray) -> HostArray:
    """The grid cell of each point, (p, 2)."""
    return ((flat - low) / np.maximum(high - low, _TINY) * _CELLS).astype(int).clip(0, _CELLS - 1)


def _pieces(corners: Corners) -> HostArray:
    """The index of each face's connected piece, (f,). Corners at the same position are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # A weighted sum of the three coordinates distinguishes positions, and is sorted much faster.
    sums = corners.reshape(-1, 3) @ np.array([1.0, math.sqrt(2), math.pi])
    places = np.unique(sums, return_inverse=True)[1].reshape(-1, 3)
    ends = places[:, [1, 2]].ravel(), np.repeat(places[:, 0], 2)
    count = int(places.max()) + 1
    _, piece = connected_components(
        coo_array((np.ones(len(ends[0]), bool), ends), shape=(count, count)), directed=False
    )
    return piece[places[:, 0]]


def has_floor(corners: Corners) -> bool:
    """Whether level faces at the bottom show their front sides from above. A plane at their height would coincide with
    them."""
    _, level = _level_at_bottom(corners)
    return bool((_normals(corners[level])[:, 1] > 0).any())


def up_of(corners: Corners, is_y_up_format: bool) -> Literal["y", "z"]:
    """The up axis: y unless the scene is flat across z.

    If there is a ground across z and none across y, z is up. A flat foot of an object counts as a sign only in formats
    that do not define the up axis.
    """
    turned = y_up(corners)
    if ground_of(corners) is not None:
        return "y"
    if ground_of(turned) is not None:
        return "z"
    return "z" if not is_y_up_format and stands_on_z(corners) else "y"


def stands_on_z(corners: Corners) -> bool:
    """Whether an object has a flat foot across z, and across y a much smaller foot or none."""
    return _foot(y_up(corners)) > max(_FOOT, _MORE * _foot(corners))


def y_up(vectors: Float[HostArray, "*n 3"]) -> Float[HostArray, "*n 3"]:
    """Converts points or directions from a world with `+z` up to a world with `+y` up, by a quarter turn about x."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)


def inside_of(corners: Corners) -> Inside | None:
    """A point from which a scene looks like a room: closed around the point, with a level floor and front faces.

    `None` if there is no such point. A solid object seen from its centre shows the back sides of its faces.
    """
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    normals, least, most = _normals(corners), corners.min(axis=1), corners.max(axis=1)
    found = []
    for height in _HEIGHTS:
        for x in _ACROSS:
            for z in _ACROSS:
                point = low + (high - low) * np.array([x, height, z])
                # Only faces that intersect one of the axes through the point can be hit.
                is_between = (least <= point) & (point <= most)
                near = np.flatnonzero(is_between.sum(axis=1) >= 2)
                if len(near) == 0:
                    continue
                distance, is_front, face = _hits(corners[near], normals[near], point, _AXES)
                is_level = normals[near[face[_DOWN]], 1] > _LEVEL
                if is_level and is_front[_UP] and is_front[_DOWN] and is_front.sum() >= len(_AXES) - 1:
                    heights = float(point[1] - distance[_DOWN]), float(point[1] + distance[_UP])
                    found.append((float(distance.min()), Inside(point, *heights)))
    for _, inside in sorted(found, key=lambda each: -each[0]):
        distance, is_front, _ = _hits(corners, normals, inside.point, _SPHERE)
        seen = np.isfinite(distance)
        if seen.mean() >= _CLOSED and is_front.sum() >= _FRONT * seen.sum() and _is_wide(corners, inside.point):
            return inside
    return None


def _is_wide(corners: Corners, point: Float[HostArray, "3"]) -> bool:
    """Whether there is as much space around a point as in a room."""
    angles = np.arange(_ASIDE) * 2 * np.pi / _ASIDE
    directions = np.stack([np.sin(angles), np.zeros(_ASIDE), np.cos(angles)], axis=-1)
    width = np.ptp(corners[..., (0, 2)], axis=(0, 1)).min()
    return bool(np.median(free_distance(corners, point, directions)) >= _TO_WALLS * width / 2)


def free_distance(corners: Corners, point: Float[HostArray, "3"], directions: Directions) -> Float[HostArray, " d"]:
    """The distance from `point` to the first face along each direction; infinite if there is none."""
    return _hits(corners, _normals(corners), point, directions)[0]


def _size(corners: Corners) -> float:
    return float(np.ptp(corners, axis=(0, 1)).max())


def _level_at_bottom(corners: Corners) -> tuple[float, Bool[HostArray, " f"]]:
    """The minimum height, and the level faces there."""
    heights = corners[..., 1]
    bottom = float(heights.min())
    at_bottom = heights.max(axis=1) <= bottom + _AT_BOTTOM * _size(corners)
    return bottom, at_bottom & (np.abs(_normals(corners)[:, 1]) > _LEVEL)


def _foot(corners: Corners) -> float:
    """The fraction of the outline that level faces at the bottom cover."""
    _, level = _level_at_bottom(corners)
    outline = np.prod(np.ptp(corners[..., (0, 2)], axis=(0, 1)))
    return float(np.abs(_cross(corners[level][..., (0, 2)])).sum() / 2 / max(outline, np.finfo(float).tiny))


def _cross(flat: Float[HostArray, "f 3 2"]) -> Float[HostArray, " f"]:
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _normals(corners: Corners) -> Float[HostArray, "f 3"]:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals / np.where(length > 0, length, 1)


def _hits(
    corners: Corners,
    normals: Float[HostArray, "f 3"],
    point: Float[HostArray, "3"],
    directions: Directions,
) -> tuple[Float[HostArray, " d"], Bool[HostArray, " d"], HostArray]:
    """The first faces that rays from `point` meet: distance (infinite if none), whether from the front, and index."""
    distance = np.full(len(directions), np.inf)
    face = np.zeros(len(directions), int)
    some = max(_PAIRS // len(directions), 1)
    for start in range(0, len(corners), some):
        t = _crossings(corners[start : start + some] - point, directions)
        nearest = t.argmin(axis=1)
        closer = np.take_along_axis(t, nearest[:, None], axis=1)[:, 0]
        face = np.where(closer < distance, start + nearest, face)
        distance = np.minimum(distance, closer)
    is_front = np.isfinite(distance) & (np.einsum("dk,dk->d", normals[face], directions) < 0)
    return distance, is_front, face


def _crossings(corners: Corners, directions: Directions) -> Float[HostArray, "d f"]:
    """The distance from the origin to each triangle along each direction; infinite for a miss (Möller and Trumbore
    1997)."""
    a, e, g = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # Scalar triple products with the direction are linear in it.
    across = np.cross(e, g)
    determinant = -directions @ across.T
    u = directions @ np.cross(a, g).T
    v = -directions @ np.cross(a, e).T
    # A ray in a triangle's plane misses it, by NaN or infinity.
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = u / determinant, v / determinant
        t = -np.einsum("fk,fk->f", a, across)[None] / determinant
        return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)


def _sphere(count: int) -> Float[HostArray, "d 3"]:
    """Evenly distributed directions on a Fibonacci spiral."""
    i = np.arange(count) + 0.5
    y, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    across = np.sqrt(1 - y * y)
    return np.stack([across * np.cos(turn), y, across * np.sin(turn)], axis=-1)


_UP, _DOWN = 2, 3
_AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
_SPHERE = _sphere(_DIRECTIONS)
