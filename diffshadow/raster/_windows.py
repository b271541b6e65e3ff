"""Writing triangles into the depth and face buffers, a window of pixels at a time.

Every triangle of a size class is evaluated in a window of that size at its own lower left corner, and a class is
written by one scatter of windows that keeps the least depth. No sort and no list of triangles a tile is needed. The
buffers are padded, so that a window may reach beyond the image.
"""

from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._types import FaceMap, Resolution
from ._bins import BLOCK, WINDOWS, Capacity, Triangles
from ._coverage import edge_form, window_depth
from ._depth_test import DepthTest

NOTHING = jnp.iinfo(jnp.int32).max
"""What a face buffer holds where nothing has been drawn."""

_PADDING = max(WINDOWS)
_SCATTER = lax.ScatterDimensionNumbers(
    update_window_dims=(1, 2), inserted_window_dims=(), scatter_dims_to_operand_dims=(0, 1)
)
_GATHER = lax.GatherDimensionNumbers(offset_dims=(1, 2), collapsed_slice_dims=(), start_index_map=(0, 1))
_IN_BOUNDS = lax.GatherScatterMode.PROMISE_IN_BOUNDS


class Batch(NamedTuple):
    """Windows of one size: `corner` (n, 2), row and column of their lower left pixels; `depth` (n, s, s), what is to
    be stored there, infinite for nothing; `source` (n,), the face."""

    corner: Int[Array, "n 2"]
    depth: Float[Array, "n s s"]
    source: Int[Array, " n"]


def window_batches(
    triangles: Triangles,
    resolution: Resolution,
    capacity: Capacity,
    test: DepthTest,
    polygon_offset: Float[Array, "2"] | None,
    behind: FaceMap | None,
) -> list[Batch]:
    """All triangles, evaluated, in batches of equal windows."""
    placed = [_at_corner(triangles, k, room, resolution) for k, room in enumerate(capacity.windows)]
    placed.append(_in_blocks(triangles, capacity, resolution))
    # One set-up for all classes, which is far quicker to compile than one for each.
    member, pixel = (jnp.concatenate(part) for part in zip(*placed, strict=True))
    used = member >= 0
    window = triangles.window[triangles.faces[member]]
    form = edge_form(window, pixel, test, polygon_offset)
    source = triangles.source[member]

    batches, start = [], 0
    for side, (own, _) in zip((*WINDOWS, BLOCK), placed, strict=True):
        if own.shape[0]:
            part = slice(start, start + own.shape[0])
            depth = window_depth(jax.tree.map(itemgetter(part), form), used[part], side, test)
            batches.append(Batch(pixel[part, ::-1], depth, source[part]))
            start += own.shape[0]
    if behind is not None:
        padded = _padded(behind)
        batches = [_passing_over(batch, padded) for batch in batches]
    return batches


Placed = tuple[Int[Array, " n"], Int[Array, "n 2"]]
"""Triangles, -1 for none, and the lower left pixel (x, y) of each one's window."""


def _at_corner(triangles: Triangles, size_class: int, room: int, resolution: Resolution) -> Placed:
    """The triangles of a size class, each with a window at the corner of its box."""
    member = triangles.members(size_class, room)
    low, _ = triangles.boxes(member, resolution)
    return member, jnp.where((member >= 0)[:, None], low, 0)


def _in_blocks(triangles: Triangles, capacity: Capacity, resolution: Resolution) -> Placed:
    """Large triangles, once for every block that its box touches."""
    if not (capacity.large and capacity.blocks):
        return jnp.zeros(0, jnp.int32), jnp.zeros((0, 2), jnp.int32)
    member = triangles.members(len(WINDOWS), capacity.large)
    # Number the blocks of all large triangles through: block p belongs to the triangle whose run holds p.
    lengths = jnp.where(member >= 0, triangles.blocks[member], 0)
    starts = jnp.cumsum(lengths) - lengths
    marks = jnp.zeros(capacity.blocks, jnp.int32).at[jnp.where(lengths > 0, starts, capacity.blocks)]
    owner = jnp.cumsum(marks.add(1, mode="drop")) - 1
    block = jnp.arange(capacity.blocks, dtype=jnp.int32)
    used = block < jnp.sum(lengths)

    low, high = triangles.boxes(member, resolution)
    first = low // BLOCK
    columns = (high // BLOCK - first + 1)[:, 0]
    within = block - starts[owner]
    tile = first[owner] + jnp.stack([within % columns[owner], within // columns[owner]], axis=-1)
    return jnp.where(used, member[owner], -1), jnp.where(used[:, None], tile * BLOCK, 0)


def write_depth(batches: list[Batch], resolution: Resolution) -> Float[Array, "hp wp"]:
    """The least depth at every pixel of the padded image, infinite where there is none."""
    height, width = resolution
    depth = jnp.full((height + _PADDING, width + _PADDING), jnp.inf, jnp.float32)
    for batch in batches:
        depth = lax.scatter_min(depth, batch.corner, batch.depth, _SCATTER, mode=_IN_BOUNDS)
    return depth


def write_face(
    batches: list[Batch], depth: Float[Array, "hp wp"], resolution: Resolution, *, last: bool
) -> Int[Array, "hp wp"]:
    """The face whose depth has settled at every pixel of the padded image; of several the first, or the `last`."""
    height, width = resolution
    sign = -1 if last else 1
    face = jnp.full((height + _PADDING, width + _PADDING), NOTHING, jnp.int32)
    for batch in batches:
        settled = _windows_of(depth, batch)
        won = (batch.depth == settled) & (batch.depth < jnp.inf)
        key = jnp.where(won, sign * batch.source[:, None, None], NOTHING)
        face = lax.scatter_min(face, batch.corner, key, _SCATTER, mode=_IN_BOUNDS)
    return face if not last else jnp.where(face == NOTHING, NOTHING, -face)


def _passing_over(batch: Batch, behind: Int[Array, "hp wp"]) -> Batch:
    passed = _windows_of(behind, batch) == batch.source[:, None, None]
    return Batch(batch.corner, jnp.where(passed, jnp.inf, batch.depth), batch.source)


def _windows_of(buffer: Array, batch: Batch) -> Array:
    return lax.gather(buffer, batch.corner, _GATHER, batch.depth.shape[1:], mode=_IN_BOUNDS)


def _padded(face: FaceMap) -> Int[Array, "hp wp"]:
    return jnp.pad(face, ((0, _PADDING), (0, _PADDING)), constant_values=NOTHING)
