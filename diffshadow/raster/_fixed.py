"""Fixed-point window coordinates and exact edge functions.

Vertices snap to a grid of 1/256 pixel, as in graphics hardware. A triangle's corners are therefore integers, and the
sign of an edge function at a pixel centre is exact. If two triangles share an edge, exactly one of them owns a centre
on it.

The edge function of the directed edge from `a` to `b` at `p`, positive on the edge's left,

    E(p) = (b - a) x (p - a) = A (p_x - a_x) + B (p_y - a_y),   A = -(b_y - a_y),  B = b_x - a_x

(Pineda 1988) needs up to 49 bits. It is computed once for each triangle or block with 64 bits. A step of one pixel adds
`256 A` or `256 B`. The sign at every other centre therefore follows from `floor(E / 256)` in 32 bits, with steps `A`
and `B`.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._arithmetic import as_float
from .._types import Resolution
from ..settings.quantities import MAX_VIRTUAL

OfCorners = Sequence[Int[Array, " n"]] | Int[Array, "3 n"]
"""A number for each corner of triangles, three (n,) or (3, n)."""

SUBPIXEL_BITS = 8
SUBPIXELS = 1 << SUBPIXEL_BITS
"""Steps per pixel. Vertices are drawn at whole steps."""

# Vertices farther than this from the viewport's centre, in pixels, are clipped first. This keeps edge coefficients
# within 2²¹.
GUARD_BAND = 4096
# Beyond this value, an edge function cannot change sign within a block of 16 x 16 pixels (2²⁴ · 2 · 15 < 2²⁹).
_FAR = 1 << 29


def snap(window: Float[Array, "*n"]) -> Int[Array, "*n"]:
    """Window coordinates in pixels, rounded to the nearest sub-pixel."""
    # Nothing within a virtual map is clipped; coefficients stay within 2²⁴.
    limit = float(MAX_VIRTUAL * SUBPIXELS)
    return jnp.round(jnp.clip(window * SUBPIXELS, -limit, limit)).astype(jnp.int32)


@partial(jax.jit, static_argnums=(1, 2))
def at_steps(clip: Float[Array, "*b v 4"], resolution: Resolution, subpixels: int) -> Float[Array, "*b v 4"]:
    """Vertices (..., v, 4) in clip space, moved to the nearest of `subpixels` steps to a pixel.

    A rasterizer with coarser steps places vertices in this way before it computes depth and attributes. Vertices behind
    the eye do not move.
    """
    ahead = clip[..., 3:] > 0
    w = jnp.where(ahead, clip[..., 3:], 1)
    steps = as_float(resolution[::-1]) * (subpixels / 2)
    placed = (jnp.round((clip[..., :2] / w + 1) * steps) / steps - 1) * w
    return jnp.concatenate([jnp.where(ahead, placed, clip[..., :2]), clip[..., 2:]], axis=-1)


def first_centre(low: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Index of the first pixel whose centre is at or beyond the fixed-point coordinate `low`."""
    return (low + (SUBPIXELS // 2 - 1)) >> SUBPIXEL_BITS


def last_centre(high: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Index of the last pixel whose centre is at or before the fixed-point coordinate `high`."""
    return (high - SUBPIXELS // 2) >> SUBPIXEL_BITS


def signed_area(x: OfCorners, y: OfCorners) -> Float[Array, " n"]:
    """Twice the signed area of triangles with corners at fixed-point `x` and `y`. It is negative for clockwise
    triangles, and its sign is exact."""
    ax, ay, bx, by = x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]
    # 32-bit arithmetic wraps, so a small result is right. For large results, only the sign matters. With 64 bits, a
    # million triangles take a third longer.
    estimate = ax.astype(jnp.float32) * by.astype(jnp.float32) - ay.astype(jnp.float32) * bx.astype(jnp.float32)
    wrapped = (ax * by - ay * bx).astype(jnp.float32)
    return jnp.where(jnp.abs(estimate) < _FAR, wrapped, estimate)


def edge_at_pixel(
    a: Int[Array, "*n"], b: Int[Array, "*n"], dx: Int[Array, "*n"], dy: Int[Array, "*n"], owns_edge: Array
) -> Int[Array, "*n"]:
    """`floor(E / 256)` of an edge with coefficients `a` and `b` at the offset (`dx`, `dy`) from its start.

    A large value is replaced by a large number of the same sign. `owns_edge` says whether a centre exactly on the edge
    is inside. The result is negative exactly if the centre is outside.
    """
    with jax.enable_x64(True):
        a, b, dx, dy = (value.astype(jnp.int64) for value in (a, b, dx, dy))
        edge = (a * dx + b * dy - ~owns_edge) >> SUBPIXEL_BITS
        return jnp.clip(edge, -_FAR, _FAR).astype(jnp.int32)


def owns_edge(a: Int[Array, "*n"], b: Int[Array, "*n"]) -> Array:
    """Whether a centre exactly on the edge (`a`, `b`) of an anticlockwise triangle is inside the triangle.

    OpenGL only requires that exactly one of two neighbours owns the centre. Here left and bottom edges own their
    centres, which is Mesa's choice with `y` upwards. A left edge runs downwards, and a bottom edge runs to the right.
    """
    return (a > 0) | ((a == 0) & (b > 0))
