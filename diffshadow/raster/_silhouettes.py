"""Silhouettes: the outline edges of a mesh, seen from a light.

Every face has an orientation: +1 if it counts as wound, -1 if it counts flipped, and 0 if it does not count. The
outline is the sum of these faces' directed sides. Sides of opposite direction along an edge cancel, and the remainder
is the multiplicity of the edge. It is at most 2 on a two-manifold, and can be larger where more faces meet.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from .._arithmetic import dot
from ..geometry import AbstractLight, Edges, Mesh


class Silhouettes(eqx.Module):
    """Edges, and their multiplicities in the outline of the faces that count.

    - `vertices`: (e, 2), the ends of each edge.
    - `multiplicity`: (e,), the number of oriented faces that traverse the edge from its first end to its second, minus
      the number that traverse it backwards; 0 if it is not a silhouette.
    """

    vertices: Int[Array, "e 2"]
    multiplicity: Int[Array, " e"]


@eqx.filter_jit
def light_sides(mesh: Mesh, light: AbstractLight) -> Int[Array, " f"]:
    """The side of each face that the light sees: +1 for the front, -1 for the back, and 0 if it sees the face edge-on.

    It sees the front if ((a + b + c) / 3 - L) · ((b - a) x (c - b)) is negative.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    to_light = light.towards((a + b + c) / 3)
    return jnp.sign(dot(to_light, jnp.cross(b - a, c - b))).astype(jnp.int32)


@eqx.filter_jit
def silhouettes_by_adjacency(edges: Edges, orientation: Int[Array, " f"]) -> Silhouettes:
    """The silhouettes of faces with `orientation` (f,), from a table of the faces at each edge.

    **Arguments:**

    - `edges`: the edges of the mesh.
    - `orientation`: (f,), +1, -1 or 0.

    **Returns:** a multiplicity for each row of `edges`. An edge with three or more faces has several rows. Their
    multiplicities add up.
    """
    return Silhouettes(edges.vertices, jnp.sum(edges.directions * orientation[edges.faces], axis=1))
