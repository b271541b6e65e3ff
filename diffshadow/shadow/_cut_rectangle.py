"""Rectangles cut by half-planes, in closed form."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Rectangle(NamedTuple):
    """Sides of an axis-aligned rectangle, (...,) each."""

    left: Float[Array, "..."] | float
    right: Float[Array, "..."] | float
    below: Float[Array, "..."] | float
    above: Float[Array, "..."] | float


WHOLE_TEXEL = Rectangle(-0.5, 0.5, -0.5, 0.5)
"""A texel, seen from its centre."""


class HalfPlane(NamedTuple):
    """The points p with `x · p_x + y · p_y >= offset`; (x, y) of unit length, or zero where all points are meant."""

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    offset: Float[Array, "..."]


def cut_area(rectangle: Rectangle, one: HalfPlane, other: HalfPlane) -> Float[Array, "..."]:
    """Area of the part of `rectangle` that lies in both half-planes.

    Differentiable with respect to all.
    """
    like = one.offset
    rectangle = Rectangle(*(jnp.broadcast_to(jnp.asarray(side, like.dtype), like.shape) for side in rectangle))
    return _cut_area(rectangle, one, other)


@jax.custom_jvp
def _cut_area(rectangle: Rectangle, one: HalfPlane, other: HalfPlane) -> Float[Array, "..."]:
    return _area_and_sides(rectangle, one, other)[0]


@_cut_area.defjvp
def _cut_area_jvp(primals, tangents):
    """The area grows by the length of each side times how fast that side's middle moves outwards (Reynolds)."""
    area, (right, left, above, below), chords = _area_and_sides(*primals)
    d = tangents[0]
    growth = right * d.right - left * d.left + above * d.above - below * d.below
    for (length, x, y), d in zip(chords, tangents[1:], strict=True):
        # The line's middle (x, y) moves by d.offset - (d.x, d.y) · (x, y) along the normal, which points inwards.
        growth = growth - length * (d.offset - d.x * x - d.y * y)
    return area, growth


def _area_and_sides(rectangle: Rectangle, one: HalfPlane, other: HalfPlane) -> tuple[Any, Any, Any]:
    """The area, and what bounds it: the lengths of its sides right, left, above and below, and of either plane's line
    length and middle. Where two of these fall in one, the first counts.

    A polygon's area is half the sum, over its sides, of length times distance from any one point (here the
    rectangle's middle), positive where the point lies on the inner side.
    """
    x, y = (rectangle.left + rectangle.right) / 2, (rectangle.below + rectangle.above) / 2
    width, height = rectangle.right - rectangle.left, rectangle.above - rectangle.below
    # With signed distances of the middle, positive inside.
    planes = [(plane.x, plane.y, plane.x * x + plane.y * y - plane.offset) for plane in (one, other)]
    sides = [(sign * width / 2, 0, 0, -sign, height / 2) for sign in (1, -1)]
    sides += [(0, sign * height / 2, sign, 0, width / 2) for sign in (1, -1)]
    right, left, above, below = (_length(*_within(*side, planes)) for side in sides)
    box = [(1.0, 0.0, width / 2), (-1.0, 0.0, width / 2), (0.0, 1.0, height / 2), (0.0, -1.0, height / 2)]
    doubled = width / 2 * (right + left) + height / 2 * (above + below)
    chords = []
    for (a, b, s), before, after in zip(planes, ([], planes[:1]), (planes[1:], []), strict=True):
        # From the foot of the perpendicular, which is -s (a, b) from the middle; a zero normal has no line.
        low, high = _within(-s * a, -s * b, -b, a, width + height, after, [*box, *before])
        length = jnp.where(a * a + b * b > 0.25, _length(low, high), 0)
        t = (low + high) / 2
        chords.append((length, x - s * a - t * b, y - s * b + t * a))
        doubled = doubled + s * length
    return doubled / 2, (right, left, above, below), chords


def _length(low: Any, high: Any) -> Any:
    return jnp.maximum(high - low, 0)


def _within(
    x: Any, y: Any, along_x: Any, along_y: Any, half: Any, after: Sequence[Any], before: Sequence[Any] = ()
) -> tuple[Any, Any]:
    """Where the segment (x, y) + t (along_x, along_y), |t| <= half, bounds on its right what lies within all cuts:
    a x + b y + s >= 0. If it falls in one with a cut's line, and they do not face each other, it does so only where
    the cut comes `after` it."""
    low, high = -half, half
    for number, (a, b, s) in enumerate((*after, *before)):
        rise, start = a * along_x + b * along_y, a * x + b * y + s
        level = jnp.abs(rise) < 1e-12
        t = -start / jnp.where(level, 1, rise)
        low = jnp.where(~level & (rise > 0), jnp.maximum(low, t), low)
        high = jnp.where(~level & (rise < 0), jnp.minimum(high, t), high)
        counts = (start > 0) | ((start == 0) & (a * along_y > b * along_x)) if number < len(after) else start > 0
        high = jnp.where(level & ~counts, low, high)
    return low, high
