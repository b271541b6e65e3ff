"""Silhouettes: the edges at which a mesh, seen from a light, ends.

Every face is given an orientation: +1 if it counts as it is wound, -1 if it counts turned over, 0 if it does not
count. The outline of all that count is then the sum, edge by edge, of the sides that their faces run along, each with
its orientation: where two neighbours run along an edge in opposite ways, it cancels. What is left over is how often
the edge belongs to the outline: never more than twice on a two-manifold, more often where further faces meet. Two
finders work out that sum and agree, one from a table of the edges made beforehand, and one from the faces alone.
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
    """Edges and how often each belongs to the outline of the faces that count.

    - `vertices`: (e, 2), the ends of each.
    - `multiplicity`: (e,), how many more of the faces, each turned as it counts, run along it from the first end to
        the second than back; 0 where it is no silhouette.
    """

    vertices: Int[Array, "e 2"]
    multiplicity: Int[Array, " e"]


def light_sides(mesh: Mesh, light: AbstractLight) -> Int[Array, " f"]:
    """Which side of each face the light sees: +1 its front, -1 its back, 0 where it sees the face edge-on.

    The light faces the front where ((a + b + c) / 3 - L) · ((b - a) x (c - b)) is negative.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    to_light = light.towards((a + b + c) / 3)
    return jnp.sign(dot(to_light, jnp.cross(b - a, c - b))).astype(jnp.int32)


def silhouettes_by_adjacency(edges: Edges, orientation: Int[Array, " f"]) -> Silhouettes:
    """The silhouettes of faces with `orientation` (f,), from the faces that meet in each edge.

    **Arguments:**

    - `edges`: of the mesh.
    - `orientation`: (f,), +1, -1 or 0.

    **Returns:** a multiplicity for each row of `edges`. An edge of three or more faces has several rows, and the sum
    of theirs.
    """
    return Silhouettes(edges.vertices, jnp.sum(edges.directions * orientation[edges.faces], axis=1))


def silhouettes_by_cancelling(faces: Faces, orientation: Int[Array, " f"]) -> Silhouettes:
    """The same silhouettes, from pushing every face's sides onto a list and cancelling those that run back.

    It sorts all sides, so it takes longer than `silhouettes_by_adjacency`, but needs no table.

    **Arguments:**

    - `faces`: (f, 3), with neighbours naming the same vertices, as `share_vertices` makes them.
    - `orientation`: (f,), +1, -1 or 0.

    **Returns:** (3 f,) rows. Each silhouette is in one of them, from its lower vertex to its higher; the others hold
    multiplicity 0.
    """
    start, end = faces.reshape(-1), jnp.roll(faces, -1, axis=1).reshape(-1)
    pushed = jnp.repeat(orientation, 3) * jnp.sign(end - start)
    low, high, pushed = lax.sort((jnp.minimum(start, end), jnp.maximum(start, end), pushed), num_keys=2)
    is_new = jnp.ones(low.shape, bool).at[1:].set((low[1:] != low[:-1]) | (high[1:] != high[:-1]))
    edge = jnp.cumsum(is_new, dtype=jnp.int32) - 1
    total = jax.ops.segment_sum(pushed, edge, low.shape[0], indices_are_sorted=True)
    return Silhouettes(jnp.stack([low, high], axis=1), jnp.where(is_new, total[edge], 0))
