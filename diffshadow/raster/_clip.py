"""Clipping of triangles that cross the near plane or leave the guard band.

Most triangles need no clipping: their pixel boxes are cut to the viewport, and the depth range is tested at each pixel.
Triangles that reach behind the eye, or so far sideways that fixed-point coordinates would overflow, are clipped in
homogeneous coordinates (Sutherland & Hodgman 1974; Blinn & Newell 1978).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._types import Viewport
from ._fixed import GUARD_BAND

PLANES = 6
# A plane adds at most one corner to a convex polygon; a polygon of k corners is a fan of k - 2 triangles.
_CORNERS = 3 + PLANES
FAN = _CORNERS - 2
# The minimum w of a part, as a fraction of the triangle's maximum w.
_MIN_W = 1e-6


def guard_ratio(resolution: Viewport) -> tuple[Any, Any]:
    """The guard band as a multiple of the viewport's half width and half height, at least 1."""
    height, width = resolution
    ratio = lambda side: 2.0 * GUARD_BAND / side
    if isinstance(width, int):
        return ratio(width), ratio(height)
    return jnp.maximum(ratio(width), 1), jnp.maximum(ratio(height), 1)


def needs_clipping(clip: Float[Array, "*n 4"], resolution: Viewport) -> Bool[Array, "*n"]:
    """Whether a vertex is in front of the near plane, behind the eye, or outside the guard band."""
    x, y, z, w = (clip[..., k] for k in range(4))
    gx, gy = guard_ratio(resolution)
    return ~((w > 0) & (z >= -w) & (jnp.abs(x) <= gx * w) & (jnp.abs(y) <= gy * w))


def clip_triangles(corners: Float[Array, "4 3 n"], resolution: Viewport) -> Float[Array, "4 3 fan n"]:
    """The parts of triangles beyond the near plane and within the guard band.

    **Arguments:**

    - `corners`: (4, 3, n), clip coordinates.

    **Returns:** (4, 3, 7, n), a fan of triangles for each triangle. Unused entries have no area.
    """
    gx, gy = guard_ratio(resolution)
    # Inside is plane · (x, y, z, w) >= 0. The last plane keeps w above 0 even if the near plane does not.
    planes = jnp.array(
        [[0, 0, 1, 1], [-1, 0, 0, gx], [1, 0, 0, gx], [0, -1, 0, gy], [0, 1, 0, gy], [0, 0, 0, 1]], corners.dtype
    )
    offsets = jnp.array([0, 0, 0, 0, 0, _MIN_W], corners.dtype)
    scale = jnp.max(jnp.abs(corners[3]), axis=0)
    start = jnp.pad(corners, ((0, 0), (0, PLANES), (0, 0))), jnp.full(scale.shape, 3, jnp.int32)
    # A loop, because six unrolled iterations would take seconds to compile.
    clip = lambda polygon, plane: (_clip_against(*polygon, *plane), None)
    (polygon, count), _ = jax.lax.scan(clip, start, (planes, offsets[:, None] * scale))
    fan = jnp.arange(1, FAN + 1, dtype=jnp.int32)[:, None]
    first, used = polygon[:, :1], fan + 1 < count
    second, third = (jnp.where(used, polygon[:, k : k + FAN], first) for k in (1, 2))
    fans = jnp.stack([jnp.broadcast_to(first, second.shape), second, third], axis=1)
    # An empty polygon becomes a point in the centre of the view, which covers nothing.
    return jnp.where(count >= 3, fans, jnp.array([0, 0, 0, 1], corners.dtype)[:, None, None, None])


def _clip_against(
    polygon: Float[Array, "4 m n"], count: Int[Array, " n"], plane: Float[Array, "4"], offset: Float[Array, " n"]
) -> tuple[Float[Array, "4 m n"], Int[Array, " n"]]:
    """The parts of polygons with `count` corners each on the inner side of a plane."""
    slots = polygon.shape[1]
    slot = np.arange(slots, dtype=np.int32)[:, None]
    used, next_ = slot < count, lambda values: jnp.where(slot + 1 < count, jnp.roll(values, -1, -2), values[..., :1, :])
    following = next_(polygon)
    distance = polygon[1] * plane[1] + polygon[2] * plane[2] + polygon[3] * plane[3] + polygon[0] * plane[0] - offset
    distance_following = next_(distance)
    inside, inside_following = distance >= 0, distance_following >= 0
    crosses = inside != inside_following
    # Interpolates from the inner corner outwards, so that two triangles with a common edge compute the same point.
    inner, outer = jnp.where(inside, polygon, following), jnp.where(inside, following, polygon)
    d_inner = jnp.where(inside, distance, distance_following)
    d_outer = jnp.where(inside, distance_following, distance)
    t = d_inner / jnp.where(crosses, d_inner - d_outer, 1)
    crossing = inner + t * (outer - inner)

    # An inner corner comes before the crossing after it. Each goes to the slot of its rank.
    keeps, cuts = used & inside, used & crosses
    both = jnp.where(keeps, 1, 0) + jnp.where(cuts, 1, 0)
    before = jnp.sum(jnp.where(slot[:, None] < slot, both[:, None], 0), axis=0, dtype=jnp.int32)
    goes = lambda emitted, rank: emitted[:, None] & (rank[:, None] == slot)
    put = lambda goes, values: jnp.sum(jnp.where(goes, values[:, :, None], 0), axis=1)
    kept, cut = goes(keeps, before), goes(cuts, before + jnp.where(keeps, 1, 0))
    return put(kept, polygon) + put(cut, crossing), jnp.sum(both, axis=0, dtype=jnp.int32)
