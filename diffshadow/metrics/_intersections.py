"""Where a surface intersects itself."""

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from .._types import HostArray
from ._inputs import check_on_host


def count_self_intersections(vertices: ArrayLike, faces: ArrayLike) -> int:
    """The number of pairs of faces without a common vertex that intersect; 0 for a surface that does not.

    Two faces intersect if a side of one passes through the other. Faces that only touch, or overlap in one plane, do
    not count.
    """
    check_on_host(vertices, faces)
    faces = np.asarray(faces)
    corners = np.asarray(vertices, np.float64)[faces]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=-1).max(axis=1)
    near = KDTree(middle).query_ball_point(middle, radius + radius.max(), return_sorted=False)
    one = np.repeat(np.arange(len(faces)), [len(each) for each in near])
    other = np.concatenate([*near, []]).astype(int)
    low, high = corners.min(axis=1), corners.max(axis=1)
    # A pair counts once. The greater face's ball reaches the smaller one's.
    one, other = np.unique(np.sort([one, other], axis=0), axis=1)
    meet = (one != other) & np.all((low[one] <= high[other]) & (low[other] <= high[one]), axis=1)
    meet &= ~np.any(faces[one][:, :, None] == faces[other][:, None], axis=(1, 2))
    a, b = corners[one[meet]], corners[other[meet]]
    return int(np.sum(_passes_through(a, b) | _passes_through(b, a)))


def _passes_through(sides: Float[HostArray, "n 3 3"], face: Float[HostArray, "n 3 3"]) -> Bool[HostArray, " n"]:
    """Whether a side of a triangle passes through the inside of another triangle (Möller & Trumbore 1997)."""
    volume = lambda p, q, r, s: np.einsum("ni,ni->n", q - p, np.cross(r - p, s - p))
    a, b, c = np.moveaxis(face, 1, 0)
    found = np.zeros(len(sides), bool)
    for k in range(3):
        p, q = sides[:, k], sides[:, (k + 1) % 3]
        about = np.stack([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
        found |= (volume(p, a, b, c) * volume(q, a, b, c) < 0) & (np.all(about > 0, axis=0) | np.all(about < 0, axis=0))
    return found
