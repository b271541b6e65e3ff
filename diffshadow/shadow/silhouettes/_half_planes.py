"""Area of a rectangle cut by two half-planes, in closed form."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

# Below this value, a line counts as parallel to a side.
_PARALLEL = 1e-12
# Below this value, the two lines count as parallel, and as equal if they are no farther apart. Rounding would otherwise
# decide which part of each line is beyond the other.
_SAME = 1e-5


class Rectangle(NamedTuple):
    """Sides of an axis-aligned rectangle, (n,) each."""

    left: Float[Array, "*n"] | float
    right: Float[Array, "*n"] | float
    below: Float[Array, "*n"] | float
    above: Float[Array, "*n"] | float


WHOLE_TEXEL = Rectangle(-0.5, 0.5, -0.5, 0.5)
"""A texel, relative to its centre."""


Pair = Float[Array, "..."] | Sequence[Float[Array, "..."]]
"""A value for each of two half-planes: along a first axis, or in an array for each."""


class HalfPlanes(NamedTuple):
    """Points p with `x · p_x + y · p_y >= offset`; (x, y) has unit length, or is zero for the whole plane.

    Each texel has a pair: (2, n), or two arrays (n,).
    """

    x: Pair
    y: Pair
    offset: Pair


def cut_area(rectangle: Rectangle, planes: HalfPlanes) -> Float[Array, "*n"]:
    """Area of each `rectangle` (n,) inside both of its half-planes (2, n).

    Differentiable with respect to all.
    """
    like = planes.offset[0]
    rectangle = Rectangle(*(jnp.broadcast_to(jnp.asarray(side, like.dtype), like.shape) for side in rectangle))
    return _cut_area(rectangle, planes)


@jax.custom_jvp
def _cut_area(rectangle: Rectangle, planes: HalfPlanes) -> Float[Array, "*n"]:
    # Without the barriers, here and below, XLA puts everything into a kernel that also gathers, and does not vectorize
    # it.
    return lax.optimization_barrier(_area_and_sides(rectangle, planes)[0])


@_cut_area.defjvp
def _cut_area_jvp(primals, tangents):
    """Reynolds' transport theorem: the area grows by each side's length times its midpoint's outward speed."""
    area, (right, left, above, below), parts = lax.optimization_barrier(_area_and_sides(*primals))
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
    # Signed distances of the centre, positive inside. A list, because XLA would not fuse stacked arrays.
    lines = [(a, b, a * x + b * y - offset) for a, b, offset in zip(*planes, strict=True)]
    # Each division occurs once, because XLA makes a kernel of it.
    inverses = [(_inverse(a), _inverse(b)) for a, b, _ in lines]
    sides = []
    for is_upright, sign in ((True, 1), (True, -1), (False, 1), (False, -1)):
        if is_upright:
            start, along, half = (sign * width / 2, 0), (0, -sign), height / 2
        else:
            start, along, half = (0, sign * height / 2), (sign, 0), width / 2
        low, high = -half, half
        for line, (of_a, of_b) in zip(lines, inverses, strict=True):
            inverse = -sign * of_b if is_upright else sign * of_a
            value, above = _against(line, start, along)
            inside = (value > 0) | ((value == 0) & above)
            low, high = _clip(low, high, value, inside, inverse)
        sides.append(jnp.maximum(high - low, 0))
    right, left, above, below = sides
    doubled = width / 2 * (right + left) + height / 2 * (above + below)

    parts = []
    (a, b, _), (other_a, other_b, _) = lines
    of_cross = _inverse(a * other_b - b * other_a, _SAME)
    for k in (0, 1):
        (a, b, s), (of_a, of_b) = lines[k], inverses[k]
        # From the foot of the perpendicular, which is -s (a, b) from the centre.
        start, along = (-s * a, -s * b), (-b, a)
        low, high = -(width + height), width + height
        value, alike = _against(lines[1 - k], start, along)
        inside = (value > _SAME) | ((jnp.abs(value) <= _SAME) & alike & (k == 0))
        low, high = _clip(low, high, value, inside, -of_cross if k else of_cross)
        for at, half, inverse in zip(start, (width / 2, height / 2), (-of_b, of_a), strict=True):
            for sign in (1, -1):
                within = half + sign * at
                low, high = _clip(low, high, within, within > 0, sign * inverse)
        # A zero normal is the whole plane, which has no line.
        length = jnp.where(a * a + b * b > 0.25, jnp.maximum(high - low, 0), 0)
        t = (low + high) / 2
        parts.append((length, x - s * a - t * b, y - s * b + t * a))
        doubled = doubled + s * length
    return doubled / 2, sides, parts


def _inverse(rise: Any, least: float = _PARALLEL) -> Any:
    """1 / `rise`, or 0 if that is below `least`."""
    parallel = jnp.abs(rise) < least
    return jnp.where(parallel, 0, 1 / jnp.where(parallel, 1, rise))


def _against(line: Any, start: Any, along: Any) -> tuple[Any, Any]:
    """The distance of `start` inside a half-plane `a x + b y + s >= 0`, and whether its inner side is to the left of
    `along`."""
    a, b, s = line
    return a * start[0] + b * start[1] + s, a * along[1] > b * along[0]


def _clip(low: Any, high: Any, value: Any, inside: Any, inverse: Any) -> tuple[Any, Any]:
    """The part of [low, high] where `value + t · rise >= 0`, given the `inverse` of the rise; if that is 0, whether all
    is `inside`."""
    t = -value * inverse
    low = jnp.where(inverse > 0, jnp.maximum(low, t), low)
    high = jnp.where(inverse < 0, jnp.minimum(high, t), high)
    return low, jnp.where((inverse == 0) & ~inside, low, high)
