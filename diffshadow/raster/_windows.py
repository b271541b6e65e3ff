"""Writing triangles into the depth and face buffers, a window of pixels at a time.

Every triangle of a size class is evaluated in a window of that size at its own lower left corner, and a class is
written by one scatter of windows that keeps the least. No sort and no list of triangles a tile is needed. The buffers
are padded, so that a window may reach beyond the image.

Where the face is wanted too, depth and face travel together as one 64-bit number, the depth's bits above the face's:
positive floats are ordered as their bits are, so the least number is the nearest depth and, among equals, the first
face. That takes half the time of a second pass that looks for the face whose depth has settled.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from .._types import FaceMap, Resolution
from ._bins import BLOCK, LARGE, WINDOWS, Capacity, Counts, Triangles, pixel_box
from ._compact import compact, members
from ._coverage import EdgeForm, edge_form, window_depth
from ._depth_test import DepthTest

_PADDING = max(WINDOWS)
_SCATTER = lax.ScatterDimensionNumbers(
    update_window_dims=(1, 2), inserted_window_dims=(), scatter_dims_to_operand_dims=(0, 1)
)
_GATHER = lax.GatherDimensionNumbers(offset_dims=(1, 2), collapsed_slice_dims=(), start_index_map=(0, 1))
_IN_BOUNDS = lax.GatherScatterMode.PROMISE_IN_BOUNDS
_FACE_BITS = 32
# Pixels that are evaluated at once.
_CHUNK = 1 << 17
# More blocks than any capacity holds.
_MOST_BLOCKS = 1 << 30


class Blocks(NamedTuple):
    """Blocks of large triangles: each one's triangle (-1 for none) and lower left pixel."""

    member: Int[Array, " n"]
    x: Int[Array, " n"]
    y: Int[Array, " n"]


def count(triangles: Triangles, resolution: Resolution, capacity: Capacity) -> Counts:
    """How many there are of each kind; of blocks, as many as `capacity` has room to look at."""
    candidates = blocks = jnp.int32(0)
    if capacity.large:
        _, tiles = _large(triangles, resolution, capacity)
        touched = tiles.columns * tiles.rows
        # Hundreds of thousands of faces as large as the map would wrap the integer round; none has room for that many.
        too_many = jnp.sum(touched.astype(jnp.float32)) > _MOST_BLOCKS
        candidates = jnp.where(too_many, _MOST_BLOCKS, jnp.sum(touched, dtype=jnp.int32))
    if capacity.large and capacity.candidates:
        _, hit = _hit_blocks(triangles, resolution, capacity)
        blocks = jnp.sum(hit)
    counts = triangles.ranks.counts
    return Counts(triangles.clipped, counts[:LARGE], counts[LARGE], candidates, blocks)


class Windows(eqx.Module):
    """Every window that has to be written, those of one size together: first the size classes, then the blocks.

    - `form`: what each holds; `source`: (n,), the mesh's face that it is a part of, -1 for an empty one.
    - `used`: (k,), how many of each size are not empty; `rooms`: how many there is room for.
    """

    form: EdgeForm
    source: Int[Array, " n"]
    used: Int[Array, " k"]
    rooms: tuple[int, ...] = eqx.field(static=True)


def windows(
    triangles: Triangles,
    resolution: Resolution,
    capacity: Capacity,
    test: DepthTest,
    polygon_offset: Float[Array, "2"] | None,
) -> Windows:
    """All triangles that draw something, ready to be written."""
    member = members(triangles.size_class, triangles.ranks, capacity.windows)
    corners = triangles.corners(member)
    box = pixel_box(*corners.snapped(), resolution)
    x, y = (jnp.where(member >= 0, low, 0) for low in (box.left, box.bottom))
    used, rooms = triangles.ranks.counts, capacity.windows
    if capacity.large and capacity.blocks:
        blocks = _kept_blocks(triangles, resolution, capacity)
        member, x, y = (jnp.concatenate(both) for both in zip((member, x, y), blocks, strict=True))
        used, rooms = used.at[LARGE].set(jnp.sum(blocks.member >= 0, dtype=jnp.int32)), (*rooms, capacity.blocks)
    # One set-up for all classes, which is far quicker to compile than one for each.
    form = edge_form(triangles.corners(member), x, y, test, polygon_offset)
    return Windows(form, jnp.where(member >= 0, triangles.source[member], -1), used, rooms)


class Tiles(NamedTuple):
    """The blocks that boxes touch: the first one's column and row in the grid of blocks, and how many; each (n,)."""

    left: Int[Array, " n"]
    bottom: Int[Array, " n"]
    columns: Int[Array, " n"]
    rows: Int[Array, " n"]


