"""Self-intersections of a surface. Fits of shapes remove them, and metrics count them."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from ._types import HostArray

# Faces whose radius exceeds this multiple of the median are tested one by one.
_LARGE = 3.0


def intersecting_faces(vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"]) -> Int[HostArray, "n 2"]:
    """Pairs of faces without a common vertex where an edge of one face passes through the other, (n, 2)."""
    corners = np.asarray(vertices, np.float64)[faces]
    pairs = _near(corners)
    low, high = corners.min(axis=1), corners.max(axis=1)
    one, other = pairs.T
    meet = np.all((low[one] <= high[other]) & (low[other] <= high[one]), axis=1)
    one, other = pairs[meet].T
    apart = ~np.any(faces[one][:, :, None] == faces[other][:, None], axis=(1, 2))
    one, other = one[apart], other[apart]
    a, b = corners[one], corners[other]
    return np.stack([one, other], axis=1)[_passes_through(a, b) | _passes_through(b, a)]


def _near(corners: Float[HostArray, "f 3 3"]) -> Int[HostArray, "n 2"]:
    """Pairs of triangles whose bounding balls intersect. Each pair occurs once, with the smaller index first."""
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=-1).max(axis=1)
    is_large = radius > _LARGE * np.median(radius) if len(radius) else np.zeros(0, bool)
    large, small = np.flatnonzero(is_large), np.flatnonzero(~is_large)
    found = [np.zeros((0, 2), int)]
    if len(small):
        tree: Any = KDTree(middle[small])
        found.append(small[tree.query_pairs(2 * float(radius[small].max()), output_type="ndarray")])
    if len(large):
        tree = KDTree(middle)
        near = tree.query_ball_point(middle[large], radius[large] + radius.max(), return_sorted=False)
        other = np.concatenate([*near, []]).astype(int)
        pairs = np.stack([np.repeat(large, [len(each) for each in near]), other], axis=1)
        found.append(np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0))
    pairs = np.concatenate(found)
    one, other = pairs.T
    return pairs[np.linalg.norm(middle[one] - middle[other], axis=1) <= radius[one] + radius[other]]


def _passes_through(sides: Float[HostArray, "n 3 3"], face: Float[HostArray, "n 3 3"]) -> Bool[HostArray, " n"]:
    """Whether an edge of a triangle passes through the inside of another triangle (Möller & Trumbore 1997)."""
    volume = lambda p, q, r, s: np.einsum("ni,ni->n", q - p, np.cross(r - p, s - p))
    a, b, c = np.moveaxis(face, 1, 0)
    found = np.zeros(len(sides), bool)
    for k in range(3):
        p, q = sides[:, k], sides[:, (k + 1) % 3]
        about = np.stack([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
        found |= (volume(p, a, b, c) * volume(q, a, b, c) < 0) & (np.all(about > 0, axis=0) | np.all(about < 0, axis=0))
    return found
