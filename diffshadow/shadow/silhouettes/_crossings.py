"""The crossings of the outline with the sides of texels."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import normalize
from ...raster import grid_crossings
from ._outline import Outline

# As a fraction of a side; several times the rasterizer's sub-pixel.
_NEAR_CORNER = 1 / 64
# Bits for the index of a crossing. With 32 for its position and one for its row, they fit into 63.
_NUMBER_BITS = 30

BOTTOM, RIGHT, TOP, LEFT = range(4)
"""The sides of a texel in order, anticlockwise from its lower left corner."""


class Grid(NamedTuple):
    """Numbers the texels of a map of this size and number of layers, and their corners."""

    layers: int
    height: int
    width: int

    @property
    def texels(self) -> int:
        return self.layers * self.height * self.width

    def texel(self, layer: Array, row: Array, column: Array) -> Array:
        return (layer * self.height + row) * self.width + column

    def corner(self, layer: Array, row: Array, column: Array) -> Array:
        return (layer * (self.height + 1) + row) * (self.width + 1) + column


class OutlineCrossings(eqx.Module):
    """The crossings of the outline with the sides of texels. Sides are directed upwards or to the right.

    - `texel`: (t,), the number of each texel with crossings; `grid.texels` means none.
    - `at`: (2, 4, t), for each side of these texels, the crossing at which a caster ends, and the crossing at which a
        caster begins, along the walk around the texel. If there are several crossings, it is the outermost; c, the
        number of crossings, means none.
    - `place`, `depth`: (c + 1,), each crossing's position along its side, in [0, 1], and its window depth.
    - `direction`: (c + 1, 2), the edge's unit direction, with the caster to its left; 0 for none.
    - `motion`: (c + 1, 2), zeros, with the derivative of the edge's point there.
    """

    texel: Int[Array, " t"]
    at: Int[Array, "2 4 t"]
    place: Float[Array, " c"]
    depth: Float[Array, " c"]
    direction: Float[Array, "c 2"]
    motion: Float[Array, "c 2"]


def find_crossings(outline: Outline, corners: Float[Array, " k"], grid: Grid, capacity: int) -> OutlineCrossings:
    """The crossings of all sides.

    **Arguments:**

    - `corners`: (k,), window depth at the corners of texels. A crossing counts only if its edge is nearer.
    """
    found = grid_crossings(*lax.stop_gradient((outline.start, outline.end)), outline.counts, capacity)
    # Without the barriers, XLA finds and gathers the ends again in each of the many kernels that use them.
    found = lax.optimization_barrier(found)
    start, end, z = outline.start[found.segment], outline.end[found.segment], outline.depth[found.segment]
    start, end, z = lax.optimization_barrier((start, end, z))
    upright = found.axis == 0
    across = lambda point: jnp.where(upright, point[:, 0], point[:, 1])
    along = lambda point: jnp.where(upright, point[:, 1], point[:, 0])
    rise = lax.stop_gradient(across(end) - across(start))
    fraction = lax.stop_gradient(found.line - across(start)) / jnp.where(rise == 0, 1, rise)
    depth = z[:, 0] + fraction * (z[:, 1] - z[:, 0])
    # The derivative belongs to the edge's point, which moves off the side. It defines the same line as the crossing.
    # The crossing's own derivative would be huge if the edge is almost parallel to the side.
    point = start + fraction[:, None] * (end - start)
    motion = point - lax.stop_gradient(point)
    position = lax.stop_gradient(along(point))
    own = jnp.floor(position).astype(jnp.int32)
    place = position - own
    on_map = (found.segment >= 0) & (found.line >= 0) & (found.line <= jnp.where(upright, grid.width, grid.height))
    line, layer = jnp.where(on_map, found.line, 0), outline.layer[found.segment]
    # The caster is to the left of an edge: above an edge that runs to the right, and to the left of an edge that runs
    # upwards.
    begins = (rise > 0) == upright

    # The rasterizer snaps vertices to a grid, so a crossing this close to a corner may belong to the next side.
    step = jnp.where(place < _NEAR_CORNER, -1, jnp.where(place > 1 - _NEAR_CORNER, 1, 0))
    number, exists = jnp.stack([own, own + step]), jnp.stack([on_map, on_map & (step != 0)])
    exists = exists & (number >= 0) & (number < jnp.where(upright, grid.height, grid.width))
    number = jnp.where(exists, number, 0)
    row, column = jnp.where(upright, number, line), jnp.where(upright, line, number)
    first = corners[grid.corner(layer, row, column)]
    last = corners[grid.corner(layer, row + jnp.where(upright, 1, 0), column + jnp.where(upright, 0, 1))]
    hides = exists & (depth < jnp.where(begins, first, last))

    # The texel above a side or to its right, followed by the texel on its other side.
    other = jnp.arange(2, dtype=jnp.int32)[:, None]
    y, x = row[:, None] - jnp.where(upright, 0, other), column[:, None] - jnp.where(upright, other, 0)
    inside = exists[:, None] & (x >= 0) & (x < grid.width) & (y >= 0) & (y < grid.height)
    beside = jnp.where(inside, grid.texel(layer, y, x), grid.texels)
    texel, own = _distinct(beside[0].reshape(-1), grid.texels)
    side = jnp.where(upright, jnp.where(other, RIGHT, LEFT), jnp.where(other, TOP, BOTTOM))

    offset = jnp.stack([place, place - step])
    direction = normalize(end - start)
    # If samples show a crossing but no edge does, the crossing is at the side's middle.
    none = jnp.zeros((1, 2), place.dtype)
    return OutlineCrossings(
        texel=texel,
        at=_outermost(jnp.where(hides[:, None], own[beside], texel.size), side, begins, offset, texel.size),
        place=jnp.concatenate([*offset, jnp.full(1, 0.5, place.dtype)]),
        depth=jnp.concatenate([depth, depth, jnp.ones(1, place.dtype)]),
        direction=jnp.concatenate([direction, direction, none]),
        motion=jnp.concatenate([motion, motion, none]),
    )


def _distinct(texel: Int[Array, " t"], texels: int) -> tuple[Int[Array, " t"], Int[Array, " n"]]:
    """The distinct texels, with `texels` for repetitions, and the index of each texel of the map among them, or t for
    other texels."""
    number = jnp.arange(texel.size, dtype=jnp.int32)
    place = jnp.full(texels + 1, texel.size, jnp.int32).at[texel].min(number).at[texels].set(texel.size)
    return jnp.where(place[texel] == number, texel, texels), place


def _outermost(
    place: Int[Array, "2 2 c"],
    side: Int[Array, "2 c"],
    begins: Bool[Array, " c"],
    offset: Float[Array, "2 c"],
    count: int,
) -> Int[Array, "2 4 t"]:
    """`OutlineCrossings.at`, from the texels at `place` on both sides of each crossing, and the side of each that it is
    on.

    A crossing lies on the first of two sides (row 0), and may belong to the other (row 1); there it counts only if no
    crossing is on it. The result is for `count` texels. The value `count` means no texel.
    """
    crossings = begins.size
    row = jnp.arange(2, dtype=jnp.int32)[:, None]
    number = jnp.arange(2 * crossings, dtype=jnp.int32).reshape(2, crossings)
    bits = lax.bitcast_convert_type(jnp.where(begins, offset, -offset).astype(jnp.float32), jnp.int32)
    # Sorted like the numbers that the bits represent.
    rank = jnp.where(bits < 0, bits ^ jnp.iinfo(jnp.int32).max, bits)
    # The walk follows the top and the left side in reverse.
    role = (begins == (side < TOP)).astype(jnp.int32)
    with jax.enable_x64(True):
        # One number combines all three, and its minimum wins: the row, the distance from the centre, and the index
        # among crossings at one position.
        not_negative = rank.astype(jnp.int64) + (1 << 31)
        key = (row.astype(jnp.int64) << (32 + _NUMBER_BITS)) | (not_negative << _NUMBER_BITS) | number
        none = jnp.iinfo(jnp.int64).max
        least = jnp.full((2, 4, count + 1), none, jnp.int64).at[role, side, place].min(key[:, None])[..., :-1]
        return jnp.where(least < none, least & ((1 << _NUMBER_BITS) - 1), 2 * crossings).astype(jnp.int32)
