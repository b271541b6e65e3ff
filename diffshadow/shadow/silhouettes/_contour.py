"""The line of the outline through each texel, as two half-planes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import normalize, take
from ._crossings import BOTTOM, RIGHT, TOP, Grid, OutlineCrossings
from ._half_planes import HalfPlanes

# An offset so low that the half-plane contains every texel.
_EVERYWHERE = -1e6
# The sine of the smallest angle that counts as a corner of the outline within a texel.
_MIN_TURN = 1e-3

# A texel's corners (row, column), along the walk around it, and whether the walk follows the direction of the sides
# that begin there.
_CORNERS = np.array([(0, 0), (0, 1), (1, 1), (1, 0)], np.int32)
_FORWARD = np.array([[True], [True], [False], [False]])


class Contours(NamedTuple):
    """The outline in texels (t,).

    - `planes`: (2, t), half-planes relative to the texel's centre.
    - `inner`, `outer`: window depths inside both half-planes, and elsewhere in the texel.
    - `follows`: whether edges define the line; only then do the half-planes carry its derivative.
    - `exists`: whether the outline passes through the texel at all.
    """

    planes: HalfPlanes
    inner: Float[Array, " t"]
    outer: Float[Array, " t"]
    follows: Bool[Array, " t"]
    exists: Bool[Array, " t"]


class _Points(NamedTuple):
    """The positions where the outline enters or leaves texels, relative to their centres.

    `direction` is 0 if no edge is known. `motion` is zero, with the derivative of the edge's point.
    """

    place: Float[Array, "2 t 2"]
    direction: Float[Array, "2 t 2"]
    motion: Float[Array, "2 t 2"]

    @classmethod
    def of(cls, crossings: OutlineCrossings, crossing: Int[Array, "4 t"], side: Int[Array, "2 t"]) -> "_Points":
        """The crossing of each given side, looked up among all crossings, or the middle of the side if it has none."""
        texels = crossing.shape[1]
        own = take(crossing.reshape(-1), side * texels + jnp.arange(texels, dtype=jnp.int32))
        along, is_level = take(crossings.place, own) - 0.5, (side == BOTTOM) | (side == TOP)
        x = jnp.where(is_level, along, jnp.where(side == RIGHT, 0.5, -0.5))
        y = jnp.where(is_level, jnp.where(side == TOP, 0.5, -0.5), along)
        return cls(jnp.stack([x, y], axis=-1), take(crossings.direction, own), take(crossings.motion, own))

    @property
    def on_edge(self) -> Bool[Array, "2 t"]:
        return jnp.any(lax.stop_gradient(self.direction) != 0, axis=-1)


def find_contours(
    depth: Float[Array, " m"], corners: Float[Array, " k"], crossings: OutlineCrossings, grid: Grid
) -> Contours:
    """The contours of texels with crossings, (t,).

    Casters begin and end along the walk around a texel. The outline runs from the end of a caster to the start of a
    caster, with the caster to its left.
    """
    texel = jnp.minimum(crossings.texel, grid.texels - 1)
    layer, row, column = texel // (grid.height * grid.width), texel // grid.width % grid.height, texel % grid.width
    # Without the barriers, here and below, XLA computes an index again in each gather that uses it.
    layer, row, column = lax.optimization_barrier((layer, row, column))
    z, own = corners[grid.corner(layer, row + _CORNERS[:, :1], column + _CORNERS[:, 1:])], depth[texel]
    crossing = lax.optimization_barrier(crossings.at)
    edge_depth = crossings.depth[crossing]
    near, far = jnp.min(edge_depth, axis=(0, 1)), jnp.max(z, axis=0)
    threshold = lax.stop_gradient(jnp.minimum(near, far) + far) / 2

    covered, exists = z < threshold, edge_depth < threshold
    # The last entry represents no crossing.
    crossing = jnp.where(exists, crossing, crossings.depth.size - 1)
    following = jnp.roll(covered, -1, axis=0)
    place = jnp.where(_FORWARD, crossings.place[crossing], 1 - crossings.place[crossing])
    # A caster narrower than the side, which covers neither of its corners.
    bar = ~covered & ~following & exists[0] & exists[1] & (place[1] < place[0])
    used = jnp.stack([covered & ~following, ~covered & following]) | bar
    # Whether two pieces of casters in a texel are connected. A caster that misses all corners is connected.
    is_band = ~jnp.any(covered, axis=0) | (own < threshold)
    start, end, has_two = _pair(used[0], used[1], is_band)
    start, end = _Points.of(crossings, crossing[0], start), _Points.of(crossings, crossing[1], end)
    start, end = _moved(start, end), _moved(end, start)

    bend = jnp.where(has_two, 0, _bend(start, end))
    at_ends = jax.tree.map(lambda start, end: jnp.stack([start[0], end[0]]), start, end)
    straight = start._replace(direction=normalize(end.place - start.place))
    planes = jax.tree.map(lambda a, b: jnp.where(bend != 0, a, b), _left_of(at_ends), _left_of(straight))
    # Two separate casters, and a concave corner, are the complement of two flipped half-planes.
    flipped = (has_two & ~is_band) | (bend < 0)
    everywhere = HalfPlanes(*(jnp.array([[0], [value]]) for value in (0, 0, _EVERYWHERE)))
    is_one = ~(has_two | (bend != 0)) & np.array([[False], [True]])
    planes = jax.tree.map(lambda v, all_: jnp.where(is_one, all_, jnp.where(flipped, -v, v)), planes, everywhere)

    # A caster that misses the centre gets the depth of its deepest crossing. With a nearer crossing, it would shadow
    # itself.
    deepest = jnp.max(jnp.where(used & exists, edge_depth, 0), axis=(0, 1))
    near = jnp.where(own < threshold, own, jnp.where(deepest > 0, deepest, near))
    inner, outer = jnp.where(flipped, far, near), jnp.where(flipped, near, far)
    on_edge = start.on_edge | end.on_edge
    follows = on_edge[0] & (~has_two | on_edge[1])
    planes = jax.tree.map(lambda v: jnp.where(follows, v, lax.stop_gradient(v)), planes)
    # If all crossings are hidden, no outline is visible. The corners' depths then differ as on any slanted surface.
    in_sight = jnp.any(crossings.at < crossings.depth.size - 1, axis=(0, 1))
    return Contours(planes, inner, outer, follows, in_sight & jnp.any(used[0], axis=0))


def _pair(
    ends: Bool[Array, "4 t"], begins: Bool[Array, "4 t"], is_band: Bool[Array, " t"]
) -> tuple[Int[Array, "2 t"], Int[Array, "2 t"], Bool[Array, " t"]]:
    """The sides on which the first and the second line through each texel start and end, and whether there are two.

    A line starts where a caster `ends` and ends where one `begins`.
    """
    number = jnp.arange(4, dtype=jnp.int32)[:, None]
    first = lax.argmax(ends, 0, jnp.int32)
    start = jnp.stack([first, lax.argmax(ends & (number > first), 0, jnp.int32)])
    # The start of the caster that ends there: on the same side, or on the closest side before it.
    steps = jnp.where(begins, (start[:, None] - number) % 4, 4)
    began = lax.argmin(steps, 1, jnp.int32)
    has_two = jnp.sum(ends, axis=0) > 1
    return start, jnp.where(has_two & is_band, began[::-1], began), has_two


def _moved(points: _Points, other: _Points) -> _Points:
    """The points with their derivatives. A point that is not on an edge moves like the `other` end of its line."""
    motion = jnp.where(points.on_edge[..., None], points.motion, other.motion)
    return points._replace(place=points.place + motion)


def _left_of(points: _Points) -> HalfPlanes:
    """The half-planes to the left of the lines through the points, along their directions."""
    x, y = -points.direction[..., 1], points.direction[..., 0]
    return HalfPlanes(x, y, x * points.place[..., 0] + y * points.place[..., 1])


def _bend(start: _Points, end: _Points) -> Float[Array, " t"]:
    """Whether the first line bends within the texel: positive to the left, negative to the right, 0 if it does not.

    It bends if the edges along which it enters and leaves meet within the texel, ahead of the first point and behind
    the second.
    """
    take_first = lambda points: _Points(*(lax.stop_gradient(values[0]) for values in points))
    start, end = take_first(start), take_first(end)
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    turn, way = cross(start.direction, end.direction), end.place - start.place
    bends = jnp.abs(turn) > _MIN_TURN
    safe = jnp.where(bends, turn, 1)
    ahead, behind = cross(way, end.direction) / safe, cross(start.direction, way) / safe
    corner = start.place + ahead[:, None] * start.direction
    inside = (ahead > 0) & (behind > 0) & jnp.all(jnp.abs(corner) < 0.5, axis=1)
    return jnp.where(bends & inside, turn, 0)
