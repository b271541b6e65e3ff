"""Which pixel centres a triangle covers, and how deep it is there."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._misc import safe_divide
from ._fixed import SUBPIXEL_BITS, SUBPIXELS, cross, edge_at_pixel, owns_edge


class EdgeForm(eqx.Module):
    """Triangles as three edge functions and a depth plane, about a pixel of each one's own.

    At `i` pixels to the right and `j` above that pixel the edge functions are `edge + i · a + j · b`, none negative
    where the centre is inside, and the depth is `depth + i · slope_x + j · slope_y`, in window depth.
    """

    edge: Int[Array, "n 3"]
    a: Int[Array, "n 3"]
    b: Int[Array, "n 3"]
    depth: Float[Array, " n"]
    slope_x: Float[Array, " n"]
    slope_y: Float[Array, " n"]
    least: Float[Array, " n"]
    greatest: Float[Array, " n"]


def edge_form(xy: Int[Array, "n 3 2"], z: Float[Array, "n 3"], pixel: Int[Array, "n 2"]) -> EdgeForm:
    """Edge functions and depth plane of triangles about `pixel` (n, 2).

    **Arguments:**

    - `xy`: (n, 3, 2), corners in sub-pixels, either winding; `z`: (n, 3), their window depths.
    """
    following = jnp.roll(xy, -1, axis=1)
    a, b = -(following - xy)[..., 1], (following - xy)[..., 0]
    area = cross(b[:, 0], -a[:, 0], -b[:, 2], a[:, 2])
    turned = (area < 0)[:, None]
    a, b = jnp.where(turned, -a, a), jnp.where(turned, -b, b)
    offset = ((pixel << SUBPIXEL_BITS) + SUBPIXELS // 2)[:, None] - xy
    edge = edge_at_pixel(a, b, offset[..., 0], offset[..., 1], owns_edge(a, b))

    # Barycentric coordinate k is the edge function opposite corner k over the area, so dz/dx = Σ z_k a_{k+1} / area;
    # Σ a = 0 lets depths be taken relative to the first, which keeps their precision.
    relative = z - z[:, :1]
    opposite_a, opposite_b = jnp.roll(a, -1, axis=1), jnp.roll(b, -1, axis=1)
    scale = safe_divide(jnp.full_like(area, SUBPIXELS), jnp.abs(area))
    slope_x = jnp.sum(relative * opposite_a, axis=1) * scale
    slope_y = jnp.sum(relative * opposite_b, axis=1) * scale
    from_first = offset[:, 0].astype(z.dtype) / SUBPIXELS
    depth = z[:, 0] + slope_x * from_first[:, 0] + slope_y * from_first[:, 1]
    return EdgeForm(edge, a, b, depth, slope_x, slope_y, z.min(axis=1), z.max(axis=1))


def window_depth(form: EdgeForm, used: Array, side: int) -> Float[Array, "n side side"]:
    """Depth at the `side` x `side` pixels from each triangle's own, infinite where it does not cover the centre.

    A triangle that is not `used` covers nothing.
    """
    i = jnp.arange(side, dtype=jnp.int32)
    j = i[:, None]
    inside = used[:, None, None]
    for k in range(3):
        edge, a, b = (x[:, k, None, None] for x in (form.edge, form.a, form.b))
        inside = inside & (edge + a * i + b * j >= 0)
    depth, slope_x, slope_y, least, greatest = (
        x[:, None, None] for x in (form.depth, form.slope_x, form.slope_y, form.least, form.greatest)
    )
    # Rounding must not carry a sliver's depth beyond its corners'.
    z = jnp.clip(depth + slope_x * i + slope_y * j, least, greatest)
    return jnp.where(inside & (z >= 0) & (z <= 1), z, jnp.inf)
