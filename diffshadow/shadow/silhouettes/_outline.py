"""The outline of a mesh as a light sees it, in the window of its map."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..._types import Resolution
from ...geometry import AbstractLight, Edges, Mesh
from ...raster import count_crossings, light_sides, silhouettes_by_adjacency


class Outline(eqx.Module):
    """Silhouette edges clipped to the map with a border of one texel; the caster lies to their left.

    - `start`, `end`: (n, 2), in texels; `depth`: (n, 2), window depth at both; `layer`: (n,), of the map.
    - `counts`: (n, 2), how many vertical and horizontal texel boundaries each edge crosses.
    - `following`: (n,), the edge that starts at the vertex where each one ends; one of several, -1 for none.
    """

    start: Float[Array, "n 2"]
    end: Float[Array, "n 2"]
    depth: Float[Array, "n 2"]
    layer: Int[Array, " n"]
    counts: Int[Array, "n 2"]
    following: Int[Array, " n"]

    @classmethod
    def of(
        cls, clip: Float[Array, "*l v 4"], mesh: Mesh, light: AbstractLight, edges: Edges, resolution: Resolution
    ) -> "Outline":
        """The silhouettes that `light` sees of a `mesh` with these `edges` and clip coordinates (v, 4)."""
        found = silhouettes_by_adjacency(edges, light_sides(mesh, light))
        ends = jnp.where((found.multiplicity >= 0)[:, None], found.vertices, found.vertices[:, ::-1])
        clip = clip.reshape(-1, *clip.shape[-2:])
        corners = clip[:, ends].reshape(-1, 2, 4)
        first, last = _clip(lax.stop_gradient(corners), resolution)
        used = jnp.tile(found.multiplicity != 0, clip.shape[0]) & (first < last)
        edge = corners[:, 1] - corners[:, 0]
        height, width = resolution

        def place(fraction: Float[Array, " n"]) -> tuple[Float[Array, "n 2"], Float[Array, " n"]]:
            """Where edges are in the map after this fraction of their length, and the window depth there."""
            # One coordinate at a time: in reverse mode, XLA is slow to add up such short axes.
            x, y, z, w = jnp.moveaxis(corners[:, 0] + fraction[:, None] * edge, -1, 0)
            x, y, z = (of_clip / jnp.where(used, w, 1) * 0.5 + 0.5 for of_clip in (x, y, z))
            return jnp.stack([x * width, y * height], axis=-1), z

        (start, nearest), (end, farthest) = place(first), place(last)
        counts = count_crossings(*lax.stop_gradient((start, end)), used)
        layer = jnp.repeat(jnp.arange(clip.shape[0], dtype=jnp.int32), ends.shape[0])
        number = jnp.where(found.multiplicity != 0, jnp.arange(ends.shape[0], dtype=jnp.int32), -1)
        following = jnp.full(clip.shape[1], -1, jnp.int32).at[ends[:, 0]].max(number)[ends[:, 1]]
        following = jnp.where(following < 0, -1, following + layer.reshape(clip.shape[0], -1) * ends.shape[0])
        return cls(start, end, jnp.stack([nearest, farthest], axis=-1), layer, counts, following.reshape(-1))


def _clip(corners: Float[Array, "n 2 4"], resolution: Resolution) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Clips edges to the map with a border of one texel (Liang & Barsky 1984). Returns the fractions of each edge at
    which the visible part starts and ends; the first is not less than the last if nothing is visible."""
    x, y, z, w = jnp.moveaxis(corners, -1, 0)
    x, y = x / (1 + 2 / resolution[1]), y / (1 + 2 / resolution[0])
    planes = jnp.stack([x, -x, y, -y, z, -z])
    a, b = jnp.moveaxis(w + planes, -1, 0)
    fraction = a / jnp.where(a == b, 1, a - b)
    first = jnp.max(jnp.where((a < 0) & (b > a), fraction, 0), axis=0)
    last = jnp.min(jnp.where((b < 0) & (a > b), fraction, 1), axis=0)
    return first, jnp.where(jnp.any((a < 0) & (b < 0), axis=0), 0, last)
