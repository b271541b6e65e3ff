"""Which pixel centres a triangle covers, and how deep it is there."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._misc import safe_divide
from ._depth_test import DepthTest
from ._fixed import SUBPIXEL_BITS, SUBPIXELS, cross, edge_at_pixel, owns_edge, snap

# A centre may lie outside its unsnapped triangle by half a sub-pixel, and its depth beyond the corners' by this share
# of their range; a sliver's would run far further, and is held back.
_OVERSHOOT = 0.02


class EdgeForm(eqx.Module):
    """Triangles as three edge functions about a pixel of each one's own, and a depth plane.

    At `i` pixels to the right and `j` above that pixel the edge functions are `edge + i · a + j · b`, none negative
    where the centre is inside. Depth at the centre of pixel (x, y) is `origin + x · slope_x + y · slope_y`, kept
    between `least` and `greatest`; `offset` is added by polygon offset.
    """

    pixel: Int[Array, "n 2"]
    edge: Int[Array, "n 3"]
    a: Int[Array, "n 3"]
    b: Int[Array, "n 3"]
    origin: Float[Array, " n"]
    slope_x: Float[Array, " n"]
    slope_y: Float[Array, " n"]
    least: Float[Array, " n"]
    greatest: Float[Array, " n"]
    offset: Float[Array, " n"]


def edge_form(
    window: Float[Array, "n 3 3"],
    pixel: Int[Array, "n 2"],
    test: DepthTest,
    polygon_offset: Float[Array, "2"] | None,
) -> EdgeForm:
    """Edge functions and depth planes of triangles about `pixel` (n, 2).

    **Arguments:**

    - `window`: (n, 3, 3), corners in window coordinates, either winding.
    - `polygon_offset`: (2,), OpenGL's factor and units.
    """
    xy = snap(window[..., :2])
    following = jnp.roll(xy, -1, axis=1)
    a, b = -(following - xy)[..., 1], (following - xy)[..., 0]
    clockwise = cross(b[:, 0], -a[:, 0], -b[:, 2], a[:, 2]) < 0
    a, b = jnp.where(clockwise[:, None], -a, a), jnp.where(clockwise[:, None], -b, b)
    offset = ((pixel << SUBPIXEL_BITS) + SUBPIXELS // 2)[:, None] - xy
    edge = edge_at_pixel(a, b, offset[..., 0], offset[..., 1], owns_edge(a, b))

    origin, slope_x, slope_y = _depth_plane(window, clockwise)
    z = window[..., 2]
    least, greatest = z.min(axis=1), z.max(axis=1)
    slack = _OVERSHOOT * (greatest - least)
    shift = jnp.zeros_like(least)
    if polygon_offset is not None:
        factor, units = polygon_offset
        # OpenGL 4.6, section 14.6.5: o = m · factor + r · units.
        steepness = jnp.maximum(jnp.abs(slope_x), jnp.abs(slope_y))
        shift = steepness * factor + test.resolution_at(greatest) * units
    return EdgeForm(pixel, edge, a, b, origin, slope_x, slope_y, least - slack, greatest + slack, shift)


def _depth_plane(window: Float[Array, "n 3 3"], clockwise: Bool[Array, " n"]) -> tuple[Array, Array, Array]:
    """Depth at the centre of pixel (0, 0), and its change a pixel along x and y.

    From corners that are not snapped, with the order of operations of Mesa's rasterizer, so that two surfaces that
    nearly touch are told apart as it tells them.
    """
    swap = clockwise[:, None]
    p0 = jnp.where(swap, window[:, 0], window[:, 1])
    p1 = jnp.where(swap, window[:, 1], window[:, 0])
    p2 = window[:, 2]
    dx01, dy01, dz01 = (p0[:, k] - p1[:, k] for k in range(3))
    dx20, dy20, dz20 = (p2[:, k] - p0[:, k] for k in range(3))
    area = dx01 * dy20 - dx20 * dy01
    inverse = safe_divide(jnp.ones_like(area), area)
    slope_x = dz01 * (dy20 * inverse) - dz20 * (dy01 * inverse)
    slope_y = dz20 * (dx01 * inverse) - dz01 * (dx20 * inverse)
    origin = p0[:, 2] - (slope_x * (p0[:, 0] - 0.5) + slope_y * (p0[:, 1] - 0.5))
    return origin, slope_x, slope_y


def window_depth(form: EdgeForm, used: Array, side: int, test: DepthTest) -> Float[Array, "n side side"]:
    """What a depth buffer would store at the `side` x `side` pixels from each triangle's own.

    Infinite where the triangle does not cover the centre, does not pass against an empty buffer, or is not `used`.
    """
    i = jnp.arange(side, dtype=jnp.int32)
    j = i[:, None]
    inside = used[:, None, None]
    for k in range(3):
        edge, a, b = (x[:, k, None, None] for x in (form.edge, form.a, form.b))
        inside = inside & (edge + a * i + b * j >= 0)
    origin, slope_x, slope_y, least, greatest, offset = (
        x[:, None, None] for x in (form.origin, form.slope_x, form.slope_y, form.least, form.greatest, form.offset)
    )
    x, y = (form.pixel[:, k, None, None] for k in range(2))
    z = origin + slope_x * (x + i).astype(origin.dtype) + slope_y * (y + j).astype(origin.dtype)
    z = jnp.clip(z, least, greatest)
    inside = inside & (z >= 0) & (z <= 1)
    stored = test.encode(jnp.clip(z + offset, 0, 1))
    return jnp.where(inside & test.passes_clear(stored), stored, jnp.inf)
