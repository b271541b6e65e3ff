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

from .._misc import take
from .._types import FaceMap, Resolution
from ._bins import BLOCK, LARGE, WINDOWS, Capacity, Counts, Triangles, pixel_box
from ._compact import compact, members
from ._coverage import EdgeForm, edge_form, window_depth
from ._depth_test import DepthTest
from ._fixed import Size

PADDING = max(WINDOWS)
SCATTER = lax.ScatterDimensionNumbers(
    update_window_dims=(1, 2), inserted_window_dims=(), scatter_dims_to_operand_dims=(0, 1)
)
GATHER = lax.GatherDimensionNumbers(offset_dims=(1, 2), collapsed_slice_dims=(), start_index_map=(0, 1))
IN_BOUNDS = lax.GatherScatterMode.PROMISE_IN_BOUNDS
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


class Candidates(NamedTuple):
    """The blocks that the boxes of large triangles touch, up to the capacity.

    - `blocks`: which; `hit`: (n,), whether their triangles themselves may touch them.
    - `number`: how many there are, even beyond the capacity.
    """

    blocks: Blocks
    hit: Bool[Array, " n"]
    number: Int[Array, ""]


def count(triangles: Triangles, candidates: Candidates) -> Counts:
    """How many there are of each kind; of blocks, those among the candidates within the capacity."""
    counts = triangles.ranks.counts
    blocks = jnp.sum(candidates.hit, dtype=jnp.int32)
    return Counts(triangles.clipped, counts[:LARGE], counts[LARGE], candidates.number, blocks)


class Windows(eqx.Module):
    """Every window that has to be written, those of one size together: first the size classes, then the blocks.

    - `form`: what each holds; `source`: (n,), the mesh's face that it is a part of, -1 for an empty one.
    - `used`: (k,), how many of each size are not empty; `capacities`: how many of each size fit.
    """

    form: EdgeForm
    source: Int[Array, " n"]
    used: Int[Array, " k"]
    capacities: tuple[int, ...] = eqx.field(static=True)


