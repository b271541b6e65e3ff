"""The visual hull of a shape: the largest shape that casts the given shadows (Laurentini, "The Visual Hull Concept for
Silhouette-Based Image Understanding", 1994). A fit from shadows alone starts within it, and its step sizes are relative
to the shadows' size.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.spatial import KDTree

from .._types import HostArray
from ..geometry import Mesh
from ._large_steps import LargeSteps
from ._level_sets import Field, grid_points, grid_round, level_set
from .problems import ShapeView
from .problems._shape import mirrored

# Visibility below which a pixel is in shadow.
_DARK = 0.5
# A pixel is next to an outline if its centre is less than this from the middle between a dark pixel and a lit one.
_BESIDE = 1.0
# The number of cells along the longest side of a hull and of the search boxes, and the number of searches.
_CELLS, _SEARCHED, _SEARCHES = 64, 24, 5
# The λ of the smoothing that shrinks a hull. Its thin parts also shrink, but remain.
_SHRINKING = 3.0
# The minimum sine of the angle between the directions of two shadows' lights.
_LEAST_SINE = 0.1


class Outline(NamedTuple):
    """A shadow as its light sees it, in a plane perpendicular to the light's direction. If the light has a position,
    the plane is at distance 1 from it.

    - `frame`: (3, 3), rows to the right, upwards, and along the light; `source`: (3,), the light's position, or any
      point if it has none; `is_directional`: whether it has none.
    - `distance`: (n, n), signed distance from the shadow's outline on a grid, positive in the shadow; `low`, `step`:
      the grid's first point, and the distance between points.
    """

    frame: Float[HostArray, "3 3"]
    source: Float[HostArray, "3"]
    is_directional: bool
    distance: Float[HostArray, "n n"]
    low: Float[HostArray, "2"]
    step: float

    @classmethod
    def of(cls, view: ShapeView) -> "Outline":
        """The outline of a view's reference. Pixels that do not count may be in shadow."""
        mask = np.asarray(view.surface.mask)
        points = np.asarray(view.surface.position, np.float64)[mask]
        towards = np.asarray(view.light.towards(view.surface.position), np.float64)[mask]
        image, counts = np.asarray(view.reference, np.float64)[mask], np.asarray(view.weight)[mask] > 0
        way = -towards[(image < _DARK) & counts].mean(axis=0)
        way = way / np.linalg.norm(way)
        right = np.cross(way, np.eye(3)[np.abs(way).argmin()])
        right = right / np.linalg.norm(right)
        frame = np.stack([right, np.cross(right, way), way])
        source = points[0] + towards[0]
        seen, _ = _in_plane(frame, source, view.light.is_directional, points)
        low, high = seen.min(axis=0), seen.max(axis=0)
        # The pixels of a screen that faces the light, with a margin of a few pixels.
        step = float((high - low).max()) / max(max(mask.shape) - 1, 1)
        at = grid_points(low - step, step, (max(mask.shape) + 2,) * 2)
        query: Any = KDTree(seen).query
        far, pixel = query(at)
        seen_image = np.where(far <= 2 * step, np.where(counts, image, 0)[pixel], 1.0)
        distance = _signed_distance(seen_image) * step
        return cls(frame, source, bool(view.light.is_directional), distance, low - step, step)

    def __call__(self, points: Float[HostArray, "*n 3"]) -> Float[HostArray, "*n"]:
        """The depth of points within the shadow's prism or cone, in world units; negative outside."""
        seen, scale = _in_plane(self.frame, self.source, self.is_directional, points)
        place = np.moveaxis((seen - self.low) / self.step, -1, 0)
        found: Any = ndimage.map_coordinates(self.distance, place, order=1, mode="nearest")
        return found * scale

    def size(self, at: Float[HostArray, "3"]) -> float:
        """The longer side of the shadow, in world units, at the distance of a point from the light."""
        rows, columns = np.nonzero(self.distance > 0)
        _, scale = _in_plane(self.frame, self.source, self.is_directional, at)
        return float(max(np.ptp(rows), np.ptp(columns)) + 1) * self.step * float(scale)

    def ray(self) -> tuple[Float[HostArray, "3"], Float[HostArray, "3"]]:
        """A point on the line from the light through the shadow's centre, and the direction of the line."""
        rows, columns = np.nonzero(self.distance > 0)
        middle = self.low + self.step * np.array([rows.mean(), columns.mean()])
        way = self.frame[2] if self.is_directional else self.frame.T @ np.array([*middle, 1.0])
        start = self.source + self.frame[:2].T @ middle if self.is_directional else self.source
        return start, way / np.linalg.norm(way)


