"""The size of a lamp, which scene files do not store."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ... import io
from ..._types import HostArray

HALF_ANGLE = 0.5
"""Half the angle of a light as receivers see it, in degrees. Engines' lights have no size, but penumbrae need one."""
# A mesh around a lamp is a room or a sky if it extends this far, as a fraction of the distance to the lit surfaces.
_LARGEST = 0.25
# The distance between a lamp and its mesh may be this fraction of the mesh's longest side.
_BESIDE = 0.25


def distance_lit(meshes: Sequence[io.SceneMesh], position: Float[HostArray, "3"]) -> float:
    """The median distance of the meshes' surfaces from `position`, in world units; 1 if all surfaces lie at
    `position`."""
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
    distance = np.linalg.norm(corners.mean(axis=1) - position, axis=-1)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    order = np.argsort(distance)
    below = np.cumsum(area[order])
    return float(distance[order][np.searchsorted(below, below[-1] / 2)]) or float(distance.max()) or 1.0


def mesh_of(meshes: Sequence[io.SceneMesh], position: Float[HostArray, "3"]) -> io.SceneMesh | None:
    """The smallest luminous mesh at `position`, if it is small compared with the distance to the lit surfaces."""
    most = _LARGEST * distance_lit(meshes, position)
    found = [mesh for mesh in meshes if mesh.emits and _is_around(mesh, position) and max(_sides(mesh)) <= most]
    return min(found, key=_radius, default=None)


def lamp_size(meshes: Sequence[io.SceneMesh], position: Float[HostArray, "3"]) -> tuple[float, str]:
    """The radius of a lamp at `position` in world units, and its source."""
    mesh = mesh_of(meshes, position)
    if mesh is not None:
        return _radius(mesh), f"the radius of its mesh {mesh.name}"
    distance = distance_lit(meshes, position)
    radius = math.tan(math.radians(HALF_ANGLE)) * distance
    return (
        radius,
        f"seen under {2 * HALF_ANGLE:g} degree from {distance:.3g} world units, the median distance of lit surfaces",
    )


def _points(mesh: io.SceneMesh) -> Float[HostArray, "v 3"]:
    return mesh.vertices[np.unique(mesh.faces)]


def _sides(mesh: io.SceneMesh) -> list[float]:
    return np.ptp(_points(mesh), axis=0).tolist()


def _radius(mesh: io.SceneMesh) -> float:
    """Half the geometric mean of the two longest sides of its box."""
    *_, second, first = sorted(_sides(mesh))
    return math.sqrt(first * second) / 2


def _is_around(mesh: io.SceneMesh, position: Float[HostArray, "3"]) -> bool:
    points = _points(mesh)
    margin = _BESIDE * max(_sides(mesh))
    return bool(((points.min(axis=0) - margin <= position) & (position <= points.max(axis=0) + margin)).all())
