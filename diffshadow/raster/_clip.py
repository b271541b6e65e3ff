"""Clipping of triangles that cross the near plane or leave the guard band.

Most triangles need no clipping: their pixel boxes are cut to the viewport, and the depth range is tested at each pixel.
Triangles that reach behind the eye, or so far sideways that fixed-point coordinates would overflow, are clipped in
homogeneous coordinates (Sutherland & Hodgman 1974; Blinn & Newell 1978).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._misc import dot
from .._types import Viewport
from ._fixed import GUARD_BAND

PLANES = 6
# A plane adds at most one corner to a convex polygon; a polygon of k corners is a fan of k - 2 triangles.
_CORNERS = 3 + PLANES
FAN = _CORNERS - 2
# The least w that is kept, as a fraction of the triangle's greatest.
_LEAST_W = 1e-6


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


def clip_triangles(corners: Float[Array, "n 3 4"], resolution: Viewport) -> Float[Array, "n fan 3 4"]:
    """The parts of triangles beyond the near plane and within the guard band.

    **Arguments:**

    - `corners`: (n, 3, 4), clip coordinates.

    **Returns:** (n, 7, 3, 4), a fan of triangles for each; unused triangles have no area.
    """
    gx, gy = guard_ratio(resolution)
    # Inside is plane · (x, y, z, w) >= 0. The last plane keeps w above 0 even if the near plane does not.
    planes = jnp.array(
        [[0, 0, 1, 1], [-1, 0, 0, gx], [1, 0, 0, gx], [0, -1, 0, gy], [0, 1, 0, gy], [0, 0, 0, 1]], corners.dtype
    )
    offsets = jnp.array([0, 0, 0, 0, 0, _LEAST_W], corners.dtype)
    return jax.vmap(lambda triangle: _clip_one(triangle, planes, offsets))(corners)


def _clip_one(triangle: Float[Array, "3 4"], planes: Float[Array, "p 4"], offsets: Float[Array, " p"]) -> Array:
    scale = jnp.max(jnp.abs(triangle[:, 3]))
    start = jnp.zeros((_CORNERS, 4), triangle.dtype).at[:3].set(triangle), jnp.int32(3)
    # A loop, since its six iterations unrolled would take seconds to compile.
    clip = lambda polygon, plane: (_clip_against(*polygon, *plane), None)
    (polygon, count), _ = jax.lax.scan(clip, start, (planes, offsets * scale))
    fan = jnp.arange(1, FAN + 1)
    used = fan + 1 < count
    first = jnp.broadcast_to(polygon[0], (FAN, 4))
    second = jnp.where(used[:, None], polygon[fan], first)
    third = jnp.where(used[:, None], polygon[fan + 1], first)
    # An empty polygon becomes a point in the centre of the view, which covers nothing.
    nothing = jnp.array([0.0, 0.0, 0.0, 1.0], triangle.dtype)
    return jnp.where(count >= 3, jnp.stack([first, second, third], axis=1), nothing)


def _clip_against(polygon: Float[Array, "m 4"], count: Array, plane: Float[Array, "4"], offset: Array):
    slots = polygon.shape[0]
    slot = jnp.arange(slots)
    following = polygon[jnp.where(slot + 1 < count, slot + 1, 0)]
    distance = dot(polygon, plane) - offset
    distance_following = dot(following, plane) - offset
    inside, inside_following = distance >= 0, distance_following >= 0
    crosses = inside != inside_following
    # From the inner corner outwards, so that two triangles that share an edge compute the same point.
    inner = jnp.where(inside[:, None], polygon, following)
    outer = jnp.where(inside[:, None], following, polygon)
    d_inner = jnp.where(inside, distance, distance_following)
    d_outer = jnp.where(inside, distance_following, distance)
    t = d_inner / jnp.where(crosses, d_inner - d_outer, 1)
    crossing = inner + t[:, None] * (outer - inner)

    used = slot < count
    emitted = jnp.stack([used & inside, used & crosses], axis=1).reshape(-1)
    corners = jnp.stack([polygon, crossing], axis=1).reshape(-1, 4)
    place = jnp.where(emitted, jnp.cumsum(emitted) - 1, slots)
    clipped = jnp.zeros_like(polygon).at[place].set(corners, mode="drop")
    return clipped, jnp.sum(emitted).astype(jnp.int32)
