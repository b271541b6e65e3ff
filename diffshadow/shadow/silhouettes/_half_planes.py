"""Area of a rectangle cut by two half-planes, in closed form."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Below this a line counts as parallel to another.
_PARALLEL = 1e-12


class Rectangle(NamedTuple):
    """Sides of an axis-aligned rectangle, (n,) each."""

    left: Float[Array, "*n"] | float
    right: Float[Array, "*n"] | float
    below: Float[Array, "*n"] | float
    above: Float[Array, "*n"] | float


WHOLE_TEXEL = Rectangle(-0.5, 0.5, -0.5, 0.5)
"""A texel, relative to its centre."""


class HalfPlanes(NamedTuple):
    """Points p with `x · p_x + y · p_y >= offset`; (x, y) has unit length, or is zero for the whole plane.

    Each texel has a pair, (2, n).
    """

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    offset: Float[Array, "..."]


def cut_area(rectangle: Rectangle, planes: HalfPlanes) -> Float[Array, "*n"]:
    """Area of the part of each `rectangle` (n,) that lies in both of its half-planes (2, n).

    Differentiable with respect to all.
    """
    like = planes.offset[0]
    rectangle = Rectangle(*(jnp.broadcast_to(jnp.asarray(side, like.dtype), like.shape) for side in rectangle))
    return _cut_area(rectangle, planes)


@jax.custom_jvp
def _cut_area(rectangle: Rectangle, planes: HalfPlanes) -> Float[Array, "*n"]:
    return _area_and_sides(rectangle, planes)[0]


@_cut_area.defjvp
def _cut_area_jvp(primals, tangents):
    """Reynolds' transport theorem: the area grows by each side's length times its midpoint's speed outwards."""
    area, (right, left, above, below), parts = _area_and_sides(*primals)
    d, d_planes = tangents
    growth = right * d.right - left * d.left + above * d.above - below * d.below
    for (length, x, y), d_x, d_y, d_offset in zip(parts, *d_planes, strict=True):
        # The midpoint (x, y) moves by d_offset - (d_x, d_y) · (x, y) along the normal, which points inwards.
        growth = growth - length * (d_offset - d_x * x - d_y * y)
    return area, growth


def _area_and_sides(rectangle: Rectangle, planes: HalfPlanes) -> tuple[Any, Any, Any]:
    """The area and its boundary: lengths of the sides right, left, above and below, and length and midpoint of the part
    of each half-plane's line that bounds it. If two lines coincide, the first counts.

    The area of a polygon is half the sum over its sides of length times signed distance from any one point (here the
    rectangle's centre), positive if the point is on the inner side.
    """
    x, y = (rectangle.left + rectangle.right) / 2, (rectangle.below + rectangle.above) / 2
    width, height = rectangle.right - rectangle.left, rectangle.above - rectangle.below
    # Signed distances of the centre, positive inside. A list, since XLA would not fuse stacked arrays.
    lines = [(a, b, a * x + b * y - offset) for a, b, offset in zip(*planes, strict=True)]
    sides = []
    for horizontal, sign in ((True, 1), (True, -1), (False, 1), (False, -1)):
        if horizontal:
            start, along, half = (sign * width / 2, 0), (0, -sign), height / 2
        else:
            start, along, half = (0, sign * height / 2), (sign, 0), width / 2
        low, high = -half, half
        for line in lines:
            low, high = _clip(low, high, start, along, line, wins_ties=False)
        sides.append(jnp.maximum(high - low, 0))
    right, left, above, below = sides
    doubled = width / 2 * (right + left) + height / 2 * (above + below)

    parts = []
    for (a, b, s), other, is_first in zip(lines, lines[::-1], (True, False), strict=True):
        # From the foot of the perpendicular, which is -s (a, b) from the centre.
        start, along = (-s * a, -s * b), (-b, a)
        low, high = _clip(-(width + height), width + height, start, along, other, wins_ties=not is_first)
        for axis, half in enumerate((width / 2, height / 2)):
            low, high = _clip_to_slab(low, high, start[axis], along[axis], half)
        # A zero normal is the whole plane, which has no line.
        length = jnp.where(a * a + b * b > 0.25, jnp.maximum(high - low, 0), 0)
        t = (low + high) / 2
        parts.append((length, x - s * a - t * b, y - s * b + t * a))
        doubled = doubled + s * length
    return doubled / 2, sides, parts


def _clip(low: Any, high: Any, start: Any, along: Any, line: Any, wins_ties: bool) -> tuple[Any, Any]:
    """The part of `start + t · along`, t in [low, high], inside a half-plane `a x + b y + s >= 0`.

    If the half-plane's line coincides with this one and faces the same way, this line is inside unless the half-plane
    `wins_ties`.
    """
    a, b, s = line
    rise, value = a * along[0] + b * along[1], a * start[0] + b * start[1] + s
    parallel = jnp.abs(rise) < _PARALLEL
    t = -value / jnp.where(parallel, 1, rise)
    low = jnp.where(~parallel & (rise > 0), jnp.maximum(low, t), low)
    high = jnp.where(~parallel & (rise < 0), jnp.minimum(high, t), high)
    inside = value > 0
    if not wins_ties:
        inside = inside | ((value == 0) & (a * along[1] > b * along[0]))
    return low, jnp.where(parallel & ~inside, low, high)


def _clip_to_slab(low: Any, high: Any, start: Any, along: Any, half: Any) -> tuple[Any, Any]:
    """The part of `start + t · along`, t in [low, high], between -half and half."""
    parallel = jnp.abs(along) < _PARALLEL
    safe = jnp.where(parallel, 1, along)
    one, other = (-half - start) / safe, (half - start) / safe
    low = jnp.where(parallel, low, jnp.maximum(low, jnp.minimum(one, other)))
    high = jnp.where(parallel, high, jnp.minimum(high, jnp.maximum(one, other)))
    return low, jnp.where(parallel & ~(jnp.abs(start) < half), low, high)
