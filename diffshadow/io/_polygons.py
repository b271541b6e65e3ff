"""Faces of any number of corners, as files give them, and their triangles."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import manifold3d
import numpy as np
from jaxtyping import Bool, Float, Int

from .._types import HostArray
from ._errors import MeshError

# Areas as shares of a face's greatest squared extent. A fan may have triangles turned over by as much as rounding in
# double precision does; of an outline, rounding to a few digits may let parts cross that touch.
_EXACT, _TOUCHING = 1e-9, 1e-4
# Distance of a corner from a face's plane, as a share of its extent, that counts as flat.
_FLAT = 1e-3


class Polygons(NamedTuple):
    """Faces with their corners one after another.

    - `vertices`: (v, 3), float64.
    - `corners`: (c,), indices into `vertices`; each face's run anticlockwise seen from outside.
    - `sizes`: (f,), corners of each face.
    - `left_out`: how many things of other kinds the file holds, by their names in the singular, such as "line".
    """

    vertices: Float[HostArray, "v 3"]
    corners: Int[HostArray, "c"]
    sizes: Int[HostArray, "f"]
    left_out: Mapping[str, int] = MappingProxyType({})


def triangulate(polygons: Polygons) -> Int[HostArray, "t 3"]:
    """The faces cut into triangles (t, 3) of the same corners, area and winding, in the same order.

    A face is cut as a fan from its first corner where that is right, which it is for convex faces, and a face of four
    along its other diagonal where only that is right. All others are cut by manifold3d in the plane that a face spans
    on average. It keeps every corner, so that neighbours still share whole edges, and copes with faces that touch
    themselves, as those with holes do, whose outline runs to the hole and back along a bridge. A face of four corners
    that is bent too far for either is cut along its shorter diagonal. A face of fewer than three corners has no
    triangle.

    **Raises** `MeshError` if a face crosses itself.
    """
    vertices, corners, sizes, _ = polygons
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
    # The other diagonal of faces with four corners.
    quads = wrong[sizes[wrong] == 4]
    turned = corners[begin[quads][:, None, None] + np.array([[1, 2, 3], [1, 3, 0]])]
    right = _upright(vertices[turned.reshape(-1, 3)], np.repeat(quads, 2)).reshape(-1, 2).all(axis=-1)
    triangles[row[quads[right]][:, None] + np.arange(2)] = turned[right]

    for i in np.setdiff1d(wrong, quads[right]).tolist():
        own = corners[begin[i] : begin[i] + sizes[i]]
        triangles[row[i] : row[i] + counts[i]] = own[_cut(vertices[own], i + 1)]
    return triangles


def _cut(points: Float[HostArray, "n 3"], number: int) -> Int[HostArray, "t 3"]:
    """The triangles (n - 2, 3) of the face with these corners, by their indices.

    **Raises** `MeshError`, which calls the face by its `number`, if it crosses itself.
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
    seen = "" if reach < _FLAT else ", seen along its mean normal, for its corners do not lie in one plane"
    raise MeshError(
        f"has a face, number {number} with {len(points)} corners, whose outline crosses itself{seen}; "
        "cut it into triangles before the export"
    )


def strip_triangles(strip: Int[HostArray, "n"]) -> Int[HostArray, "t 3"]:
    """The triangles of a strip of n vertices, every other one turned round so that all are wound alike."""
    triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=-1) if len(strip) > 2 else strip[:0].reshape(0, 3)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def _upright(
    triangles: Float[HostArray, "t 3 3"], face: Int[HostArray, "t"], tolerance: float = _EXACT
) -> Bool[HostArray, "t"]:
    """Whether each triangle is wound as the whole face that it is a part of; `face` (t,) is sorted.

    Where all of a face's triangles are, they cover it once, and nothing else. A triangle may be turned over if its area
    is at most `tolerance` times its face's squared extent.
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
    # A face without area has no normal: its triangles must have none either.
    flat = length <= tolerance
    return np.where(flat[of], np.linalg.norm(areas, axis=-1) <= tolerance, signed >= -tolerance)
