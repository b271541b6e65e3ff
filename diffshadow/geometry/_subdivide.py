"""Subdivision of triangles."""

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray


def split_in_four(
    vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"]
) -> tuple[Float[HostArray, "w 3"], Int[HostArray, "g 3"], Int[HostArray, "e 2"]]:
    """Splits each triangle in four at the midpoints of its edges, which neighbours share. The surface does not change.

    **Returns:** vertices (v + e, 3), with the given vertices first; faces (4 f, 3), four consecutive ones for each
    given face; and (e, 2), the two vertices on either side of each new vertex.
    """
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=-1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = len(vertices) + inverse.reshape(-1, 3)
    (a, b, c), (ab, bc, ca) = faces.T, middle.T
    cut = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=-1).reshape(-1, 3)
    return np.concatenate([vertices, vertices[edges].mean(axis=1)]), cut, edges
