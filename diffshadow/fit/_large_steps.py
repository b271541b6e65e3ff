"""Large steps: a change of variables that smooths the steps of a mesh's vertices.

The gradient of a vertex comes from the few texels that an outline crosses nearby. Steps along this gradient would tear
a mesh apart. Nicolet, Jacobson & Jakob ("Large Steps in Inverse Rendering of Geometry", ACM Transactions on Graphics
40, 2021) descend on u = (I + λ L) x instead of the vertices x, with L the mesh's Laplacian. A step in u moves
neighbours together.
"""

from typing import Any

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

from .._types import HostArray


def neighbours(count: int, faces: Int[HostArray, "f 3"]) -> Any:
    """A sparse matrix (count, count) that is 1 where two of the `count` vertices share an edge."""
    pairs = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    near = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    return near + near.T


class LargeSteps:
    """u = (I + λ L) x for vertices x, with the uniform Laplacian L. Only `free` vertices have a u.

    The matrix is symmetric, so the gradient with respect to u solves the same system for the gradient with respect to
    x.
    """

    def __init__(
        self,
        vertices: Float[HostArray, "v 3"],
        faces: Int[HostArray, "f 3"],
        free: Bool[HostArray, " v"],
        strength: float,
    ):
        count = len(vertices)
        near = neighbours(count, faces)
        whole = (sparse.eye_array(count) + strength * (sparse.diags_array(near.sum(axis=1)) - near)).tocsr()
        self._free, self._start = free, np.array(vertices)
        self._matrix = whole[free][:, free].tocsc()
        # The contribution of the fixed vertices.
        self._still = whole[free][:, ~free] @ vertices[~free]
        self._solve = splu(self._matrix).solve

    def u_of(self, vertices: Float[HostArray, "v 3"]) -> Float[HostArray, "n 3"]:
        """u of the n free vertices."""
        return self._matrix @ vertices[self._free] + self._still

    def vertices_of(self, u: Float[HostArray, "n 3"]) -> Float[HostArray, "v 3"]:
        """All vertices."""
        found = self._start.copy()
        found[self._free] = self._solve(u - self._still)
        return found

    def gradient_of(self, gradient: Float[HostArray, "v 3"]) -> Float[HostArray, "n 3"]:
        """The gradient with respect to u, from the `gradient` with respect to the vertices."""
        return self._solve(gradient[self._free])
