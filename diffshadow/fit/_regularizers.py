"""Regularisers of a mesh that is fitted to noisy images: penalties on folds and on long edges.

They match PyTorch3D's `mesh_normal_consistency` and `mesh_edge_loss` (Ravi et al. 2020), which follow Desbrun et al.
("Implicit Fairing of Irregular Meshes using Diffusion and Curvature Flow", SIGGRAPH 1999) and Wang et al.
("Pixel2Mesh", ECCV 2018). They run on the host, in closed form, and compile nothing.
"""

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray

# Faces below this fraction of the mesh's mean area have no normal.
_LEAST_AREA = 1e-9


class Regularizers:
    """Penalties of meshes with the same faces, and their derivative with respect to the vertices.

    - Normal consistency: the mean, over pairs of faces that share an edge, of 1 minus the cosine of the angle between
        their normals.
    - Edge length: the mean of the squares of lengths, as a fraction of this mean at the start.
    """

    def __init__(
        self,
        vertices: Float[HostArray, "v 3"],
        faces: Int[HostArray, "f 3"],
        normal_consistency: float,
        edge_length: float,
    ):
        self._faces, self._weights = faces, (normal_consistency, edge_length)
        halves = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        low_first = np.sort(halves, axis=1)
        self._edges, edge, count = np.unique(low_first, axis=0, return_inverse=True, return_counts=True)
        order = np.argsort(edge.reshape(-1), kind="stable")
        first = (np.cumsum(count) - count)[count == 2]
        pairs = order[np.stack([first, first + 1])]
        self._pairs = pairs // 3
        # Two faces with the same winding traverse their common edge in opposite directions.
        alike = (halves[pairs[0], 0] == halves[pairs[1], 1]) & (halves[pairs[0], 0] != halves[pairs[0], 1])
        self._signs = np.where(alike, 1.0, -1.0)
        self._squares = float(np.mean(np.sum(self._sides(vertices) ** 2, axis=1)))

    def __call__(self, vertices: Float[HostArray, "v 3"]) -> tuple[float, Float[HostArray, "v 3"]]:
        """The weighted sum of the penalties, and its derivative."""
        total, gradient = 0.0, np.zeros_like(vertices)
        for weight, penalty in zip(self._weights, (self._normal_consistency, self._edge_length), strict=True):
            if weight > 0:
                value, slope = penalty(vertices)
                total, gradient = total + weight * value, gradient + weight * slope
        return total, gradient

    def _sides(self, vertices: Float[HostArray, "v 3"]) -> Float[HostArray, "e 3"]:
        return vertices[self._edges[:, 1]] - vertices[self._edges[:, 0]]

    def _edge_length(self, vertices: Float[HostArray, "v 3"]) -> tuple[float, Float[HostArray, "v 3"]]:
        sides = self._sides(vertices)
        scale = 1 / (len(sides) * self._squares)
        slope = 2 * scale * sides
        return scale * float(np.sum(sides**2)), _summed(len(vertices), self._edges, np.stack([-slope, slope], axis=1))

    def _normal_consistency(self, vertices: Float[HostArray, "v 3"]) -> tuple[float, Float[HostArray, "v 3"]]:
        a, b, c = (vertices[self._faces[:, k]] for k in range(3))
        ab, ac = b - a, c - a
        normal = np.cross(ab, ac)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        has_one = length > _LEAST_AREA * np.mean(length)
        unit = np.where(has_one, normal / np.where(has_one, length, 1), 0)
        one, other = self._pairs
        sign = self._signs[:, None] / len(one)
        cosine = np.sum(sign * unit[one] * unit[other])
        by_unit = _summed(len(unit), self._pairs.T, -sign[:, None] * np.stack([unit[other], unit[one]], axis=1))
        along = np.sum(by_unit * unit, axis=1, keepdims=True)
        by_normal = np.where(has_one, (by_unit - along * unit) / np.where(has_one, length, 1), 0)
        by_b, by_c = np.cross(ac, by_normal), np.cross(by_normal, ab)
        return 1 - float(cosine), _summed(len(vertices), self._faces, np.stack([-by_b - by_c, by_b, by_c], axis=1))


def _summed(count: int, index: Int[HostArray, "n k"], values: Float[HostArray, "n k 3"]) -> Float[HostArray, "count 3"]:
    """For each of `count` numbers, the sum of the values with its index."""
    flat = index.reshape(-1)
    return np.stack([np.bincount(flat, values[..., axis].reshape(-1), count) for axis in range(3)], axis=1)
