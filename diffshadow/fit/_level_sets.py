"""Closed surfaces on which a field on a grid is zero.

Triangles come from marching tetrahedra on a body-centred grid whose points are snapped to the surface (manifold3d's
level set). Their edges have similar lengths.
"""

from collections.abc import Callable
from typing import NamedTuple

import manifold3d
import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ..geometry import weld
from ._large_steps import neighbours

Triangles = tuple[Float[HostArray, "_ 3"], Int[HostArray, "_ 3"]]
"""Vertices (v, 3) and faces (f, 3)."""

# Closed parts with less than this fraction of the largest part's volume are left out.
_LEAST_PART = 0.01
# Equal triangles that cover a given area have edges of this length times the root of a triangle's area.
_EDGE = (4 / 3**0.5) ** 0.5
# A level set has slightly more faces than equal triangles would. Each attempt lengthens the edges by at least this
# factor.
_LONGER, _TRIES = 1.02, 8
# The fraction of a cell by which grids are moved off the surface's bounds, where vertices often are.
_OFF = 0.0137
# Rounding moves vertices off a plane by up to this fraction of the size.
_ON_PLANE = 1e-6
# The distance by which vertices at the same position move towards their neighbours' mean.
_APART = 0.2


class Field(NamedTuple):
    """Values at the points of a grid, positive within a shape and negative outside of it.

    - `values`: (l, m, n); `low`: (3,), the first point, in world units; `step`: the distance between points, in world
      units.
    """

    values: Float[HostArray, "l m n"]
    low: Float[HostArray, "3"]
    step: float


def grid_points(low: Float[HostArray, " d"], step: float, shape: tuple[int, ...]) -> Float[HostArray, "*n d"]:
    """The points of a grid of this `shape`, with the same number of dimensions."""
    return low + step * np.moveaxis(np.indices(shape), 0, -1)


def grid_round(
    low: Float[HostArray, "3"], high: Float[HostArray, "3"], cells: int
) -> tuple[Float[HostArray, "3"], float, tuple[int, ...]]:
    """A grid around a box, with `cells` steps along the box's longest side and two more cells on each side. Returns its
    first point, its step and its shape."""
    step = float((high - low).max()) / cells
    return low - (2 + _OFF) * step, step, tuple((np.ceil((high - low) / step).astype(int) + 5).tolist())


def level_set(field: Field, faces: int, mirror: tuple[float, ...] | None = None) -> Triangles:
    """The closed surface on which a field is zero, with about `faces` triangles at most, wound outwards.

    No two vertices have the same position. Small parts are left out.

    **Arguments:** `mirror`: (a, b, c, d), a plane a x + b y + c z = d. The half where this sum is at least d is
    mirrored.

    **Raises** `ValueError` for a field that is positive nowhere.
    """
    at, top = _interpolated(field), field.low + field.step * (np.array(field.values.shape) - 1)
    # The area of the surface, estimated from the cells that it passes through as if it were level in each.
    inside = field.values > 0
    if not inside.any():
        raise ValueError("the field is positive nowhere, so it has no inside; expected positive values at some points")
    crossed = sum(float((np.diff(inside.astype(np.int8), axis=axis) != 0).sum()) for axis in range(3))
    edge = _EDGE * float(np.sqrt(crossed / 1.5 * field.step**2 / faces))
    make = lambda: _whole(manifold3d.Manifold.level_set(at, [*field.low.tolist(), *top.tolist()], edge), mirror)
    found = make()
    for _ in range(_TRIES):
        if len(found[1]) <= faces:
            break
        edge *= max((len(found[1]) / faces) ** 0.5, _LONGER)
        found = make()
    return _apart(*found)


def _interpolated(field: Field) -> Callable[[float, float, float], float]:
    """The trilinear interpolation of a field, negative outside of its grid. It is called for one point at a time, so it
    uses no arrays."""
    (low_x, low_y, low_z), per_unit = field.low.tolist(), 1 / field.step
    count_x, count_y, count_z = field.values.shape
    along_x, along_y, values = count_y * count_z, count_z, field.values.ravel().tolist()
    outside = -float(np.abs(field.values).max())

    def at(x: float, y: float, z: float) -> float:
        x, y, z = (x - low_x) * per_unit, (y - low_y) * per_unit, (z - low_z) * per_unit
        if not (0 <= x < count_x - 1 and 0 <= y < count_y - 1 and 0 <= z < count_z - 1):
            return outside
        i, j, k = int(x), int(y), int(z)
        x, y, z = x - i, y - j, z - k
        n = i * along_x + j * along_y + k
        o = n + along_x
        near = values[n] + z * (values[n + 1] - values[n])
        near_up = values[n + along_y] + z * (values[n + along_y + 1] - values[n + along_y])
        far = values[o] + z * (values[o + 1] - values[o])
        far_up = values[o + along_y] + z * (values[o + along_y + 1] - values[o + along_y])
        near, far = near + y * (near_up - near), far + y * (far_up - far)
        return near + x * (far - near)

    return at


def _whole(made: manifold3d.Manifold, mirror: tuple[float, ...] | None) -> Triangles:
    """The large parts of a surface. With a plane, only one half is kept and joined with its mirror image."""
    if mirror is not None:
        normal, offset = np.asarray(mirror[:3]), mirror[3]
        made = made.trim_by_plane(normal.tolist(), offset / float(np.linalg.norm(normal)))
    parts = made.decompose()
    volumes = [part.volume() for part in parts]
    least = _LEAST_PART * max(volumes, default=0.0)
    meshes = [part.to_mesh64() for part, volume in zip(parts, volumes, strict=True) if volume >= least]
    starts = np.cumsum([0, *(len(mesh.vert_properties) for mesh in meshes)])
    vertices = np.concatenate([np.asarray(mesh.vert_properties, np.float64)[:, :3] for mesh in meshes])
    faces = np.concatenate(
        [np.asarray(mesh.tri_verts, np.int32) + np.int32(start) for mesh, start in zip(meshes, starts, strict=False)]
    )
    return (vertices, faces) if mirror is None else _mirrored(vertices, faces, mirror)


def _mirrored(vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], plane: tuple[float, ...]) -> Triangles:
    """Half of a surface and its mirror image, joined along the plane that cuts it."""
    normal = np.asarray(plane[:3]) / np.dot(plane[:3], plane[:3])
    away = vertices @ np.asarray(plane[:3]) - plane[3]
    on = np.abs(away) <= _ON_PLANE * float(np.ptp(vertices, axis=0).max()) * float(np.linalg.norm(plane[:3]))
    vertices = np.where(on[:, None], vertices - away[:, None] * normal, vertices)
    faces = faces[~on[faces].all(axis=1)]
    other = np.arange(len(vertices))
    other[~on] = len(vertices) + np.arange((~on).sum())
    both = np.concatenate([vertices, (vertices - 2 * away[:, None] * normal)[~on]])
    both, faces, _ = weld(both, np.concatenate([faces, other[faces][:, ::-1]]), 0)
    return both, faces.astype(np.int32)


def _apart(vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"]) -> Triangles:
    """Moves vertices that touch others into their own surface."""
    _, which, count = np.unique(vertices, axis=0, return_inverse=True, return_counts=True)
    touching = count[which.reshape(-1)] > 1
    near = neighbours(len(vertices), faces)
    mean = (near @ vertices) / near.sum(axis=1)[:, None]
    return np.where(touching[:, None], vertices + _APART * (mean - vertices), vertices), faces
