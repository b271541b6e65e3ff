"""Silhouette maps: shadow maps that know where within a texel the caster ends.

Sen, Cammarano & Hanrahan ("Shadow Silhouette Maps", SIGGRAPH 2003) keep a point of the silhouette in each texel that
it passes through. Here the outline is followed as marching squares follow a contour (Lorensen & Cline 1987), but its
crossings with the sides of texels are those of the silhouette edges themselves rather than guessed from samples. So
the outline is closed, hidden folds of a mesh drop out, and hard shadows are accurate below a texel. What moves the
edges, be it the light or a vertex, moves the crossings: derivatives follow.

Two edges that meet within a texel keep their corner; of a longer chain the first and the last do, or it is cut short.
What is left out: of parts of a caster narrower than a texel, those that cross no side of one, or only one side.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._misc import normalize
from .._types import Resolution
from ..geometry import AbstractLight, Edges, Mesh
from ..raster import count_crossings, grid_crossings, light_sides, silhouettes_by_adjacency
from ._cut_rectangle import WHOLE_TEXEL, HalfPlane, Rectangle, cut_area

NO_SILHOUETTE = -1
"""What a texel without a silhouette holds in `SilhouetteMap.slot`."""
# So low an offset that a half-plane holds all of any texel.
_EVERYWHERE = -1e6
# As a share of a side; several times the rasterizer's sub-pixel.
_NEAR_CORNER = 1 / 64
# The sine of the least angle by which an outline turns within a texel.
_LEAST_TURN = 1e-3


class SilhouetteMap(eqx.Module):
    """The silhouettes in a shadow map.

    - `slot`: (h, w), or (l, h, w), where each texel's silhouette stands in the other arrays; `NO_SILHOUETTE` for none.
    - `planes`: two half-planes, (s,) each, in texels from the texel's centre. They carry the outline's derivative.
    - `inner`, `outer`: (s,), window depths where both planes hold, and elsewhere in the texel; 1 for nothing.
    - `follows`: (s,), whether the outline is that of silhouette edges, and moves as they do. Elsewhere samples alone
        tell that there is one, such as where meshes cut through each other.
    """

    slot: Int[Array, "*l h w"]
    planes: tuple[HalfPlane, HalfPlane]
    inner: Float[Array, " s"]
    outer: Float[Array, " s"]
    follows: Bool[Array, " s"]

    def mean_of(self, function: Callable[[Array], Any], depth: Float[Array, "*l h w"]) -> Any:
        """The mean over each texel of a function of depth, which gives arrays of its shape; `depth` is the map's."""
        share = self.area_within(jnp.arange(self.inner.shape[0], dtype=jnp.int32), WHOLE_TEXEL)
        blend = lambda inner, outer: outer + share * (inner - outer)
        means = jax.tree.map(blend, function(self.inner), function(self.outer))
        pick = lambda plain, mean: jnp.where(self.slot == NO_SILHOUETTE, plain, mean[jnp.maximum(self.slot, 0)])
        return jax.tree.map(pick, function(depth), means)

    def area_within(
        self,
        slot: Int[Array, "*n"],
        part: Rectangle,
        motion: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None,
    ) -> Float[Array, "*n"]:
        """The area, in square texels, of a `part` of a texel, seen from its centre, that lies in both half-planes.

        With a `motion`, half-planes that follow edges have moved by that, in texels.
        """

        at_slot = lambda values: values.at[slot].get(mode="promise_in_bounds", wrap_negative_indices=False)

        def moved(plane: HalfPlane) -> HalfPlane:
            x, y, offset = map(at_slot, plane)
            if motion is None:
                return HalfPlane(x, y, offset)
            along = x * motion[0] + y * motion[1]
            return HalfPlane(x, y, offset + jnp.where(at_slot(self.follows), along, 0))

        one, other = self.planes
        return cut_area(part, moved(one), moved(other))


