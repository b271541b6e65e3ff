"""Removes self-intersections of a fitted surface by smoothing the surface there.

A shadow shows nothing about walls inside a shape, so nothing in a fit's loss keeps one wall from passing through
another.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from .._self_intersections import intersecting_faces
from .._types import HostArray
from ._large_steps import neighbours

# The number of searches for intersections, and the number of times between searches that vertices move halfway to their
# neighbours' mean.
_ROUNDS, _MOVES = 20, 3


def untangled(
    vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], free: Bool[HostArray, " v"]
) -> Float[HostArray, "v 3"]:
    """The vertices of a surface, moved where faces intersect, together with their neighbours. Only `free` vertices
    move.

    Faces may still intersect where vertices are not free, or where one part is inside another.
    """
    near = None
    for _ in range(_ROUNDS):
        meeting = intersecting_faces(vertices, faces)
        meeting = meeting[free[faces[meeting]].any(axis=(1, 2))]
        if not len(meeting):
            break
        if near is None:
            near, vertices = neighbours(len(vertices), faces), vertices.copy()
        moved = np.zeros(len(vertices))
        moved[faces[meeting]] = 1
        at = free & ((moved > 0) | (near @ moved > 0))
        own = near[at]
        for _ in range(_MOVES):
            vertices[at] = (vertices[at] + (own @ vertices) / own.sum(axis=1)[:, None]) / 2
    return vertices
