"""Lines of a picture along which its colours jump: edges of meshes in the window, cut at the sides of pixels.

A colour jumps along silhouettes, where one surface hides another, and along creases, where the normal or the albedo
jumps between two faces that are both seen. Where two meshes cross each other, there is no edge; `_plane_crossings.py`
finds these lines.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import safe_divide, take
from .._types import ClipVertices, Faces, HostArray, Resolution
from ..geometry import NO_NEIGHBOUR, Edges, Mesh, share_vertices
from ..settings.maps import Cull
from ._bins import FACING
from ._items import Items
from ._plane_crossings import PlaneCrossings
from ._segments import Segments
from ._silhouettes import silhouettes_by_adjacency

# Normals, colours and texture coordinates that differ by more make a crease.
_SAME = 1e-3
# Two grid lines that a segment crosses within this many pixels are crossed in a fixed order.
_TIE = 1e-4
# Of the pieces in one pixel, so many on either side in their list are tested for crossings.
_NEIGHBOURS = 3
# One of so many pieces may be cut by another.
_CUT = 4


class Boundaries(eqx.Module):
    """Edges along which colours may jump, in the window.

    - `segments`: directed, (n,) each.
    - `left`: (n, 2), the one or two faces to the left; `NO_NEIGHBOUR` for none.
    - `right`: (n,), the face to the right of a crease or crossing; `NO_NEIGHBOUR` at a silhouette, whose right side is
        whatever lies behind.
    - `crosses`: (n,), whether meshes cross each other there.
    """

    segments: Segments
    left: Int[Array, "n 2"]
    right: Int[Array, " n"]
    crosses: Bool[Array, " n"]

    @classmethod
    def of(
        cls, clip: ClipVertices, faces: Faces, edges: Edges, creases: Bool[Array, " n"], cull: Cull, shape: Resolution
    ) -> "Boundaries":
        """The boundaries in a view of a mesh with these `edges` (n,), given which of them are `creases`."""
        side = _sides(lax.stop_gradient(clip), faces, cull)
        found = silhouettes_by_adjacency(edges, side)
        paired = edges.faces[:, 1] != NO_NEIGHBOUR
        of_edge = jnp.where(paired[:, None] | np.array([True, False]), take(side, edges.faces), 0)
        is_silhouette = found.multiplicity != 0
        is_crease = creases & ~is_silhouette & (of_edge[:, 0] != 0) & (of_edge[:, 1] != 0)
        # The first face, or the two faces, then lie to the left.
        turned = jnp.where(is_silhouette, found.multiplicity, of_edge[:, 0]) < 0
        ends = jnp.where(turned[:, None], edges.vertices[:, ::-1], edges.vertices)
        seen = jnp.where(of_edge != 0, edges.faces, NO_NEIGHBOUR)
        only_first = jnp.where(np.array([True, False]), seen, NO_NEIGHBOUR)
        return cls(
            Segments.of(clip[ends], is_silhouette | is_crease, shape),
            left=jnp.where(is_crease[:, None], only_first, seen),
            right=jnp.where(is_crease, seen[:, 1], NO_NEIGHBOUR),
            crosses=jnp.zeros(ends.shape[0], bool),
        )

    def with_crossings(self, found: PlaneCrossings) -> "Boundaries":
        """With lines in which meshes cross, each within one pixel."""
        count = found.used.shape[0]
        segments = Segments(
            found.start,
            found.end,
            jnp.stack([found.depth] * 2, axis=1),
            found.used,
            jnp.zeros((count, 2), jnp.int32),
        )
        none = jnp.full(count, NO_NEIGHBOUR, jnp.int32)
        more = Boundaries(segments, jnp.stack([found.left, none], axis=1), found.right, jnp.ones(count, bool))
        return jax.tree.map(lambda *parts: jnp.concatenate(parts), self, more)

    @property
    def count(self) -> Int[Array, ""]:
        """How many pieces the sides of pixels cut the segments into."""
        return jnp.sum(self.segments.counts) + jnp.sum(self.segments.used)


def _sides(clip: ClipVertices, faces: Faces, cull: Cull) -> Int[Array, " f"]:
    """+1 for faces that are anticlockwise in the window, -1 for others; 0 if one is edge-on or is not drawn."""
    x, y, _, w = ([take(clip[:, k], faces[:, corner]) for corner in range(3)] for k in range(4))
    # A corner behind the eye has a negative w, and this determinant the right sign nonetheless.
    area = w[0] * (x[1] * y[2] - x[2] * y[1]) + w[1] * (x[2] * y[0] - x[0] * y[2]) + w[2] * (x[0] * y[1] - x[1] * y[0])
    front, back = FACING[cull]
    side = jnp.sign(area).astype(jnp.int32)
    return jnp.where(side > 0, side * front, side * back)


class Pieces(eqx.Module):
    """Parts of segments that lie in one pixel each, (n,) in all.

    - `pixel`: (n,), row · width + column; the number of pixels for none. `segment`: (n,), whose part it is.
    - `middle`: (n, 2), its middle, and `nearest`: (n, 2), its point closest to the pixel's centre, in pixels of the
        window. Only the latter has a derivative.
    - `right`: (n, 2), the unit normal to its right.
    - `height`: (n,), how far to its left the pixel's centre lies, in pixels.
    - `beyond`: (n,), the area, in square pixels, that it hides from the pixel's centre within the pixel; negative if
        the centre lies to its right.
    - `wall`: (n, 3), the line x · p_x + y · p_y + c = 0 of another piece that ends this one; zeros for none.
    - `hidden`: (n,), whether another piece's surface is known to hide it.
    - `is_whole`: whether there is memory for both parts of all that another piece ends.
    """

    pixel: Int[Array, " n"]
    segment: Int[Array, " n"]
    middle: Float[Array, "n 2"]
    nearest: Float[Array, "n 2"]
    right: Float[Array, "n 2"]
    height: Float[Array, " n"]
    beyond: Float[Array, " n"]
    wall: Float[Array, "n 3"]
    hidden: Bool[Array, " n"]
    is_whole: Bool[Array, ""]

    @classmethod
    def of(cls, found: Boundaries, shape: Resolution, capacity: int, adjoining: Float[Array, " m"]) -> "Pieces":
        """The pieces of boundaries, as many as `capacity` and some more, in an image of `shape`.

        Seen from its centre, a pixel has one colour up to the first piece in each direction, another one up to the
        next, and so on. Let a piece from a to b, counted from the centre, have the colours l to its left and r to its
        right. It adds (r - l) · B to the pixel's mean, with

            B = w / 4 - (a x b) / 2

        where w is how far the direction from the centre to the piece goes round the border of the pixel, which has
        length 4 and area 1. The first term is the area of the sector between the directions to a and b, the second
        that of the triangle between the centre and the piece. So the mean is exact for any number of boundaries of
        parts of one colour each. B jumps by 1 where the piece passes the centre, as the centre's colour then does.

        Reynolds' transport theorem gives the derivative: the area to the right shrinks by the piece's length times
        the speed of its middle to the right.

        **Arguments:** `adjoining`: (m,), for each segment how much deeper a surface must be to lie behind its own.
        """
        segments = found.segments
        start, end = lax.stop_gradient((segments.start, segments.end))
        whole = jnp.concatenate([segments.used[:, None].astype(jnp.int32), segments.counts], axis=1)
        owner, number, exists = Items.of(whole.reshape(-1)).chunk(0, max(capacity, 1))
        segment, kind = owner // 3, owner % 3
        first, last = _between_lines(take(start, segment), take(end, segment), kind, number)
        at = lambda fraction: take(start, segment) + fraction[:, None] * take(end - start, segment)
        cell = jnp.floor(at((first + last) / 2)).astype(jnp.int32)
        height, width = shape
        exists = exists & jnp.all((cell >= 0) & (cell < np.array([width, height])), axis=1) & (last > first)
        pixel = jnp.where(exists, cell[:, 1] * width + cell[:, 0], height * width)
        z = lax.stop_gradient(take(segments.depth, segment))
        depth = lambda fraction: z[:, 0] + fraction * (z[:, 1] - z[:, 0])
        ends = jnp.stack([at(first), at(last)], axis=1), jnp.stack([depth(first), depth(last)], axis=1)
        cut, wall, is_hidden = _junctions(pixel, height * width, *ends, take(adjoining, segment))
        # Those that are cut have a second part.
        is_cut = cut < 1
        cuts = Items.of(is_cut.astype(jnp.int32))
        again, _, _ = cuts.chunk(0, max(capacity // _CUT, 1))
        both = lambda values: jnp.concatenate([values, values[again]])
        number = jnp.arange(capacity + again.size)
        is_second = number >= capacity
        first, last, cut, segment, pixel, wall, is_hidden = map(
            both, (first, last, cut, segment, pixel, wall, is_hidden)
        )
        part = first + cut * (last - first)
        first, last = jnp.where(is_second, part, first), jnp.where(is_second | (cut >= 1), last, part)
        pixel = jnp.where(number >= capacity + cuts.total, height * width, pixel)

        exists = pixel < height * width
        start, end = take(start, segment), take(end, segment)
        along = end - start
        at = lambda fraction: start + fraction[:, None] * along
        centre = jnp.stack([pixel % width, pixel // width], axis=1) + 0.5
        a, b = (jnp.clip(at(fraction) - centre, -0.5, 0.5) for fraction in (first, last))
        step = b - a
        squared = jnp.sum(step * step, axis=1)
        closest = jnp.clip(safe_divide(-jnp.sum(a * step, axis=1), squared), 0, 1)
        length = jnp.sqrt(squared)
        right = safe_divide(step, jnp.broadcast_to(length[:, None], step.shape))[:, ::-1] * np.array([1, -1])

        def moving(fraction: Float[Array, " n"]) -> Float[Array, "n 2"]:
            """The point of the segment after this fraction of its length, with its derivative."""
            start, end = take(segments.start, segment), take(segments.end, segment)
            return start + fraction[:, None] * (end - start)

        middle = at((first + last) / 2)
        moved = moving((first + last) / 2)
        speed = jnp.sum(right * (moved - lax.stop_gradient(moved)), axis=1)
        beyond = jnp.where(exists, _beyond(a, b), 0)
        return cls(
            pixel=pixel,
            segment=segment,
            middle=middle,
            nearest=moving(first + closest * (last - first)),
            right=right,
            height=jnp.sum(right * (middle - centre), axis=1),
            beyond=beyond - jnp.where(exists, length * speed, 0),
            wall=wall,
            # The part of a cut piece that begins or ends on the left of its wall is behind that wall's surface.
            hidden=is_hidden & (jnp.sum(wall[:, :2] * middle, axis=1) + wall[:, 2] < 0),
            is_whole=cuts.total <= again.size,
        )


def _junctions(
    pixel: Int[Array, " n"],
    none: int,
    place: Float[Array, "n 2 2"],
    depth: Float[Array, "n 2"],
    adjoining: Float[Array, " n"],
) -> tuple[Float[Array, " n"], Float[Array, "n 3"], Bool[Array, " n"]]:
    """Where a piece crosses another one in its pixel that lies at another depth.

    **Returns:** the fraction of the piece's length at which it does, 1 for nowhere; the other's line, negative to its
    left; and whether the other is the nearer one.
    """
    # Sorted by pixel, neighbours in the list are those a few places before and behind.
    order = jnp.argsort(pixel, stable=True)
    along, deeper = place[:, 1] - place[:, 0], depth[:, 1] - depth[:, 0]
    columns = pixel, *place[:, 0].T, *along.T, depth[:, 0], deeper, adjoining
    own = _InPixel(*(take(column, order) for column in columns))
    padded = jax.tree.map(lambda column: jnp.pad(column, _NEIGHBOURS, constant_values=none), own)

    def with_neighbour(k: Int[Array, ""], state: Any) -> Any:
        """Looks at the neighbour of each piece that is `k` places before or behind it."""
        first = _NEIGHBOURS + jnp.where(k % 2 == 0, 1, -1) * (k // 2 + 1)
        other = jax.tree.map(lambda column: lax.dynamic_slice_in_dim(column, first, pixel.size), padded)
        gap_x, gap_y = other.x - own.x, other.y - own.y
        turn = own.along_x * other.along_y - own.along_y * other.along_x
        here = safe_divide(gap_x * other.along_y - gap_y * other.along_x, turn)
        there = safe_divide(gap_x * own.along_y - gap_y * own.along_x, turn)
        crosses = (other.pixel == own.pixel) & (own.pixel < none) & (turn != 0)
        crosses = crosses & (here > 0) & (here < 1) & (there > 0) & (there < 1)
        behind = own.z + here * own.deeper - (other.z + there * other.deeper)
        counts = crosses & (jnp.abs(behind) > jnp.maximum(own.adjoining, other.adjoining)) & (state[0] >= 1)
        line = other.along_y, -other.along_x, other.along_x * other.y - other.along_y * other.x
        return tuple(jnp.where(counts, *each) for each in zip((here, *line, behind > 0), state, strict=True))

    zero = jnp.zeros(pixel.size)
    found = lax.fori_loop(0, 2 * _NEIGHBOURS, with_neighbour, (zero + 1, zero, zero, zero, zero > 0))
    back = jnp.zeros_like(order).at[order].set(jnp.arange(order.size, dtype=order.dtype), unique_indices=True)
    cut, *line, is_behind = (take(column, back) for column in found)
    return cut, jnp.stack(line, axis=1), is_behind


class _InPixel(NamedTuple):
    """Pieces (n,): their pixels, where they start, how they go on from there, the depths of their starts, how much
    deeper they end, and how much deeper what adjoins them may be."""

    pixel: Int[Array, " n"]
    x: Float[Array, " n"]
    y: Float[Array, " n"]
    along_x: Float[Array, " n"]
    along_y: Float[Array, " n"]
    z: Float[Array, " n"]
    deeper: Float[Array, " n"]
    adjoining: Float[Array, " n"]


def _between_lines(
    start: Float[Array, "n 2"], end: Float[Array, "n 2"], kind: Int[Array, " n"], number: Int[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """From which to which fraction of its segment each piece reaches.

    A piece begins at the segment's start (`kind` 0), or at a vertical (1) or horizontal (2) line of the grid, of which
    it is the `number`-th from the lower end, as `count_crossings` counts them. It ends at the next line. Of two lines
    that are crossed at one place, the vertical one counts as the first.
    """
    along = end - start
    forwards = along > 0
    axis = kind - 1
    own = (jnp.arange(2, dtype=jnp.int32) == axis[:, None]) & (kind > 0)[:, None]
    line = jnp.floor(jnp.minimum(start, end)) + 1 + number[:, None]
    first = jnp.max(jnp.where(own, safe_divide(line - start, along), 0), axis=1)
    at = start + first[:, None] * along
    # At a vertical line, a horizontal one at the same place is still to come; at a horizontal line, it is past.
    tie = jnp.where(kind == 1, -_TIE, jnp.where(kind == 2, _TIE, 0))[:, None]
    above = jnp.where(forwards, jnp.floor(at + tie) + 1, jnp.ceil(at - tie) - 1)
    # A segment that starts on a line and runs downwards crosses it at once.
    above = jnp.where((kind == 0)[:, None] & ~forwards, jnp.floor(at), above)
    following = jnp.where(own, line + jnp.where(forwards, 1, -1), above)
    last = jnp.min(jnp.where(along != 0, safe_divide(following - start, along), 1), axis=1)
    return first, jnp.clip(last, first, 1)


def _beyond(a: Float[Array, "n 2"], b: Float[Array, "n 2"]) -> Float[Array, " n"]:
    """The area that a piece from `a` to `b` hides from the pixel's centre, which is the origin; see `Pieces.of`."""
    turn = _round_border(b) - _round_border(a)
    turn = jnp.where(turn > 2, turn - 4, jnp.where(turn < -2, turn + 4, turn))
    return turn / 4 - (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def _round_border(point: Float[Array, "n 2"]) -> Float[Array, " n"]:
    """How far round the border of the unit square the direction to `point` goes, anticlockwise from the lower right
    corner: 0 to 4."""
    x, y = point[:, 0], point[:, 1]
    across = jnp.abs(x) >= jnp.abs(y)
    on_border = lambda minor, major: 0.5 + 0.5 * safe_divide(minor, major)
    # The four sides: right, upper, left, lower.
    level = jnp.where(x > 0, on_border(y, x), 2 + on_border(-y, -x))
    upright = jnp.where(y > 0, 1 + on_border(-x, y), 3 + on_border(x, -y))
    return jnp.where(across, level, upright)


def find_creases(mesh: Mesh, edges: Edges) -> Bool[HostArray, " n"]:
    """Which of its `edges` are creases: the shading normal, albedo or corners' colours of their two faces differ there,
    or the faces have other textures or texture coordinates.

    Coordinates that differ by whole repetitions of an image are the same. A seam whose texels are alike on both sides
    counts as a crease, which does no harm: its two colours are equal.
    """
    shared, albedo = share_vertices(mesh), np.asarray(mesh.albedo)
    vertices, faces = np.asarray(edges.vertices), np.asarray(edges.faces)
    corners = [np.stack([np.argmax(shared[face] == end[:, None], axis=1) for face in faces.T]) for end in vertices.T]
    # By end of the edge, how much the values of the two faces' corners differ.
    differences = lambda values: [np.subtract(*np.asarray(values)[faces.T, corner]) for corner in corners]
    far = lambda difference: np.abs(difference).max(axis=1) > _SAME
    differs = far(albedo[faces[:, 0]] - albedo[faces[:, 1]])
    for values in (mesh.corner_normals, mesh.corner_colours):
        if values is not None:
            first, second = differences(values)
            differs |= far(first) | far(second)
    if mesh.textures is not None:
        index, samplers = np.asarray(mesh.textures.index)[faces], mesh.textures.samplers
        first, second = differences(mesh.textures.uv)
        repeats = True if samplers is None else (np.asarray(samplers)[np.maximum(index[:, 0], 0), :2] == 0)
        whole = np.where(repeats, np.round(first), 0)
        is_seam = far(first - whole) | far(second - whole)
        differs |= (index[:, 0] != index[:, 1]) | (is_seam & (index[:, 0] >= 0))
    return differs & (faces[:, 1] != NO_NEIGHBOUR)
