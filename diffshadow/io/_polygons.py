"""Polygons with any number of corners, as in files, and their triangulation."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import manifold3d
import numpy as np
from jaxtyping import Bool, Float, Int

from .._types import HostArray
from ._errors import MeshError
from ._looks import Looks

# Tolerated areas of flipped triangles, as fractions of the face's squared extent. `_EXACT` allows for float64 rounding.
# `_TOUCHING` allows for files with few digits, whose outlines may cross slightly where they should touch.
_EXACT, _TOUCHING = 1e-9, 1e-4
# A face is flat if its corners are this close to its plane, as a fraction of its extent.
_FLAT = 1e-3
# Beyond this number, the vertices of instances take gigabytes.
_MAX_REPEATED = 1 << 25


class Polygons(NamedTuple):
    """Faces, with the corners of all faces in one array.

    - `vertices`: (v, 3), float64.
    - `corners`: (c,), indices into `vertices`; the corners of a face run anticlockwise when seen from outside.
    - `sizes`: (f,), the number of corners of each face.
    - `left_out`: the number of other elements in the file, by their singular names, such as "line".
    - `normals`: (v, 3), float64, the vertices' normals, of any length; `None` if the file has none, or if normals are
      not read from its format.
    - `are_fans`: whether the faces may be concave polygons that a library has cut as fans.
    - `looks`: their colours and textures; `None` if the file has none, or if colours are not read from its format.
    """

    vertices: Float[HostArray, "v 3"]
    corners: Int[HostArray, " c"]
    sizes: Int[HostArray, " f"]
    left_out: Mapping[str, int] = MappingProxyType({})
    normals: Float[HostArray, "v 3"] | None = None
    are_fans: bool = False
    looks: Looks | None = None


def triangulate(polygons: Polygons) -> Int[HostArray, "t 3"]:
    """The faces cut into triangles (t, 3) of the same corners, area and winding, in the same order.

    A face is cut as a fan from its first corner if that covers it, as it does for convex faces. A quad that needs its
    other diagonal is cut along that diagonal. All other faces are cut by manifold3d in their mean plane. manifold3d
    keeps every corner, so that neighbours still share whole edges, and handles faces that touch themselves. Faces with
    holes touch themselves: their outline runs to the hole and back along a bridge. A quad too bent for either method is
    cut along its shorter diagonal. A face of fewer than three corners has no triangles.

    **Raises** `MeshError` if a face crosses itself.
    """
    vertices, corners, sizes = polygons[:3]
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    begin = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    row = np.cumsum(counts) - counts
    face = np.repeat(np.arange(len(sizes)), counts)
    second = begin[face] + 1 + np.arange(len(face)) - row[face]
    triangles = corners[np.stack([begin[face], second, second + 1], axis=-1)]

    rows = np.flatnonzero(sizes[face] > 3)
    wrong = np.unique(face[rows[~_upright(vertices[triangles[rows]], face[rows])]])
    # The other diagonal of quads.
    quads = wrong[sizes[wrong] == 4]
    other = corners[begin[quads][:, None, None] + np.array([[1, 2, 3], [1, 3, 0]])]
    right = _upright(vertices[other.reshape(-1, 3)], np.repeat(quads, 2)).reshape(-1, 2).all(axis=-1)
    triangles[row[quads[right]][:, None] + np.arange(2)] = other[right]

    for i in np.setdiff1d(wrong, quads[right]).tolist():
        own = corners[begin[i] : begin[i] + sizes[i]]
        triangles[row[i] : row[i] + counts[i]] = own[_cut(vertices[own], i + 1)]
    return triangles


def _cut(points: Float[HostArray, "n 3"], number: int) -> Int[HostArray, "t 3"]:
    """The triangles (n - 2, 3) of the face with these corners, as indices of the corners.

    **Raises** `MeshError` if the face crosses itself. `number` identifies the face in the message.
    """
    offsets = points - points[0]
    offsets /= np.abs(offsets).max()
    normal = np.cross(offsets, np.roll(offsets, -1, axis=0)).sum(axis=0) / 2
    area = np.linalg.norm(normal)
    reach = 0.0
    if area > _EXACT:
        normal /= area
        along = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
        plane = np.stack([along, np.cross(normal, along)], axis=-1)
        triangles = np.asarray(manifold3d.triangulate([offsets @ plane]), np.int64)
        same = np.zeros(len(triangles), np.int64)
        if len(triangles) == len(points) - 2 and _upright(points[triangles], same, _TOUCHING).all():
            return triangles
        reach = np.abs(offsets @ normal).max()
    if len(points) == 4 and reach >= _FLAT:
        first, second = np.linalg.norm(points[2] - points[0]), np.linalg.norm(points[3] - points[1])
        return np.array([[0, 1, 2], [0, 2, 3]] if first <= second else [[1, 2, 3], [1, 3, 0]])
    seen = "" if reach < _FLAT else " in its mean plane (its corners do not lie in one plane)"
    raise MeshError(
        f"has a face, number {number} with {len(points)} corners, whose outline crosses itself{seen}; "
        "triangulate it before the export"
    )


def strip_triangles(strip: Int[HostArray, " n"]) -> Int[HostArray, "t 3"]:
    """The triangles of a strip of n vertices. Every second triangle is reversed so that all have the same winding."""
    triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=-1) if len(strip) > 2 else strip[:0].reshape(0, 3)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def repeated(
    points: Float[HostArray, "v 3"],
    triangles: Int[HostArray, "t 3"],
    normals: Float[HostArray, "v 3"] | None,
    to_world: Float[HostArray, "n 4 4"],
) -> tuple[Float[HostArray, "v2 3"], Int[HostArray, "t2 3"], Float[HostArray, "v2 3"] | None]:
    """Vertices, triangles and normals in world space, repeated for each matrix. A mirror reverses the winding.

    **Raises** `MeshError` for more triangles or vertices than fit into memory.
    """
    if len(to_world) * max(len(points), len(triangles)) > _MAX_REPEATED:
        raise MeshError(
            f"has {len(to_world):,} instances of {len(triangles):,} triangles; expected at most {_MAX_REPEATED:,} "
            "triangles in all: leave some out"
        )
    linear = to_world[:, :3, :3]
    vertices = (points @ linear.swapaxes(1, 2) + to_world[:, None, :3, 3]).reshape(-1, 3)
    is_mirrored = np.linalg.det(linear)[:, None, None] < 0
    wound = np.where(is_mirrored, triangles[:, ::-1], triangles)
    faces = (wound + len(points) * np.arange(len(to_world))[:, None, None]).reshape(-1, 3)
    if normals is None:
        return vertices, faces, None
    # The inverse transpose, up to a factor. This also works for a scale of 0.
    turned = normals @ np.stack([np.cross(linear[:, :, i - 2], linear[:, :, i - 1]) for i in range(3)], axis=1)
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return vertices, faces, (turned / np.where(length > 0, length, 1) * np.where(is_mirrored, -1, 1)).reshape(-1, 3)


def _upright(
    triangles: Float[HostArray, "t 3 3"], face: Int[HostArray, " t"], tolerance: float = _EXACT
) -> Bool[HostArray, " t"]:
    """Whether each triangle has the winding of its face; `face` (t,) is sorted.

    If all triangles of a face have its winding, they cover exactly the face. A flipped triangle is tolerated if its
    area is at most `tolerance` times the face's squared extent.
    """
    if len(face) == 0:
        return np.zeros(0, bool)
    begin = np.flatnonzero(np.diff(face, prepend=-1))
    of = np.repeat(np.arange(len(begin)), np.diff(begin, append=len(face)))
    a, b, c = np.moveaxis(triangles, 1, 0)
    # In units of the face's extent, so that no product overflows.
    extent = np.maximum.reduceat(np.maximum(np.abs(b - a), np.abs(c - a)).max(axis=-1), begin)
    unit = np.where(extent > 0, extent, 1)[of][:, None]
    areas = np.cross((b - a) / unit, (c - a) / unit) / 2
    whole = np.add.reduceat(areas, begin)
    length = np.linalg.norm(whole, axis=-1)
    normal = whole / np.where(length > 0, length, 1)[:, None]
    signed = (areas * normal[of]).sum(axis=-1)
    # A face without area has no normal, so its triangles must not have an area either.
    flat = length <= tolerance
    return np.where(flat[of], np.linalg.norm(areas, axis=-1) <= tolerance, signed >= -tolerance)