def set_up_windows(
    triangles: Triangles,
    candidates: Candidates,
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
    used, capacities = triangles.ranks.counts, capacity.windows
    if capacity.large and capacity.blocks:
        blocks = _kept(candidates, capacity.blocks)
        member, x, y = (jnp.concatenate(both) for both in zip((member, x, y), blocks, strict=True))
        used, capacities = (
            used.at[LARGE].set(jnp.sum(blocks.member >= 0, dtype=jnp.int32)),
            (*capacities, capacity.blocks),
        )
    # One set-up for all classes, which is far quicker to compile than one for each.
    form = edge_form(lax.optimization_barrier(triangles.corners(member)), x, y, test, polygon_offset)
    return Windows(form, jnp.where(member >= 0, take(triangles.source, member), -1), used, capacities)


def find_candidates(triangles: Triangles, resolution: Size, capacity: Capacity) -> Candidates:
    """The blocks that large triangles may touch."""
    if not capacity.large:
        none = jnp.zeros(0, jnp.int32)
        return Candidates(Blocks(none, none, none), none > 0, jnp.int32(0))
    member = members(triangles.size_class, triangles.ranks, (0,) * LARGE + (capacity.large,))
    box = pixel_box(*triangles.corners(member).snapped(), resolution)
    left, bottom = box.left // BLOCK, box.bottom // BLOCK
    columns = jnp.where(member >= 0, box.right // BLOCK - left + 1, 0)
    # Number all candidates through: number p belongs to the triangle whose run holds p.
    lengths = columns * (box.top // BLOCK - bottom + 1)
    ends = jnp.cumsum(lengths)
    starts = ends - lengths
    number = jnp.arange(capacity.candidates, dtype=jnp.int32)
    marks = jnp.zeros(capacity.candidates + 1, jnp.int32)
    marks = marks.at[jnp.where(lengths > 0, starts, capacity.candidates)].add(1, mode="drop")
    owner = jnp.maximum(jnp.cumsum(marks[:-1]) - 1, 0)
    used = number < ends[-1]
    within, across = number - take(starts, owner), jnp.maximum(take(columns, owner), 1)
    x, y = take(left, owner) + within % across, take(bottom, owner) + within // across
    blocks = Blocks(jnp.where(used, take(member, owner), -1), *(jnp.where(used, tile * BLOCK, 0) for tile in (x, y)))
    form = edge_form(triangles.corners(blocks.member), blocks.x, blocks.y, DepthTest(), None)
    # Hundreds of thousands of faces as large as the map would overflow the integer; no capacity is that large.
    too_many = jnp.sum(lengths.astype(jnp.float32)) > _MOST_BLOCKS
    return Candidates(blocks, used & ~form.misses(BLOCK), jnp.where(too_many, _MOST_BLOCKS, ends[-1]).astype(jnp.int32))


def _kept(candidates: Candidates, capacity: int) -> Blocks:
    kept = compact(candidates.hit, capacity)
    pick = lambda values, empty: jnp.where(kept >= 0, take(values, kept), empty)
    blocks = candidates.blocks
    return Blocks(pick(blocks.member, -1), pick(blocks.x, 0), pick(blocks.y, 0))


def write_depth(windows: Windows, resolution: Resolution, test: DepthTest) -> Float[Array, "h w"]:
    """The least depth at every pixel, infinite where there is none."""
    stored = lambda form, source, side: window_depth(form, source >= 0, side, test)
    return _least(windows, stored, jnp.inf, jnp.float32, resolution)


def write_depth_and_face(
    windows: Windows, resolution: Resolution, test: DepthTest, behind: FaceMap | None
) -> tuple[Float[Array, "h w"], Int[Array, "h w"]]:
    """The least depth at every pixel, and its face, -1 where there is none; faces in `behind` (h, w) are passed over.

    Of several faces at the same depth it is the first, or the last where `test` lets equal depths pass.
    """
    # The least complement is that of the greatest face.
    order = lambda face: ~face if test.compare == "less_equal" else face
    padded = None if behind is None else jnp.pad(behind, ((0, PADDING), (0, PADDING)), constant_values=-1)

    def stored(form: EdgeForm, source: Int[Array, " n"], side: int) -> Array:
        depth = window_depth(form, source >= 0, side, test)
        if padded is not None:
            passed = lax.gather(padded, corner(form), GATHER, (side, side), mode=IN_BOUNDS)
            depth = jnp.where(passed == source[:, None, None], jnp.inf, depth)
        # As it would be stored alone, whatever the compiler would fuse it with.
        depth = lax.optimization_barrier(depth)
        high = lax.bitcast_convert_type(depth, jnp.int32).astype(jnp.int64) << _FACE_BITS
        low = order(source)[:, None, None].astype(jnp.int64) & ((1 << _FACE_BITS) - 1)
        return high | low

    with jax.enable_x64(True):
        nothing = jnp.iinfo(jnp.int64).max
        key = _least(windows, stored, nothing, jnp.int64, resolution)
        depth = lax.bitcast_convert_type((key >> _FACE_BITS).astype(jnp.int32), jnp.float32)
        face = order(key.astype(jnp.int32))
    # The bits of an infinite depth, and of none at all, are those of no number below infinity.
    seen = depth < jnp.inf
    return jnp.where(seen, depth, jnp.inf), jnp.where(seen, face, -1)


def corner(form: EdgeForm) -> Int[Array, "n 2"]:
    """Row and column of each window's first pixel."""
    return jnp.stack([form.y, form.x], axis=-1)


def over_windows(
    windows: Windows,
    buffer: Int[Array, "H W"] | Float[Array, "H W"],
    write: Callable[[Array, EdgeForm, Int[Array, " n"], int, Bool[Array, " n"]], Array],
) -> Array:
    """`buffer` after all windows are written into it.

    A size is written in chunks that fit a processor's cache, and no more of them than are used. `write` is given the
    buffer, windows and their sources, their side, and which were not in the chunk before: the last begins early.
    """
    numbers, tree = jax.tree.flatten((windows.form, windows.source))
    # In one array for each type: what every number is cut out by costs more to compile than all that is done with it.
    kinds = [number.dtype for number in numbers]
    together = {
        kind: jnp.stack([number for number in numbers if number.dtype == kind]) for kind in dict.fromkeys(kinds)
    }

    def part(begin: Array, length: int) -> tuple[EdgeForm, Array]:
        rows = {kind: iter(lax.dynamic_slice_in_dim(all_, begin, length, axis=1)) for kind, all_ in together.items()}
        return jax.tree.unflatten(tree, [next(rows[kind]) for kind in kinds])

    start = 0
    for k, (side, capacity) in enumerate(zip((*WINDOWS, BLOCK), windows.capacities, strict=False)):
        chunk = min(capacity, max(_CHUNK // side**2, 1))
        if not capacity:
            continue

        def step(number: Array, buffer: Array, start=start, capacity=capacity, chunk=chunk, side=side) -> Array:
            begin = jnp.minimum(number * chunk, capacity - chunk)
            fresh = begin + jnp.arange(chunk, dtype=jnp.int32) >= number * chunk
            return write(buffer, *part(start + begin, chunk), side, fresh)

        chunks = (windows.used[k] + chunk - 1) // chunk
        buffer = lax.fori_loop(jnp.int32(0), chunks.astype(jnp.int32), step, buffer)
        start += capacity
    return buffer


def _least(
    windows: Windows,
    stored: Callable[[EdgeForm, Int[Array, " n"], int], Array],
    nothing: float | int,
    dtype: DTypeLike,
    resolution: Resolution,
) -> Array:
    """The least of what is `stored` (n, side, side) by any window at every pixel."""
    height, width = resolution
    buffer = jnp.full((height + PADDING, width + PADDING), nothing, dtype)

    def write(buffer: Array, form: EdgeForm, source: Array, side: int, _: Array) -> Array:
        return lax.scatter_min(buffer, corner(form), stored(form, source, side), SCATTER, mode=IN_BOUNDS)

    return over_windows(windows, buffer, write)[:height, :width]
