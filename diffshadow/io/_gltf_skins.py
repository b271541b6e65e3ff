"""Skins of glTF files, whose vertices follow joints.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 3.7.3.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ._errors import damaged
from ._gltf_data import Buffers, entry_of
from ._gltf_schema import Document, Primitive, Skin


class Posed(NamedTuple):
    """Vertices (v, 3) in world space, triangles (t, 3), and normals (v, 3) if the file has normals."""

    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "t 3"]
    normals: Float[HostArray, "v 3"] | None


class Skins:
    """Poses meshes by the joints' positions in the file.

    **Arguments:** `to_world`: the matrix of each node of the scene to world space, by its number.
    """

    def __init__(self, document: Document, buffers: Buffers, to_world: Mapping[int, Float[HostArray, "4 4"]]):
        self._document, self._buffers, self._to_world = document, buffers, to_world

    def posed(
        self,
        number: int,
        primitive: Primitive,
        vertices: Float[HostArray, "v 3"],
        faces: Int[HostArray, "t 3"],
        normals: Float[HostArray, "v 3"] | None,
    ) -> Posed:
        """The vertices and triangles of a primitive with the skin of this number. Each vertex is moved by the weighted
        mean of its joints' matrices. The position of a node with a skin is ignored.

        **Raises** `MeshError` if the skin cannot be read, and `NoDataError` if an extension provides it.
        """
        matrices = self._matrices(number)
        joints, weights = self._influences(primitive, len(vertices))
        if joints.max() >= len(matrices):
            raise damaged(f"its vertices follow joint {joints.max()} of its skin {number}, which has {len(matrices)}")
        mean = np.zeros((len(vertices), 4, 4))
        for joint, weight in zip(joints.T, weights.T, strict=True):
            mean += weight[:, None, None] * matrices[joint]
        linear = mean[:, :3, :3]
        moved = np.einsum("vij,vj->vi", linear, vertices) + mean[:, :3, 3]
        is_mirrored = np.linalg.det(linear) < 0
        wound = np.where(is_mirrored[faces[:, :1]], faces[:, ::-1], faces)
        if normals is None:
            return Posed(moved, wound, None)
        # The inverse transpose, up to a factor. This also works for a scale of 0.
        cofactors = np.stack([np.cross(linear[:, i - 2], linear[:, i - 1]) for i in range(3)], axis=1)
        turned = np.einsum("vij,vj->vi", cofactors, normals) * np.where(is_mirrored, -1, 1)[:, None]
        length = np.linalg.norm(turned, axis=-1, keepdims=True)
        return Posed(moved, wound, turned / np.where(length > 0, length, 1))

    def _matrices(self, number: int) -> Float[HostArray, "j 4 4"]:
        """The matrices of the skin's joints, from the mesh's space to world space."""
        skin = entry_of(Skin, self._document.skins, number)
        if skin is None or not skin.joints or not all(joint in self._to_world for joint in skin.joints):
            raise damaged(f"the scene lacks its skin {number}, or joints of it")
        places = np.stack([self._to_world[joint] for joint in skin.joints])
        if skin.inverse_bind_matrices is None:
            return places
        stored = self._buffers.values(skin.inverse_bind_matrices, "MAT4").astype(np.float64)
        if len(stored) < len(places) or not np.isfinite(stored).all():
            raise damaged(f"its skin {number} has {len(places)} joints and {len(stored)} finite matrices")
        return places @ stored[: len(places)].reshape(-1, 4, 4).swapaxes(1, 2)

    def _influences(self, primitive: Primitive, count: int) -> tuple[Int[HostArray, "v w"], Float[HostArray, "v w"]]:
        """The joints that each of `count` vertices follows, and their weights, which add up to 1."""
        joints, weights = [], []
        while (name := f"JOINTS_{len(joints)}") in primitive.attributes:
            joints.append(self._buffers.values(primitive.attributes[name], "VEC4"))
            weight = primitive.attributes.get(name.replace("JOINTS", "WEIGHTS"))
            weights.append(joints[-1] * 0.0 if weight is None else self._buffers.values(weight, "VEC4"))
        if not joints or any(len(rows) != count for rows in (*joints, *weights)):
            raise damaged("its vertices with a skin have no joints")
        parts = np.maximum(np.concatenate(weights, axis=1).astype(np.float64), 0)
        total = parts.sum(axis=1, keepdims=True)
        if not np.isfinite(total).all():
            raise damaged("the weights of its joints are NaN or infinite")
        # A vertex without weights follows its first joint.
        parts = np.where(total > 0, parts / np.where(total > 0, total, 1), np.eye(1, parts.shape[1]))
        return np.where(parts > 0, np.concatenate(joints, axis=1), 0).astype(np.int64), parts
