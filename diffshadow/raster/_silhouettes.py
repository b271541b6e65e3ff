"""Silhouettes: the edges of a mesh's outline, seen from a light.

Every face has an orientation: +1 if it counts as wound, -1 if it counts flipped, 0 if it does not count. The outline is
the sum over these faces of their directed sides: sides of opposite direction along an edge cancel. The multiplicity of
an edge is what remains. It is at most 2 on a two-manifold, and can be larger where more faces meet. Two functions
compute the same sum: one from a table of the edges, and one from the faces alone.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from .._misc import dot
from .._types import Faces
from ..geometry import AbstractLight, Edges, Mesh


class Silhouettes(eqx.Module):
    """Edges and their multiplicities in the outline of the faces that count.

    - `vertices`: (e, 2), the ends of each.
    - `multiplicity`: (e,), the number of oriented faces that traverse the edge from its first end to its second, minus
        the number that traverse it backwards; 0 if it is not a silhouette.
    """

    vertices: Int[Array, "e 2"]
    multiplicity: Int[Array, " e"]


@eqx.filter_jit
def light_sides(mesh: Mesh, light: AbstractLight) -> Int[Array, " f"]:
    """Which side of each face the light sees: +1 its front, -1 its back, 0 if it sees the face edge-on.

    It sees the front if ((a + b + c) / 3 - L) · ((b - a) x (c - b)) is negative.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    to_light = light.towards((a + b + c) / 3)
    return jnp.sign(dot(to_light, jnp.cross(b - a, c - b))).astype(jnp.int32)


@eqx.filter_jit
def silhouettes_by_adjacency(edges: Edges, orientation: Int[Array, " f"]) -> Silhouettes:
    """The silhouettes of faces with `orientation` (f,), from a table of the faces that meet in each edge.

    **Arguments:**

    - `edges`: of the mesh.
    - `orientation`: (f,), +1, -1 or 0.

    **Returns:** a multiplicity for each row of `edges`. An edge of three or more faces has several rows, whose
    multiplicities add up.
    """
    return Silhouettes(edges.vertices, jnp.sum(edges.directions * orientation[edges.faces], axis=1))


@eqx.filter_jit
def silhouettes_by_cancelling(faces: Faces, orientation: Int[Array, " f"]) -> Silhouettes:
    """The same silhouettes, by listing the directed sides of all faces and cancelling opposite ones.

    It sorts all sides, so it takes longer than `silhouettes_by_adjacency`, but needs no table.

    **Arguments:**

    - `faces`: (f, 3), where neighbours use the same vertex indices, as from `share_vertices`.
    - `orientation`: (f,), +1, -1 or 0.

    **Returns:** (3 f,) rows. Each silhouette is in one row, from its lower vertex to its higher; all other rows have
    multiplicity 0.
    """
    start, end = faces.reshape(-1), jnp.roll(faces, -1, axis=1).reshape(-1)
    pushed = jnp.repeat(orientation, 3) * jnp.sign(end - start)
    low, high, pushed = lax.sort((jnp.minimum(start, end), jnp.maximum(start, end), pushed), num_keys=2)
    is_new = jnp.ones(low.shape, bool).at[1:].set((low[1:] != low[:-1]) | (high[1:] != high[:-1]))
    edge = jnp.cumsum(is_new, dtype=jnp.int32) - 1
    total = jax.ops.segment_sum(pushed, edge, low.shape[0], indices_are_sorted=True)
    return Silhouettes(jnp.stack([low, high], axis=1), jnp.where(is_new, total[edge], 0))