class Outline(eqx.Module):
    """Silhouette edges in the window, cut to what the map shows; the caster lies to their left.

    - `start`, `end`: (n, 2), in texels; `depth`: (n, 2), at both; `layer`: (n,), of the map.
    - `counts`: (n, 2), of the sides of texels that they cross.
    """

    start: Float[Array, "n 2"]
    end: Float[Array, "n 2"]
    depth: Float[Array, "n 2"]
    layer: Int[Array, " n"]
    counts: Int[Array, "n 2"]

    @classmethod
    def of(
        cls, clip: Float[Array, "*l v 4"], mesh: Mesh, light: AbstractLight, edges: Edges, resolution: Resolution
    ) -> "Outline":
        """The silhouettes that `light` sees of a `mesh` with these `edges` and clip coordinates (v, 4)."""
        found = silhouettes_by_adjacency(edges, light_sides(mesh, light))
        ends = jnp.where((found.multiplicity >= 0)[:, None], found.vertices, found.vertices[:, ::-1])
        clip = clip.reshape(-1, *clip.shape[-2:])
        corners = clip[:, ends].reshape(-1, 2, 4)
        first, last = _shown(lax.stop_gradient(corners), resolution)
        used = jnp.tile(found.multiplicity != 0, clip.shape[0]) & (first < last)
        way = corners[:, 1] - corners[:, 0]
        cut = corners[:, :1] + jnp.stack([first, last], axis=1)[..., None] * way[:, None]
        window = cut[..., :3] / jnp.where(used[:, None, None], cut[..., 3:], 1) * 0.5 + 0.5
        height, width = resolution
        place = window[..., :2] * jnp.array([width, height], window.dtype)
        counts = count_crossings(*lax.stop_gradient((place[:, 0], place[:, 1])), used)
        layer = jnp.repeat(jnp.arange(clip.shape[0], dtype=jnp.int32), ends.shape[0])
        return cls(place[:, 0], place[:, 1], window[..., 2], layer, counts)


