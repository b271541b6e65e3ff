"""Edges of a mesh and their faces, which define possible silhouettes.

Seen from a point, an edge is a silhouette if one of its faces faces the point and the other faces away, or if it has
only one face. The faces of an edge do not change when vertices move, so the table is built once, on the host.
"""

import dataclasses

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .._arithmetic import as_array, as_int
from .._checks import check_outside_trace
from .._padding import padded_to, shared_size
from .._types import HostArray
from ._mesh import Mesh, MeshLike, as_mesh

NO_NEIGHBOUR = -1
"""The second face of an edge that has only one."""


class Edges(eqx.Module):
    """The edges of a mesh. Vertices at the same place count as one vertex, even if their indices differ.

    - `vertices`: (e, 2), the ends, as indices into the mesh's vertices. If several vertices have the same position, the
        first of them. The first face traverses the edge from the first end to the second.
    - `faces`: (e, 2), the faces of the edge; the second is `NO_NEIGHBOUR` if there is only one.
    - `directions`: (e, 2), +1 if the face traverses the edge from its first end to its second, -1 if it traverses it
        backwards, 0 if there is no face. The first entry is always +1; the second is -1 if both faces have the same
        winding.
    - `component`: (f,), the connected part of the mesh that each face belongs to.
    - `solid`: (c,), whether a component bounds a volume: it is closed, and its faces are anticlockwise seen from
        outside, that is, its signed volume is positive.
    - `is_closed`: whether the whole mesh is closed: every edge is traversed equally often in both directions.

    An edge between three or more faces has one row per face, without a second face. Such an edge therefore always
    counts as a silhouette. Faces with two corners at the same position have no edges. Faces whose three corners are
    collinear have edges.
    """

    vertices: Int[Array, "e 2"]
    faces: Int[Array, "e 2"]
    directions: Int[Array, "e 2"]
    component: Int[Array, " f"]
    solid: Bool[Array, " c"]
    is_closed: bool = eqx.field(static=True)

    @classmethod
    def of(cls, mesh: MeshLike) -> "Edges":
        """The edges of `mesh`.

        Only vertices at exactly the same position count as one. `weld` merges vertices that are close to each other.

        **Raises** `ValueError` if the mesh is traced.
        """
        mesh = as_mesh(mesh)
        remedy = "call Edges.of(mesh) outside, and pass the edges in"
        check_outside_trace("Edges.of", "a mesh of concrete vertices and faces", remedy, (mesh.vertices, mesh.faces))
        vertices = np.asarray(mesh.vertices)
        faces = share_vertices(mesh)
        runs = _Runs(faces)
        component = _components(runs, len(faces))
        balanced = np.bincount(runs.edge, runs.direction, runs.count) == 0
        closed = np.ones(component.max() + 1, bool)
        closed[component[runs.face[~balanced[runs.edge]]]] = False
        volume = np.bincount(component, _signed_volumes(vertices, faces))
        ends, meeting, directions = (as_int(values) for values in _rows(runs))
        solid = as_array(closed & (volume > 0))
        return cls(ends, meeting, directions, as_int(component), solid, bool(closed.all()))

    def renumbered(self, vertices: Int[HostArray, " v"], faces: Int[HostArray, " f"]) -> "Edges":
        """The edges after the mesh was merged with others. Its vertex `i` is `vertices[i]` of the merged mesh, and its
        face `i` is `faces[i]`."""
        own = np.asarray(self.faces)
        component = np.zeros(faces.max() + 1, int)
        component[faces] = self.component
        return dataclasses.replace(
            self,
            vertices=as_int(vertices[np.asarray(self.vertices)]),
            faces=as_int(np.where(own == NO_NEIGHBOUR, NO_NEIGHBOUR, faces[own])),
            component=as_int(component),
        )

    def padded(self, faces: int, to: int | None = None) -> "Edges":
        """The edges, padded to the number of rows that the mesh `padded` to this many faces needs. Added edges are
        never silhouettes.

        **Arguments:** `to`: the number of edges after padding; by default the next of a few sizes.
        """
        if isinstance(self.vertices, Tracer):
            return self
        size = shared_size(self.vertices.shape[0]) if to is None else to
        return Edges(
            as_int(padded_to(self.vertices, size)),
            as_int(padded_to(self.faces, size)),
            as_int(padded_to(self.directions, size)),
            as_int(padded_to(self.component, faces)),
            as_array(padded_to(self.solid, shared_size(self.solid.shape[0]))),
            self.is_closed,
        )


