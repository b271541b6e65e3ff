"""The outline of a mesh as a light sees it, in the window of its map."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._types import Resolution
from ...geometry import AbstractLight, Edges, Mesh
from ...raster import Segments, light_sides, silhouettes_by_adjacency


class Outline(eqx.Module):
    """Silhouette edges clipped to the map with a border of one texel. The caster is to their left.

    - `start`, `end`: (n, 2), in texels; `depth`: (n, 2), window depth at both; `layer`: (n,), layer of the map.
    - `counts`: (n, 2), the numbers of vertical and horizontal texel boundaries that each edge crosses.
    """

    start: Float[Array, "n 2"]
    end: Float[Array, "n 2"]
    depth: Float[Array, "n 2"]
    layer: Int[Array, " n"]
    counts: Int[Array, "n 2"]

    @classmethod
    def of(
        cls, clip: Float[Array, "*l v 4"], mesh: Mesh, light: AbstractLight, edges: Edges, resolution: Resolution
    ) -> "Outline":
        """The silhouettes of a `mesh`, with these `edges` and clip coordinates (v, 4), as seen from `light`."""
        found = silhouettes_by_adjacency(edges, light_sides(mesh, light))
        ends = jnp.where((found.multiplicity >= 0)[:, None], found.vertices, found.vertices[:, ::-1])
        clip = clip.reshape(-1, *clip.shape[-2:])
        used = jnp.tile(found.multiplicity != 0, clip.shape[0])
        at = Segments.of(clip[:, ends].reshape(-1, 2, 4), used, resolution)
        layer = jnp.repeat(jnp.arange(clip.shape[0], dtype=jnp.int32), ends.shape[0])
        return cls(at.start, at.end, at.depth, layer, at.counts)
