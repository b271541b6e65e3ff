"""Welds vertices and computes shading normals of triangles from files or generators.

All of this runs on the host in float64, before a `Mesh` is made.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from .._types import HostArray

# Tolerance on the cosine between normals, so that coplanar triangles are not separated by rounding.
_COSINE_SLACK = 1e-9
# The number of corner pairs that are compared at once; limits memory to a few hundred MB.
_PAIRS_PER_CHUNK = 1 << 21

# Above this mean number of vertices per cell (cells are slightly smaller than the tolerance), each cell is merged
# before the search for pairs. Otherwise parts far smaller than the mesh's extent would have millions of pairs.
_MAX_IN_CELL = 4
# Odd multipliers of a hash of cells; two cells collide with a probability of 2⁻⁶⁴.
_CELL_HASH = np.array([0x2545F4914F6CDD1D, 0x369DEA0F31A53F85, 0x5851F42D4C957F2D])


def weld(
    vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], tolerance: float | int = 1e-6
) -> tuple[Float[HostArray, "w 3"], Int[HostArray, "g 3"], Int[HostArray, " g"]]:
    """Merges vertices at the same position.

    Files split vertices at texture seams and hard edges, but silhouettes and shadow volumes need to know which
    triangles are neighbours.

    **Arguments:**

    - `vertices`: (v, 3), any unit.
    - `faces`: (f, 3), indices into `vertices`.
    - `tolerance`: vertices are merged if their distance is at most this fraction of the longest side of the bounding
      box. Chains of such vertices are merged too. 0 merges only equal vertices. If the average vertex has dozens of
      others within the tolerance, some of these may stay separate.

    **Returns:** vertices (w, 3), float64, faces (g, 3), int64, and (g,), the index of each face among the given faces.
    Faces that lose a corner by the merge are dropped, and so are unused vertices. The order of the others does not
    change. A merged vertex has the position of its first vertex.

    **Raises** `ValueError` if a vertex that a face uses is not finite, or the tolerance is negative.
    """
    if not tolerance >= 0:
        raise ValueError(f"the weld tolerance is {tolerance}; expected a fraction of the extent, 0 or more")
    used, faces = _compact(np.asarray(faces, np.int64))
    points = np.asarray(vertices, np.float64)[used]
    if not np.isfinite(points).all():
        bad = np.flatnonzero(~np.isfinite(points).all(axis=-1))
        raise ValueError(
            f"{len(bad)} of the {len(points)} vertices to weld are NaN or infinite (the first is vertex "
            f"{used[bad[0]]}); expected finite coordinates: repair the mesh"
        )
    group = _merge_close(points, tolerance)
    # The first vertex of each group, in the order of the file.
    _, first, group = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    points, faces = points[first[order]], rank[group][faces]

    a, b, c = faces.T
    kept = np.flatnonzero((a != b) & (b != c) & (c != a))
    used, faces = _compact(faces[kept])
    return points[used], faces, kept


def crease_normals(
    vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], crease_angle: float | int = 30.0
) -> Float[HostArray, "f 3 3"]:
    """Unit shading normals for each corner of each face, smooth except at creases.

    A corner's normal is the mean over the faces around its vertex whose normals are within `crease_angle` of the
    corner's own face. Faces are weighted by their angle at the vertex, which makes the mean independent of the
    triangulation (Thürmer & Wüthrich 1998, "Computing vertex normals from polygonal facets").

    **Arguments:**

    - `vertices`: (v, 3), welded.
    - `faces`: (f, 3), indices into `vertices`.
    - `crease_angle`: degrees in [0, 180]; 0 shades flat, 180 smooth.

    **Returns:** (f, 3, 3), float64. A corner of a face without area has the mean of all faces around the vertex. The
    normal is 0 if no face around the vertex has an area.

    **Raises** `ValueError` if the crease angle is out of range.
    """
    if not 0 <= crease_angle <= 180:
        raise ValueError(f"the crease angle is {crease_angle}; expected degrees from 0 (flat) to 180 (smooth)")
    normals, angles = normals_and_angles(np.asarray(vertices, np.float64)[faces])
    least_cosine = np.cos(np.deg2rad(crease_angle)) - _COSINE_SLACK
    corner_vertex = faces.reshape(-1)
    weight = angles.reshape(-1)

    # Sorted by valence and then by vertex, so that the corners of all vertices with the same valence form a matrix.
    valence = np.bincount(corner_vertex, minlength=len(vertices))
    order = np.lexsort((corner_vertex, valence[corner_vertex]))
    valences, counts = np.unique(valence[corner_vertex], return_counts=True)
    result = np.empty((len(corner_vertex), 3))
    start = 0
    for d, count in zip(valences.tolist(), counts.tolist(), strict=True):
        corners = order[start : start + count].reshape(-1, d)
        start += count
        rows = max(_PAIRS_PER_CHUNK // (d * d), 1)
        for low in range(0, len(corners), rows):
            chunk = corners[low : low + rows]
            result[chunk] = _mean_normals(normals[chunk // 3], weight[chunk], least_cosine)
    return result.reshape(-1, 3, 3)


def _compact(faces: Int[HostArray, "f 3"]) -> tuple[Int[HostArray, " w"], Int[HostArray, "f 3"]]:
    """The used vertices in ascending order, and the faces as indices into them."""
    used, inverse = np.unique(faces, return_inverse=True)
    return used, inverse.reshape(-1, 3)


def _merge_close(points: Float[HostArray, "v 3"], tolerance: float | int) -> Int[HostArray, " v"]:
    """A group number for each point. Points to be merged have the same number."""
    distinct, group = np.unique(points, axis=0, return_inverse=True)
    group = group.reshape(-1)
    # Tolerances below rounding merge only equal points.
    if tolerance < np.finfo(np.float64).eps or len(distinct) < 2:
        return group
    # Merged by distance, because the borders of a grid of cells would separate neighbours.
    reach = tolerance * np.ptp(distinct, axis=0).max()
    # Cells are so small that all of their points are within the tolerance of each other.
    cells = np.floor((distinct - distinct.min(axis=0)) * (3**0.5 / reach)).astype(np.int64)
    if len(distinct) > _MAX_IN_CELL * len(np.unique(cells @ _CELL_HASH)):
        _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        distinct, group = distinct[first], cell.reshape(-1)[group]
    pairs = KDTree(distinct).query_pairs(reach, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(distinct), len(distinct)))
    _, label = connected_components(links, directed=False)
    return label[group].astype(np.int64)


def normals_and_angles(
    corners: Float[HostArray, "f 3 3"],
) -> tuple[Float[HostArray, "f 3"], Float[HostArray, "f 3"]]:
    """Unit normal of each triangle, 0 if it has no area, and its angle in radians at each corner."""
    to_next = np.roll(corners, -1, axis=1) - corners
    to_last = np.roll(corners, 1, axis=1) - corners
    # Scaled to edges of about 1, so that squares do not underflow for a tiny mesh.
    longest = np.abs(to_next).max(axis=(1, 2), keepdims=True)
    to_next, to_last = (side / np.where(longest > 0, longest, 1) for side in (to_next, to_last))
    cross = np.cross(to_next, to_last)
    sine, cosine = np.linalg.norm(cross, axis=-1), np.sum(to_next * to_last, axis=-1)
    # For triangles thinner than rounding, the direction of the cross product is noise.
    has_area = sine[:, 0] > 1e-14
    normals = np.where(has_area[:, None], cross[:, 0] / np.where(has_area, sine[:, 0], 1)[:, None], 0)
    return normals, np.where(has_area[:, None], np.arctan2(sine, cosine), 0)


def _mean_normals(
    normals: Float[HostArray, "m d 3"], weight: Float[HostArray, "m d"], least_cosine: float
) -> Float[HostArray, "m d 3"]:
    """For each of `m` vertices and each of its `d` corners, the mean over the corners within the crease angle."""
    has_area: Bool[HostArray, "m d"] = weight > 0
    near = (normals @ normals.transpose(0, 2, 1) >= least_cosine) | ~has_area[:, :, None]
    mean = (near * weight[:, None, :]) @ normals
    length = np.linalg.norm(mean, axis=-1, keepdims=True)
    # If opposite faces cancel, the corner keeps its own face's normal.
    cancelled = length < 1e-9
    return np.where(cancelled, normals, mean / np.where(cancelled, 1, length))