def _large(triangles: Triangles, resolution: Resolution, capacity: Capacity) -> tuple[Int[Array, " large"], Tiles]:
    """The large triangles, -1 for none, and the blocks that their boxes touch."""
    member = members(triangles.size_class, triangles.ranks, (0,) * LARGE + (capacity.large,))
    box = pixel_box(*triangles.corners(member).snapped(), resolution)
    left, bottom = box.left // BLOCK, box.bottom // BLOCK
    columns = jnp.where(member >= 0, box.right // BLOCK - left + 1, 0)
    return member, Tiles(left, bottom, columns, box.top // BLOCK - bottom + 1)


def _hit_blocks(
    triangles: Triangles, resolution: Resolution, capacity: Capacity
) -> tuple[Blocks, Bool[Array, " candidates"]]:
    """The blocks that the boxes of large triangles touch, and whether the triangles themselves may touch them."""
    member, tiles = _large(triangles, resolution, capacity)
    # Number all candidates through: number p belongs to the triangle whose run holds p.
    lengths = tiles.columns * tiles.rows
    ends = jnp.cumsum(lengths)
    starts = ends - lengths
    number = jnp.arange(capacity.candidates, dtype=jnp.int32)
    marks = jnp.zeros(capacity.candidates + 1, jnp.int32)
    marks = marks.at[jnp.where(lengths > 0, starts, capacity.candidates)].add(1, mode="drop")
    owner = jnp.maximum(jnp.cumsum(marks[:-1]) - 1, 0)
    used = number < ends[-1]
    within, columns = number - starts[owner], jnp.maximum(tiles.columns[owner], 1)
    x, y = tiles.left[owner] + within % columns, tiles.bottom[owner] + within // columns
    blocks = Blocks(jnp.where(used, member[owner], -1), *(jnp.where(used, tile * BLOCK, 0) for tile in (x, y)))
    form = edge_form(triangles.corners(blocks.member), blocks.x, blocks.y, DepthTest(), None)
    return blocks, used & ~form.misses(BLOCK)


def _kept_blocks(triangles: Triangles, resolution: Resolution, capacity: Capacity) -> Blocks:
    blocks, hit = _hit_blocks(triangles, resolution, capacity)
    kept = compact(hit, capacity.blocks)
    member, x, y = (jnp.where(kept >= 0, values[kept], empty) for values, empty in zip(blocks, (-1, 0, 0), strict=True))
    return Blocks(member, x, y)


def write_depth(windows: Windows, resolution: Resolution, test: DepthTest) -> Float[Array, "h w"]:
    """The least depth at every pixel, infinite where there is none."""
    stored = lambda form, source, side: window_depth(form, source >= 0, side, test)
    return _write(windows, stored, jnp.inf, jnp.float32, resolution)


def write_depth_and_face(
    windows: Windows, resolution: Resolution, test: DepthTest, behind: FaceMap | None
) -> tuple[Float[Array, "h w"], Int[Array, "h w"]]:
    """The least depth at every pixel, and its face, -1 where there is none; faces in `behind` (h, w) are passed over.

    Of several faces at the same depth it is the first, or the last where `test` lets equal depths pass.
    """
    # The least complement is that of the greatest face.
    order = lambda face: ~face if test.compare == "less_equal" else face
    padded = None if behind is None else jnp.pad(behind, ((0, _PADDING), (0, _PADDING)), constant_values=-1)

    def stored(form: EdgeForm, source: Int[Array, " n"], side: int) -> Array:
        depth = window_depth(form, source >= 0, side, test)
        if padded is not None:
            passed = lax.gather(padded, _corner(form), _GATHER, (side, side), mode=_IN_BOUNDS)
            depth = jnp.where(passed == source[:, None, None], jnp.inf, depth)
        # As it would be stored alone, whatever the compiler would fuse it with.
        depth = lax.optimization_barrier(depth)
        high = lax.bitcast_convert_type(depth, jnp.int32).astype(jnp.int64) << _FACE_BITS
        low = order(source)[:, None, None].astype(jnp.int64) & ((1 << _FACE_BITS) - 1)
        return high | low

    with jax.enable_x64(True):
        nothing = jnp.iinfo(jnp.int64).max
        key = _write(windows, stored, nothing, jnp.int64, resolution)
        depth = lax.bitcast_convert_type((key >> _FACE_BITS).astype(jnp.int32), jnp.float32)
        face = order(key.astype(jnp.int32))
    # The bits of an infinite depth, and of none at all, are those of no number below infinity.
    seen = depth < jnp.inf
    return jnp.where(seen, depth, jnp.inf), jnp.where(seen, face, -1)


def _corner(form: EdgeForm) -> Int[Array, "n 2"]:
    return jnp.stack([form.y, form.x], axis=-1)


def _write(
    windows: Windows,
    stored: Callable[[EdgeForm, Int[Array, " n"], int], Array],
    nothing: float | int,
    dtype: DTypeLike,
    resolution: Resolution,
) -> Array:
    """The least of what is `stored` (n, side, side) by any window at every pixel.

    A size is written in chunks that fit a processor's cache, and no more of them than are used.
    """
    height, width = resolution
    buffer = jnp.full((height + _PADDING, width + _PADDING), nothing, dtype)
    start = 0
    for k, (side, room) in enumerate(zip((*WINDOWS, BLOCK), windows.rooms, strict=False)):
        chunk = min(room, max(_CHUNK // side**2, 1))
        if not room:
            continue
        own = jax.tree.map(
            lambda values, start=start, room=room: values[..., start : start + room], (windows.form, windows.source)
        )

        def write(number: Array, buffer: Array, own=own, chunk=chunk, side=side) -> Array:
            # The last chunk may begin early and write some windows again, which changes nothing.
            part = lambda values: lax.dynamic_slice_in_dim(values, number * chunk, chunk, axis=values.ndim - 1)
            form, source = jax.tree.map(part, own)
            return lax.scatter_min(buffer, _corner(form), stored(form, source, side), _SCATTER, mode=_IN_BOUNDS)

        chunks = (windows.used[k] + chunk - 1) // chunk
        buffer = lax.fori_loop(jnp.int32(0), chunks.astype(jnp.int32), write, buffer)
        start += room
    return buffer[:height, :width]
