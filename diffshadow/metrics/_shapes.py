"""How far a shape is from another, a shadow from another, and where a surface intersects itself."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from .._self_intersections import intersecting_faces
from .._types import HostArray
from ._inputs import check_on_host

Triangles = tuple[HostArray, HostArray]
"""Vertices (v, 3) and faces (f, 3). Each mesh has its own v and f."""

# With 20,000 points, the distance of a mesh from itself is half a percent of its size.
_SAMPLES, _QUERIES = 600_000, 20_000


def intersection_over_union(image: ArrayLike, reference: ArrayLike) -> float:
    """The area that is dark in both images divided by the area that is dark in at least one: 1 for equal shadows, 0 for
    disjoint ones.

    A pixel is dark if its visibility is below 0.5. 1 if no pixel is dark.
    """
    check_on_host(image, reference)
    dark, other = np.asarray(image) < 0.5, np.asarray(reference) < 0.5
    union = int((dark | other).sum())
    return int((dark & other).sum()) / union if union else 1.0


def chamfer_distance(first: Triangles, second: Triangles, *, samples: int = _SAMPLES, seed: int = 0) -> float:
    """The mean distance from points of either surface to the nearest point of the other, in world units.

    Both surfaces are sampled, uniformly over their areas. For equal surfaces, the result is the distance between
    samples: 0.1 % of the size or less with the default number.

    **Arguments:**

    - `first`, `second`: vertices (v, 3) and faces (f, 3).
    - `samples`: points on each surface; for 20,000 of them, the nearest point is searched.
    - `seed`: seed of the points.
    """
    check_on_host(first, second)
    rng = np.random.default_rng(seed)
    one, other = (_sampled(vertices, faces, samples, rng) for vertices, faces in (first, second))
    far = [np.mean(KDTree(a).query(b[:_QUERIES])[0]) for a, b in ((one, other), (other, one))]
    return float(np.mean(far))


def _sampled(
    vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], count: int, rng: np.random.Generator
) -> Float[HostArray, "n 3"]:
    """Points uniform over the area of triangles, in random order."""
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    first, second = rng.random((2, count, 1))
    outside = first + second > 1
    u, v = np.where(outside, 1 - first, first), np.where(outside, 1 - second, second)
    return a[face] + u * (b - a)[face] + v * (c - a)[face]


def count_self_intersections(vertices: ArrayLike, faces: ArrayLike) -> int:
    """The number of intersecting pairs of faces without a common vertex; 0 for a surface that does not intersect
    itself.

    Two faces intersect if a side of one passes through the other. Faces that only touch, or overlap in one plane, do
    not count.
    """
    check_on_host(vertices, faces)
    return len(intersecting_faces(np.asarray(vertices, np.float64), np.asarray(faces)))