def _signed_distance(image: Float[HostArray, "n n"]) -> Float[HostArray, "n n"]:
    """The depth of pixels within a shadow, in pixels. A partly lit pixel at the outline is that fraction outside."""
    inside = image < _DARK
    edt: Any = ndimage.distance_transform_edt
    away = np.where(inside, edt(inside) - 0.5, 0.5 - edt(~inside))
    crossed = (np.abs(away) < _BESIDE) & (image > 0) & (image < 1)
    return np.where(crossed, _DARK - image, away)


def _in_plane(
    frame: Float[HostArray, "3 3"],
    source: Float[HostArray, "3"],
    is_directional: bool,
    points: Float[HostArray, "*n 3"],
) -> tuple[Float[HostArray, "*n 2"], Any]:
    """The positions of points in the plane across a light, and the length of the plane's unit there, in world units."""
    seen = (points - source) @ frame.T
    if is_directional:
        return seen[..., :2], np.ones(seen.shape[:-1])
    # Points next to the light or behind it are far outside of all shadows.
    ahead = seen[..., 2] > 1e-6 * np.abs(seen).sum(axis=-1)
    depth = np.where(ahead, seen[..., 2], 1.0)
    return np.where(ahead[..., None], seen[..., :2] / depth[..., None], 1e6), depth


def shadow_size(views: Sequence[ShapeView], at: Float[HostArray, "3"]) -> float:
    """The longest side of all shadows, in world units, at the distances of a point from the lights."""
    return max(Outline.of(view).size(at) for view in views)


def hull_start(
    views: Sequence[ShapeView], *, faces: int = 10_000, symmetry: Sequence[float | int] | None = None
) -> Mesh:
    """A closed mesh within the visual hull of the views' references, as the start of a fit.

    The hull is found on a grid with 64 cells along its longest side. Smoothing then shrinks it. The mesh has the parts
    and holes of the hull, except for small ones. Views with a moving light are ignored if there are others.

    **Arguments:**

    - `faces`: the approximate and maximum number of faces of the mesh.
    - `symmetry`: (a, b, c, d), a plane a x + b y + c z = d across which the mesh is symmetric.

    **Raises** `ValueError` for fewer than two views from different directions, or for shadows that no shape casts.
    """
    still = [view for view in views if not np.asarray(view.moves)]
    outlines = [Outline.of(view) for view in (still if len(still) > 1 else views)]
    mirror = None if symmetry is None else tuple(float(number) for number in symmetry)
    box = _box(outlines, mirror)
    low, step, shape = grid_round(*box, _CELLS)
    field = Field(_within(outlines, mirror, grid_points(low, step, shape)), low, step)
    if not (field.values > 0).any():
        raise ValueError(_NONE)
    vertices, found = level_set(field, faces, mirror)
    smooth = LargeSteps(vertices, found, np.ones(len(vertices), bool), _SHRINKING)
    return Mesh(smooth.vertices_of(vertices), found)


_NONE = (
    "no shape casts all of the views' shadows; expected shadows of one shape: check the images and their lights, or "
    "give a mesh to start from"
)


def _within(
    outlines: Sequence[Outline], mirror: tuple[float, ...] | None, points: Float[HostArray, "*n 3"]
) -> Float[HostArray, "*n"]:
    """The depth of points within all prisms. With a plane, the depth of the points and of their mirror images."""
    found = np.min([outline(points) for outline in outlines], axis=0)
    if mirror is None:
        return found
    flat = mirrored(points.reshape(-1, 3), mirror).reshape(points.shape)
    return np.minimum(found, np.min([outline(flat) for outline in outlines], axis=0))


def _box(
    outlines: Sequence[Outline], mirror: tuple[float, ...] | None
) -> tuple[Float[HostArray, "3"], Float[HostArray, "3"]]:
    """The corners of a box around the hull.

    The search starts at the point that is closest to the central rays of all shadows, and keeps each cell that may
    contain a part of the hull.
    """
    across, towards = np.zeros((3, 3)), np.zeros(3)
    for start, way in map(Outline.ray, outlines):
        flat = np.eye(3) - np.outer(way, way)
        across, towards = across + flat, towards + flat @ start
    # For two lights, the smallest eigenvalue is 1 minus the cosine of the angle between them.
    least = float(np.linalg.eigvalsh(across)[0])
    if least < _LEAST_SINE**2 / 2:
        raise ValueError(
            "the views' lights shine from one direction, so nothing bounds a shape along it; expected two or more "
            "directions: add a view, or give a mesh to start from"
        )
    middle = np.linalg.solve(across, towards)
    half = max(outline.size(middle) for outline in outlines) / min(1.0, (2 * least) ** 0.5)
    low, high = middle - half, middle + half
    for _ in range(_SEARCHES):
        start, step, shape = grid_round(low, high, _SEARCHED)
        points = grid_points(start, step, shape)
        reached = points[_within(outlines, mirror, points) > -(3**0.5) / 2 * step]
        if not len(reached):
            raise ValueError(_NONE)
        low, high = reached.min(axis=0) - step / 2, reached.max(axis=0) + step / 2
    return low, high