def share_vertices(mesh: Mesh) -> Int[HostArray, "f 3"]:
    """The mesh's faces. Each index is replaced by the first vertex at the same position. For concrete meshes.

    Unlike `weld`, this keeps all faces, their order and the vertices, so that the result indexes `mesh.vertices`.
    """
    # Adding 0 turns -0 into 0.
    _, first, group = np.unique(np.asarray(mesh.vertices) + 0.0, axis=0, return_index=True, return_inverse=True)
    return first[group.reshape(-1)][np.asarray(mesh.faces)]


class _Runs:
    """The half-edges of all faces, sorted by edge.

    - `start`, `end`: (n,), vertices; `face`: (n,); `direction`: (n,), +1 if it runs to the higher index, otherwise -1.
    - `edge`: (n,), ascending; `count`: the number of edges.
    """

    def __init__(self, faces: Int[HostArray, "f 3"]):
        a, b, c = faces.T
        whole = np.flatnonzero((a != b) & (b != c) & (c != a))
        start = faces[whole].reshape(-1)
        end = np.roll(faces[whole], -1, axis=1).reshape(-1)
        low, high = np.minimum(start, end), np.maximum(start, end)
        order = np.lexsort((high, low))
        self.start, self.end, self.face = start[order], end[order], np.repeat(whole, 3)[order]
        self.direction = np.where(self.start < self.end, 1, -1)
        low, high = low[order], high[order]
        is_new = np.ones(len(order), bool)
        is_new[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
        self.edge = np.cumsum(is_new) - 1
        self.count = int(is_new.sum())


def _rows(runs: _Runs) -> tuple[HostArray, HostArray, HostArray]:
    """`vertices`, `faces` and `directions` of the table."""
    meeting = np.bincount(runs.edge, minlength=runs.count)[runs.edge]
    is_second = np.zeros(len(runs.edge), bool)
    is_second[1:] = (meeting[1:] == 2) & (runs.edge[1:] == runs.edge[:-1])
    first = np.flatnonzero(~is_second)
    paired = meeting[first] == 2
    # The two faces of a pair are neighbours in the list.
    second = np.where(paired, first + 1, first)
    vertices = np.stack([runs.start[first], runs.end[first]], axis=1)
    faces = np.stack([runs.face[first], np.where(paired, runs.face[second], NO_NEIGHBOUR)], axis=1)
    turn = runs.direction[first] * runs.direction[second]
    return vertices, faces, np.stack([np.ones_like(turn), np.where(paired, turn, 0)], axis=1)


def _components(runs: _Runs, count: int) -> Int[HostArray, " f"]:
    """The connected part, numbered from 0, of each of `count` faces. Faces that share an edge are connected."""
    # Faces and edges are the nodes of a graph, in this order, and each face is linked to its edges.
    links = coo_array((np.ones(len(runs.face), bool), (runs.face, count + runs.edge)), shape=(count + runs.count,) * 2)
    _, label = connected_components(links, directed=False)
    return label[:count]


def _signed_volumes(vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"]) -> Float[HostArray, " f"]:
    """Volume, in cubic world units, of the tetrahedron from the mesh's centre to each face; negative if clockwise."""
    corners = np.asarray(vertices, np.float64)[faces]
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return np.sum(a * np.cross(b, c), axis=-1) / 6