def _shown(corners: Float[Array, "n 2 4"], resolution: Resolution) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Which part of each edge the map and a texel round it show, as shares of its way (Liang & Barsky 1984)."""
    x, y, z, w = jnp.moveaxis(corners, -1, 0)
    x, y = x / (1 + 2 / resolution[1]), y / (1 + 2 / resolution[0])
    first, last = jnp.zeros(x.shape[0], x.dtype), jnp.ones(x.shape[0], x.dtype)
    for inside in (w + x, w - x, w + y, w - y, w + z, w - z):
        a, b = inside[:, 0], inside[:, 1]
        share = a / jnp.where(a == b, 1, a - b)
        first = jnp.where((a < 0) & (b > a), jnp.maximum(first, share), first)
        last = jnp.where((b < 0) & (a > b), jnp.minimum(last, share), last)
        last = jnp.where((a < 0) & (b < 0), first, last)
    return first, last


class _Grid(NamedTuple):
    """How texels, their corners and their sides are numbered, of a map of this size and number of layers.

    Each layer's upright sides come first, (h, w + 1), then its level ones, (h + 1, w).
    """

    layers: int
    height: int
    width: int

    @property
    def upright(self) -> int:
        return self.height * (self.width + 1)

    @property
    def sides(self) -> int:
        return self.layers * (self.upright + (self.height + 1) * self.width)

    def texel(self, layer: Array, row: Array, column: Array) -> Array:
        return (layer * self.height + row) * self.width + column

    def corner(self, layer: Array, row: Array, column: Array) -> Array:
        return (layer * (self.height + 1) + row) * (self.width + 1) + column

    def upright_side(self, layer: Array, row: Array, line: Array) -> Array:
        return layer * (self.sides // self.layers) + row * (self.width + 1) + line

    def level_side(self, layer: Array, line: Array, column: Array) -> Array:
        return layer * (self.sides // self.layers) + self.upright + line * self.width + column


class _Sides(eqx.Module):
    """Where the outline crosses the sides of texels, which run upwards or to the right.

    - `end`, `begin`: (n,), the crossing at which a caster ends that holds the side's first corner, and that at which
        one begins that holds its last; of several the outermost. The number of crossings stands for none.
    - `place`, `depth`: (c + 1,), of each crossing: how far along its side, in [0, 1], and its window depth.
    - `way`: (c + 1, 2), the edge's direction there, of unit length, with the caster to its left; 0 for none.
    - `motion`: (c + 1, 2), zeros, with the derivative of the edge's point there.
    """

    end: Int[Array, " n"]
    begin: Int[Array, " n"]
    place: Float[Array, " c"]
    depth: Float[Array, " c"]
    way: Float[Array, "c 2"]
    motion: Float[Array, "c 2"]


def find_silhouettes(
    depth: Float[Array, "*l h w"],
    corners: Float[Array, "*l H W"],
    outline: Outline,
    capacity: int,
) -> SilhouetteMap:
    """The silhouettes in a map.

    **Arguments:**

    - `depth`: (h, w), the map's; `corners`: (h + 1, w + 1), depth at the corners of its texels.
    - `capacity`: of how many crossings are looked at; compare it with `outline.counts`.
    """
    height, width = depth.shape[-2:]
    grid = _Grid(depth.size // (height * width), height, width)
    # Nothing can be read from an empty table.
    capacity = max(capacity, 1)
    sides, texel = _cross(outline, corners.reshape(-1), grid, capacity)
    planes, inner, outer, follows, crosses = _contour(
        depth.reshape(-1), corners.reshape(-1), sides, jnp.minimum(texel, depth.size - 1), grid
    )
    beside = jnp.arange(2 * capacity, dtype=jnp.int32)
    slot = jnp.full(depth.size + 1, NO_SILHOUETTE, jnp.int32).at[jnp.where(crosses, texel, depth.size)].max(beside)[:-1]
    return SilhouetteMap(slot.reshape(depth.shape), planes, inner, outer, follows)


def _cross(outline: Outline, corners: Float[Array, " k"], grid: _Grid, room: int) -> tuple[_Sides, Int[Array, " t"]]:
    """The crossings of all sides, and the texels on either side of each; one more than there are stands for none."""
    found = grid_crossings(*lax.stop_gradient((outline.start, outline.end)), outline.counts, room)
    start, end, z = outline.start[found.segment], outline.end[found.segment], outline.depth[found.segment]
    upright = found.axis == 0
    across = lambda point: jnp.where(upright, point[:, 0], point[:, 1])
    along = lambda point: jnp.where(upright, point[:, 1], point[:, 0])
    way = lax.stop_gradient(across(end) - across(start))
    share = lax.stop_gradient(found.line - across(start)) / jnp.where(way == 0, 1, way)
    edge_depth = z[:, 0] + share * (z[:, 1] - z[:, 0])
    # What is followed is the edge's point there, which leaves the side: the crossing itself would race along the side
    # if the edge runs almost along it, and a line through two points is the same wherever along it they are.
    point = start + share[:, None] * (end - start)
    motion = point - lax.stop_gradient(point)
    position = lax.stop_gradient(along(point))
    own = jnp.floor(position).astype(jnp.int32)
    place = position - own
    on_map = (found.segment >= 0) & (found.line >= 0) & (found.line <= jnp.where(upright, grid.width, grid.height))
    line, layer = jnp.where(on_map, found.line, 0), outline.layer[found.segment]
    # The caster is to the left: above an edge that runs to the right, and before one that runs upwards.
    begins = (way > 0) == upright

    def on_side(number: Int[Array, " c"], exists: Bool[Array, " c"]) -> tuple[Array, Array, Array, Array]:
        """Which of the sides along a grid line, whether that is on the map and hidden by the edge, and its texel."""
        exists = exists & (number >= 0) & (number < jnp.where(upright, grid.height, grid.width))
        number = jnp.where(exists, number, 0)
        row, column = jnp.where(upright, number, line), jnp.where(upright, line, number)
        first = corners[grid.corner(layer, row, column)]
        last = corners[grid.corner(layer, row + jnp.where(upright, 1, 0), column + jnp.where(upright, 0, 1))]
        hides = exists & (edge_depth < jnp.where(begins, first, last))
        side = jnp.where(upright, grid.upright_side(layer, row, column), grid.level_side(layer, row, column))
        return jnp.where(hides, side, grid.sides), exists, row, column

    def outermost(side: Int[Array, " c"], key: Float[Array, " c"], first: int) -> Int[Array, " n"]:
        greatest = jnp.full(grid.sides + 1, -2, key.dtype).at[side].max(key)
        wins = jnp.where(key == greatest[side], side, grid.sides)
        numbers = jnp.arange(first, first + room, dtype=jnp.int32)
        return jnp.full(grid.sides + 1, 2 * room, jnp.int32).at[wins].min(numbers)[:-1]

    # Samples are taken of vertices snapped to a grid: a crossing this near to a corner may belong to the next side.
    step = jnp.where(place < _NEAR_CORNER, -1, jnp.where(place > 1 - _NEAR_CORNER, 1, 0))
    side, exists, row, column = on_side(own, on_map)
    next_side, _, _, _ = on_side(own + step, on_map & (step != 0))
    tables = []
    for wanted, sign in ((~begins, 1), (begins, -1)):
        # Of what is not wanted, the place is that of no side.
        chosen = lambda side, wanted=wanted: jnp.where(wanted, side, grid.sides)
        here = outermost(chosen(side), sign * place, 0)
        beside = outermost(chosen(next_side), sign * (place - step), room)
        tables.append(jnp.where(here < room, here, beside))
    # Where samples say that there is a crossing and there is none, its place is the side's middle.
    way_there = normalize(end - start)
    none = jnp.zeros((1, 2), place.dtype)
    sides = _Sides(
        end=tables[0],
        begin=tables[1],
        place=jnp.concatenate([place, place - step, jnp.full(1, 0.5, place.dtype)]),
        depth=jnp.concatenate([edge_depth, edge_depth, jnp.ones(1, place.dtype)]),
        way=jnp.concatenate([way_there, way_there, none]),
        motion=jnp.concatenate([motion, motion, none]),
    )
    texels = []
    for back in (0, 1):
        y, x = row - jnp.where(upright, 0, back), column - jnp.where(upright, back, 0)
        inside = exists & (x >= 0) & (x < grid.width) & (y >= 0) & (y < grid.height)
        texels.append(jnp.where(inside, grid.texel(layer, y, x), grid.layers * grid.height * grid.width))
    return sides, jnp.concatenate(texels)


def _contour(
    depth: Float[Array, " m"], corners: Float[Array, " k"], sides: _Sides, texel: Int[Array, " t"], grid: _Grid
) -> tuple[tuple[HalfPlane, HalfPlane], Float[Array, " t"], Float[Array, " t"], Bool[Array, " t"], Bool[Array, " t"]]:
    """The lines that the outline draws through texels (t,): planes, depths in and outside, whether it follows edges,
    and whether there are any.

    Walking round a texel, anticlockwise from its lower left corner, casters begin and end. The outline runs from where
    one ends to where one begins, with the caster to its left.
    """
    layer, row, column = texel // (grid.height * grid.width), texel // grid.width % grid.height, texel % grid.width
    z = jnp.stack([corners[grid.corner(layer, row + j, column + i)] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    own = depth[texel]
    side = (
        grid.level_side(layer, row, column),
        grid.upright_side(layer, row, column + 1),
        grid.level_side(layer, row + 1, column),
        grid.upright_side(layer, row, column),
    )
    near = jnp.min(jnp.stack([sides.depth[which[s]] for s in side for which in (sides.end, sides.begin)]), axis=0)
    far = jnp.max(z, axis=0)
    threshold = lax.stop_gradient(jnp.minimum(near, far) + far) / 2
    covered = z < threshold

    ends, begins, is_end, is_begin, drawn = [], [], [], [], []
    for k in range(4):
        # The upper and the left side are walked backwards.
        forward = k < 2
        end, begin = (sides.end[side[k]], sides.begin[side[k]])[:: 1 if forward else -1]
        how_far = lambda crossing, forward=forward: sides.place[crossing] if forward else 1 - sides.place[crossing]
        exists = lambda crossing: sides.depth[crossing] < threshold
        before, after = covered[k], covered[(k + 1) % 4]
        in_order = how_far(begin) < how_far(end)
        # A caster narrower than the side, between two corners that it misses.
        bar = ~before & ~after & exists(begin) & exists(end) & in_order
        is_end.append((before & ~after) | bar)
        is_begin.append((~before & after) | bar)
        for points, crossing, used in ((ends, end, is_end[-1]), (begins, begin, is_begin[-1])):
            drawn.append(jnp.where(used & exists(crossing), sides.depth[crossing], 0))
            s = jnp.where(exists(crossing), how_far(crossing), 0.5) - 0.5
            half = jnp.full_like(s, 0.5)
            place = jnp.stack([(s, -half), (half, s), (-s, half), (-half, -s)][k], axis=-1)
            known = exists(crossing)[:, None]
            of_edge = lambda values, known=known, crossing=crossing: jnp.where(known, values[crossing], 0)
            points.append(_Point(place, of_edge(sides.way), of_edge(sides.motion)))
    stack = lambda points: jax.tree.map(lambda *each: jnp.stack(each), *points)
    is_end, is_begin, ends, begins = jnp.stack(is_end), jnp.stack(is_begin), stack(ends), stack(begins)

    number = jnp.arange(4, dtype=jnp.int32)[:, None]
    first = lax.argmax(is_end, 0, jnp.int32)
    second = lax.argmax(is_end & (number > first), 0, jnp.int32)
    # Where the caster that ends there began: on the same side, or on the last one before it.
    began = lambda k: lax.argmin(jnp.where(is_begin, (k - number) % 4, 4), 0, jnp.int32)
    at = lambda points, k: jax.tree.map(lambda v: jnp.take_along_axis(v, k[None, :, None], axis=0)[0], points)
    has_two = jnp.sum(is_end, axis=0) > 1
    # Of two casters that meet in a texel, whether they are one there; of one that misses all corners, it is.
    is_band = ~jnp.any(covered, axis=0) | (own < threshold)
    crosswise = has_two & is_band
    from_first, to_first = _together(at(ends, first), at(begins, jnp.where(crosswise, began(second), began(first))))
    from_second, to_second = _together(at(ends, second), at(begins, jnp.where(crosswise, began(first), began(second))))

    bend = jnp.where(has_two, 0, _bend(from_first, to_first))
    one = _pick(bend != 0, _beside(from_first), _between(from_first, to_first))
    two = _pick(bend != 0, _beside(to_first), _between(from_second, to_second))
    # Two casters apart, and a corner that juts in, are what lies not in both planes turned round.
    turned = (has_two & ~is_band) | (bend < 0)
    one, two = (HalfPlane(*(jnp.where(turned, -value, value) for value in plane)) for plane in (one, two))
    nothing = jnp.zeros_like(near)
    two = _pick(has_two | (bend != 0), two, HalfPlane(nothing, nothing, nothing + _EVERYWHERE))

    # A caster that misses the centre is as deep as its outline at most: with less, it would shadow itself.
    deepest = jnp.max(jnp.stack(drawn), axis=0)
    near = jnp.where(own < threshold, own, jnp.where(deepest > 0, deepest, near))
    inner, outer = jnp.where(turned, far, near), jnp.where(turned, near, far)
    followed = lambda start, end: _is_of_edge(start) | _is_of_edge(end)
    follows = followed(from_first, to_first) & (~has_two | followed(from_second, to_second))
    one, two = (jax.tree.map(lambda v: jnp.where(follows, v, lax.stop_gradient(v)), plane) for plane in (one, two))
    return (one, two), inner, outer, follows, jnp.any(is_end, axis=0)


class _Point(NamedTuple):
    """Where the outline enters or leaves texels, (n, 2) from their centres.

    Its direction there is 0 where no edge is known; `motion` is zero, with the derivative of the edge's point there.
    """

    place: Float[Array, "*k n 2"]
    way: Float[Array, "*k n 2"]
    motion: Float[Array, "*k n 2"]


def _is_of_edge(point: _Point) -> Bool[Array, " n"]:
    return jnp.any(lax.stop_gradient(point.way) != 0, axis=-1)


def _together(start: _Point, end: _Point) -> tuple[_Point, _Point]:
    """Both ends of an outline with their derivatives; one of no edge moves as the other does."""
    moved = lambda point, other: point._replace(
        place=point.place + jnp.where(_is_of_edge(point)[:, None], point.motion, other.motion)
    )
    return moved(start, end), moved(end, start)


def _beside(point: _Point) -> HalfPlane:
    """What lies to the left of the outline as it runs through a point."""
    x, y = -point.way[:, 1], point.way[:, 0]
    return HalfPlane(x, y, x * point.place[:, 0] + y * point.place[:, 1])


def _between(start: _Point, end: _Point) -> HalfPlane:
    """What lies to the left of the straight way from one point to another."""
    return _beside(start._replace(way=normalize(end.place - start.place)))


def _bend(start: _Point, end: _Point) -> Float[Array, " n"]:
    """Whether the outline turns within the texel: left, positive, or right, negative; 0 if it does not.

    It does where the lines along which it enters and leaves meet there, ahead of one point and behind the other.
    """
    start, end = lax.stop_gradient((start, end))
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    turn, way = cross(start.way, end.way), end.place - start.place
    bends = jnp.abs(turn) > _LEAST_TURN
    safe = jnp.where(bends, turn, 1)
    ahead, behind = cross(way, end.way) / safe, cross(start.way, way) / safe
    corner = start.place + ahead[:, None] * start.way
    inside = (ahead > 0) & (behind > 0) & jnp.all(jnp.abs(corner) < 0.5, axis=1)
    return jnp.where(bends & inside, turn, 0)


def _pick(condition: Bool[Array, " n"], yes: HalfPlane, no: HalfPlane) -> HalfPlane:
    return HalfPlane(*(jnp.where(condition, *pair) for pair in zip(yes, no, strict=True)))
