"""The pixel centres that a triangle covers, and its depth there."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import safe_divide
from .._types import Viewport
from ._alpha_test import AlphaForm
from ._bins import Corners, WindowCoordinates
from ._depth_test import DepthTest
from ._fixed import SUBPIXEL_BITS, SUBPIXELS, edge_at_pixel, owns_edge, signed_area

# A centre may lie outside its unsnapped triangle by half a sub-pixel. Its depth may then exceed the range of the
# corners' depths by this fraction of the range. The limit matters for slivers, whose depths would otherwise run far
# outside.
_OVERSHOOT = 0.02


class DepthPlane(NamedTuple):
    """Planes of window depth: the value at the centre of pixel (0, 0), and the slopes per pixel; (n,) each."""

    origin: Float[Array, " n"]
    slope_x: Float[Array, " n"]
    slope_y: Float[Array, " n"]


class EdgeForm(eqx.Module):
    """Triangles as three edge functions relative to a pixel (`x`, `y`) of each triangle, and a depth plane.

    At `i` pixels to the right of that pixel and `j` pixels above it, the edge functions are `edge + i · a + j · b`. The
    centre is inside if none is negative. The depth at a pixel centre comes from `plane` and is clamped to `least` and
    `greatest`. Polygon offset adds `offset`, if it is set. `turn` is 1 for front faces, which are anticlockwise, and -1
    for back faces. The pixel is at (`row`, `column`) in the buffer. With an alpha test, `alpha` has the texture
    coordinates.
    """

    x: Int[Array, " n"]
    y: Int[Array, " n"]
    row: Int[Array, " n"]
    column: Int[Array, " n"]
    edge: Int[Array, "3 n"]
    a: Int[Array, "3 n"]
    b: Int[Array, "3 n"]
    plane: DepthPlane
    least: Float[Array, " n"]
    greatest: Float[Array, " n"]
    offset: Float[Array, " n"] | None
    turn: Int[Array, " n"]
    alpha: AlphaForm | None = None


def edge_form(
    corners: Corners,
    plane: DepthPlane,
    x: Int[Array, " n"],
    y: Int[Array, " n"],
    place: tuple[Int[Array, " n"], Int[Array, " n"]],
    test: DepthTest,
    polygon_offset: Float[Array, "2"] | None,
    alpha: AlphaForm | None = None,
) -> EdgeForm:
    """Edge functions of triangles of either winding, relative to the pixels (`x`, `y`).

    **Arguments:**

    - `plane`: the planes of the triangles.
    - `place`: row and column of these pixels in the buffer.
    - `polygon_offset`: (2,), OpenGL's factor and units.
    - `alpha`: the texture coordinates relative to these pixels, for an alpha test.
    """
    turn = jnp.where(signed_area(corners.x, corners.y) < 0, -1, 1)
    centre_x, centre_y = ((pixel << SUBPIXEL_BITS) + SUBPIXELS // 2 for pixel in (x, y))
    following_x, following_y = (jnp.roll(values, -1, axis=0) for values in (corners.x, corners.y))
    a, b = turn * (corners.y - following_y), turn * (following_x - corners.x)
    edge = edge_at_pixel(a, b, centre_x - corners.x, centre_y - corners.y, owns_edge(a, b))

    least = jnp.minimum(jnp.minimum(corners.z[0], corners.z[1]), corners.z[2])
    greatest = jnp.maximum(jnp.maximum(corners.z[0], corners.z[1]), corners.z[2])
    slack = _OVERSHOOT * (greatest - least)
    shift = None
    if polygon_offset is not None:
        factor, units = polygon_offset
        # OpenGL 4.6, section 14.6.5: o = m · factor + r · units.
        steepness = jnp.maximum(jnp.abs(plane.slope_x), jnp.abs(plane.slope_y))
        shift = steepness * factor + test.resolution_at(greatest) * units
    return EdgeForm(x, y, *place, edge, a, b, plane, least - slack, greatest + slack, shift, turn, alpha)


def plane_of_corners(window: WindowCoordinates, corners: Corners) -> DepthPlane:
    """The planes of triangles of either winding.

    The corners are not snapped, and the order of operations is the one of Mesa's rasterizer. So two surfaces that
    nearly touch are ordered as in Mesa.
    """
    clockwise = signed_area(corners.x, corners.y) < 0
    (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = (
        [jnp.where(clockwise, c[one], c[other]) for c in window] for one, other in ((0, 1), (1, 0), (2, 2))
    )
    dx01, dy01, dz01 = x0 - x1, y0 - y1, z0 - z1
    dx20, dy20, dz20 = x2 - x0, y2 - y0, z2 - z0
    area = dx01 * dy20 - dx20 * dy01
    inverse = safe_divide(jnp.ones_like(area), area)
    slope_x = dz01 * (dy20 * inverse) - dz20 * (dy01 * inverse)
    slope_y = dz20 * (dx01 * inverse) - dz01 * (dx20 * inverse)
    return DepthPlane(z0 - (slope_x * (x0 - 0.5) + slope_y * (y0 - 0.5)), slope_x, slope_y)


def plane_of_clip(corners: Float[Array, "4 3 n"], resolution: Viewport) -> DepthPlane:
    """The planes of triangles in clip coordinates. The triangles may reach behind the eye.

    Clipping may leave slivers that are thousands of pixels long. Rounding would spoil the planes of the slivers, so all
    parts use the plane of their triangle. Let M have the corners' (x, y, w) as columns, and let z be the row of their
    z: the depth at a point (x, y) of the view is z M⁻¹ (x, y, 1).
    """
    # A corner may have any scale. Unscaled products of three large numbers could overflow.
    size = jnp.max(jnp.abs(corners), axis=0)
    x, y, z, w = corners / jnp.where(size > 0, size, 1)
    pairs = ((1, 2), (2, 0), (0, 1))
    adjugate = [
        [first[i] * second[j] - first[j] * second[i] for i, j in pairs] for first, second in ((y, w), (w, x), (x, y))
    ]
    sum_over_corners = lambda a, b: a[1] * b[1] + a[2] * b[2] + a[0] * b[0]
    determinant = sum_over_corners(adjugate[2], w)
    along_x, along_y, middle = (safe_divide(sum_over_corners(column, z), determinant) / 2 for column in adjugate)
    height, width = resolution
    slope_x, slope_y = along_x * (2.0 / width), along_y * (2.0 / height)
    return DepthPlane(middle + 0.5 + slope_x * (0.5 - width * 0.5) + slope_y * (0.5 - height * 0.5), slope_x, slope_y)


def window_depth(form: EdgeForm, used: Bool[Array, " n"], side: int, test: DepthTest) -> Float[Array, "n side side"]:
    """The stored depth at the `side` x `side` pixels from each triangle's first pixel.

    Infinite where the triangle does not cover the centre, fails against an empty buffer, or is not `used`.
    """
    i = jnp.arange(side, dtype=jnp.int32)
    j = i[:, None]
    each = lambda values: values[:, None, None]
    # All three are non-negative if none has its sign bit set.
    first, second, third = (each(form.edge[k]) + each(form.a[k]) * i + each(form.b[k]) * j for k in range(3))
    inside = each(used) & ((first | second | third) >= 0)
    x, y = (each(form.x) + i).astype(jnp.float32), (each(form.y) + j).astype(jnp.float32)
    z = each(form.plane.origin) + each(form.plane.slope_x) * x + each(form.plane.slope_y) * y
    z = _between(each(form.least), z, each(form.greatest))
    inside = inside & (z >= 0) & (z <= 1)
    if form.offset is not None:
        z = _between(0, z + each(form.offset), 1)
    # Avoids -0, because its bits would sort wrongly.
    stored = test.encode(jnp.abs(z))
    return jnp.where(inside & test.passes_empty(stored), stored, jnp.inf)


def _between(least: Any, values: Float[Array, "*n"], greatest: Any) -> Float[Array, "*n"]:
    """Like `jnp.clip`, but with one instruction for each bound. `jnp.clip` needs four, because it handles NaN
    bounds."""
    values = jnp.where(least > values, least, values)
    return jnp.where(greatest < values, greatest, values)
