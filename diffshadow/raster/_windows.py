"""Writing triangles into the depth and face buffers, a window of pixels at a time.

Every triangle of a size class is evaluated in a window of that size at its own lower left corner. Windows are set up in
chunks. On a GPU, a scatter writes a whole chunk and keeps the least value. On a CPU, most windows are written one after
the other, so that each stays in registers. There is no sort, and no list of triangles for each tile. The buffers are
padded, so that a window may reach beyond the image. Large images are drawn in bands on a CPU (`_band_pass.py`).

All loops run as often as the triangles need. Only the number of faces and the resolution are static: a compiled program
draws any triangles.

Where the face is needed too, depth and face are stored as one 64-bit number, with the depth's bits above the face's.
Positive floats are ordered as their bits are. So the least number is the nearest depth, and among equal depths the
first face. That takes half the time of a second pass that looks for the face with the final depth.
"""

import abc
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import sums_up_to, take, take_last
from .._device import chunk_size, is_on_gpu
from .._types import Resolution, Viewport
from ._alpha_test import AlphaTest
from ._bins import BLOCK, CLIPPED, LARGE, WINDOWS, Box, Corners, Facing, Triangles, draws, pixel_box, to_window
from ._clip import FAN, clip_triangles
from ._coverage import DepthPlane, EdgeForm, edge_form, plane_of_clip, plane_of_corners, window_depth
from ._depth_test import DepthTest
from ._items import Items
from ._span import span

PADDING = max(*WINDOWS, BLOCK)
SCATTER = lax.ScatterDimensionNumbers(
    update_window_dims=(1, 2), inserted_window_dims=(), scatter_dims_to_operand_dims=(0, 1)
)
GATHER = lax.GatherDimensionNumbers(offset_dims=(1, 2), collapsed_slice_dims=(), start_index_map=(0, 1))
# Of windows of no triangle, which lie out of bounds.
DROPPED_WRITES, CLIPPED_READS = lax.GatherScatterMode.FILL_OR_DROP, lax.GatherScatterMode.CLIP
# Row and column of these, so that they are not written. In sub-pixels, they are still integers of 32 bits.
_OUT_OF_BOUNDS = -(1 << 20)
_FACE_BITS = 32
# How many faces are clipped at once: in small drawings and in large ones on a CPU, and on a GPU.
_CLIPPED_AT_ONCE = 64, 256, 2048
# Drawings of so many pixels or faces are large.
_MANY_PIXELS, _MANY_FACES = 1 << 22, 1 << 16
# On a CPU, windows of this side or more are written one after the other into buffers of so many bytes at most. In
# larger ones, one core would wait for memory where several evaluate windows.
_MIN_IN_TURN, _MAX_IN_TURN = 8, 1 << 24
# How many rows of blocks are cut into blocks at once, for each block that is drawn at once.
_ROWS_TO_BLOCKS = 2

Write = Callable[[Array, EdgeForm, Int[Array, " n"], int], Array]
"""Writes windows of a side into a buffer, given their triangles and the faces that these are part of, -1 for none."""
Finish = Callable[[Array, Array | int], Any]
"""Makes results of the values of some rows of an image, or of all, and the number of the first row."""
FinishDepth = Callable[[Float[Array, "*l h w"], Int[Array, "*l h w"] | None, Array | int], Any]
"""The same for rows of depth, infinite where there is none, and of faces, -1 where there is none."""


class Chunk(NamedTuple):
    """Some triangles of a class: their faces, whether each is one, and the layer that it is drawn into, if there are
    several; (n,) each."""

    face: Int[Array, " n"]
    used: Bool[Array, " n"]
    layer: Int[Array, " n"] | None


@runtime_checkable
class Drawing(Protocol):
    """Draws something into an image."""

    test: DepthTest
    alpha_test: AlphaTest | None

    def image(self, write: Write, nothing: float | int, dtype: DTypeLike, finish: Finish) -> Any:
        """Writes all triangles into an image that holds `nothing` at first, and returns what `finish` makes of it."""
        ...


class BufferDrawing(Drawing):
    """Draws something into one buffer."""

    @abc.abstractmethod
    def full(self, value: float | int, dtype: DTypeLike) -> Array:
        """A buffer that holds `value` everywhere."""

    @abc.abstractmethod
    def padded(self, image: Array, value: float | int) -> Array:
        """`image` as a buffer, which holds `value` beyond it."""

    @abc.abstractmethod
    def cut(self, buffer: Array) -> Array:
        """A buffer without its padding."""

    @abc.abstractmethod
    def draw(self, buffer: Array, write: Write) -> Array:
        """`buffer` after all triangles are written into it."""

    def image(self, write: Write, nothing: float | int, dtype: DTypeLike, finish: Finish) -> Any:
        return finish(self.cut(self.draw(self.full(nothing, dtype), write)), 0)


class DrawPass(BufferDrawing):
    """Draws triangles into buffers.

    **Arguments:**

    - `triangles`: see `bin_triangles`; `resolution`, `facing`: as given there.
    - `buffer`: (height, width) of the image that buffers hold, whose lower left part is drawn; `resolution` if left
        out.
    """

    def __init__(
        self,
        triangles: Triangles,
        resolution: Viewport,
        facing: Facing,
        test: DepthTest,
        polygon_offset: Float[Array, "2"] | None = None,
        buffer: Resolution | None = None,
        alpha_test: AlphaTest | None = None,
    ):
        self.alpha_test = alpha_test
        self.triangles, self.resolution, self.buffer = triangles, resolution, buffer or resolution
        self.facing, self.test, self.polygon_offset = facing, test, polygon_offset
        in_small, in_large, on_gpu = _CLIPPED_AT_ONCE
        is_large = math.prod(self.buffer) >= _MANY_PIXELS or triangles.faces.shape[0] >= _MANY_FACES
        # As many triangles or blocks are drawn at once as clipping makes, since XLA compiles equal kernels once.
        self.clipped_at_once = chunk_size(in_large if is_large else in_small, on_gpu)
        self.at_once = FAN * self.clipped_at_once

    def full(self, value: float | int, dtype: DTypeLike) -> Array:
        height, width = self.buffer
        return jnp.full((height + PADDING, width + PADDING), value, dtype)

    def padded(self, image: Array, value: float | int) -> Array:
        return jnp.pad(image, ((0, PADDING), (0, PADDING)), constant_values=value)

    def cut(self, buffer: Array) -> Array:
        height, width = self.buffer
        return buffer[:height, :width]

    def draw(self, buffer: Array, write: Write) -> Array:
        if self.triangles.faces.shape[0] == 0:
            return buffer
        return self._large(self._small(buffer, write), write)

    def _loop(self, steps: Int[Array, ""], body: Callable[[Array, Array], Array], buffer: Array) -> Array:
        return lax.fori_loop(jnp.int32(0), steps.astype(jnp.int32), body, buffer)

    def _corners(self, face: Int[Array, " n"]) -> tuple[Corners, DepthPlane]:
        """Corners of faces that need no clipping, and the planes that they lie in."""
        window = self.triangles.window_corners(face)
        corners = Corners.snapped(window)
        return corners, plane_of_corners(window, corners)

    def _form(
        self, corners: Corners, plane: DepthPlane, face: Array, x: Array, y: Array, layer: Array | None
    ) -> EdgeForm:
        """Edge functions of triangles of faces about the pixels (`x`, `y`) of their layers."""
        left, bottom = self._origin(layer)
        place, corners = self._place(x, y, layer), lax.optimization_barrier(corners)
        at = x + left, y + bottom
        alpha = None if self.alpha_test is None else self.alpha_test.form(face, *at)
        form = edge_form(corners, plane, *at, place, self.test, self.polygon_offset, alpha)
        # The barrier keeps XLA from computing the edge functions again for every pixel.
        return lax.optimization_barrier(form)

    # What follows is another in a pass that draws parts of an image into layers.

    @property
    def _counts(self) -> Int[Array, " c"]:
        """How many triangles of each class are drawn."""
        return self.triangles.groups.counts

    def _chunk(self, of_class: Array | int, number: Array, length: int) -> Chunk:
        """Chunk `number` of a class; the last one is padded."""
        return Chunk(*self.triangles.groups.chunk(of_class, number, length), None)

    def _box(self, corners: Corners, layer: Array | None) -> Box:
        """The pixel boxes of triangles within their layers."""
        return pixel_box(corners.x, corners.y, self.resolution)

    def _origin(self, layer: Array | None) -> tuple[Any, Any]:
        """x and y of the first pixels of layers in the image."""
        return 0, 0

    def _place(self, x: Array, y: Array, layer: Array | None) -> tuple[Array, Array]:
        """Row and column in the buffer of the pixels (`x`, `y`) of layers."""
        return y, x

    def _small(self, buffer: Array, write: Write) -> Array:
        """Writes the triangles of all size classes."""
        chunks = _ceil_div(self._counts[:LARGE], self.at_once)
        ends = sums_up_to(chunks)

        def chunk(number: Array, buffer: Array) -> Array:
            size_class = jnp.sum(number >= ends, dtype=jnp.int32)
            face, used, layer = self._chunk(size_class, number - (ends - chunks)[size_class], self.at_once)
            corners, plane = self._corners(face)
            box, (left, bottom) = self._box(corners, layer), self._origin(layer)
            if layer is not None:
                used = used & (box.left <= box.right) & (box.bottom <= box.top)
            x, y = (jnp.where(used, low, _OUT_OF_BOUNDS) for low in (box.left - left, box.bottom - bottom))
            form, source = self._form(corners, plane, face, x, y, layer), jnp.where(used, face, -1)
            branches = [lambda buffer, side=side: write(buffer, form, source, side) for side in WINDOWS]
            return lax.switch(size_class, branches, buffer)

        return self._loop(ends[-1], chunk, buffer)

    def _large(self, buffer: Array, write: Write) -> Array:
        """Writes large triangles, and then what clipping leaves of others, block by block."""
        large = _ceil_div(self._counts[LARGE], self.at_once)

        def whole(number: Array) -> tuple[Corners, DepthPlane, Array, Array | None]:
            face, used, layer = self._chunk(LARGE, number, self.at_once)
            return *self._corners(face), jnp.where(used, face, -1), layer

        def clipped(number: Array) -> tuple[Corners, DepthPlane, Array, Array | None]:
            face, used, layer = self._chunk(CLIPPED, number - large, self.clipped_at_once)
            corners = take(self.triangles.clip, take(self.triangles.faces, face)).T
            parts = clip_triangles(corners, self.resolution).reshape(4, 3, -1)
            each = lambda values: jnp.tile(values, FAN)
            plane = jax.tree.map(each, plane_of_clip(corners, self.resolution))
            snapped = Corners.snapped(to_window(parts, self.resolution))
            return snapped, plane, each(jnp.where(used, face, -1)), None if layer is None else each(layer)

        def batch(number: Array, buffer: Array) -> Array:
            return self._blocks(buffer, write, *lax.cond(number < large, whole, clipped, number))

        return self._loop(large + _ceil_div(self._counts[CLIPPED], self.clipped_at_once), batch, buffer)

    def _blocks(
        self,
        buffer: Array,
        write: Write,
        corners: Corners,
        plane: DepthPlane,
        source: Int[Array, " n"],
        layer: Int[Array, " n"] | None,
    ) -> Array:
        """Writes triangles block by block.

        A triangle's box is cut into rows of blocks. Each row has only the blocks between the triangle's left and right
        there: of a long thin triangle far fewer than its box.
        """
        box = self._box(corners, layer)
        drawn = (source >= 0) & draws(corners.x, corners.y, box, self.facing)
        rows = Items.of(jnp.where(drawn, (box.top - box.bottom) // BLOCK + 1, 0))
        rows_at_once = _ROWS_TO_BLOCKS * self.at_once

        def some_rows(number: Array, buffer: Array) -> Array:
            triangle, row, exists = rows.chunk(number * rows_at_once, rows_at_once)
            own, own_box = _of((corners, box), triangle)
            bottom = own_box.bottom + row * BLOCK
            left, right = span(own, bottom, jnp.minimum(bottom + (BLOCK - 1), own_box.top))
            left, right = jnp.maximum(left, own_box.left), jnp.minimum(right, own_box.right)
            blocks = Items.of(jnp.where(exists & (left <= right), (right - left) // BLOCK + 1, 0))

            def some_blocks(number: Array, buffer: Array) -> Array:
                row, column, exists = blocks.chunk(number * self.at_once, self.at_once)
                x, y, owner = _of((left, bottom, triangle), row)
                own, own_plane, own_source, own_layer = _of((corners, plane, source, layer), owner)
                origin_x, origin_y = self._origin(own_layer)
                x, y = (jnp.where(exists, low, _OUT_OF_BOUNDS) for low in (x + column * BLOCK - origin_x, y - origin_y))
                form = self._form(own, own_plane, own_source, x, y, own_layer)
                # Nor is the face looked up again for every pixel.
                own_source = lax.optimization_barrier(jnp.where(exists, own_source, -1))
                return write(buffer, form, own_source, BLOCK)

            return self._loop(_ceil_div(blocks.total, self.at_once), some_blocks, buffer)

        return self._loop(_ceil_div(rows.total, rows_at_once), some_rows, buffer)


def _of(tree: Any, owner: Int[Array, " n"]) -> Any:
    """The values in `tree`, (..., m) each, of these owners: (..., n) each."""
    return jax.tree.map(lambda values: take_last(values, owner), tree)


def _tested_depth(drawing: Drawing, form: EdgeForm, source: Int[Array, " n"], side: int) -> Float[Array, "n side side"]:
    """`window_depth`, and infinite where the alpha test fails."""
    depth = window_depth(form, source >= 0, side, drawing.test)
    if drawing.alpha_test is None or form.alpha is None:
        return depth
    return jnp.where(drawing.alpha_test.passes(form.alpha, side), depth, jnp.inf)


def least_depth(drawing: Drawing, finish: FinishDepth) -> Any:
    """What `finish` makes of the least depth at every pixel."""
    # As the bits of positive floats, which are integers of the same order: the least of floats also keeps NaN, which
    # takes longer.
    bits = lambda depth: lax.bitcast_convert_type(depth, jnp.int32)
    stored = lambda form, source, side: bits(_tested_depth(drawing, form, source, side))
    depth = lambda least, first: finish(lax.bitcast_convert_type(least, jnp.float32), None, first)
    return _least(drawing, stored, int(np.float32(np.inf).view(np.int32)), jnp.int32, depth)


def least_depth_and_face(drawing: Drawing, behind: Int[Array, "rows columns"] | None, finish: FinishDepth) -> Any:
    """What `finish` makes of the least depth at every pixel and its face.

    Faces in `behind`, a buffer of the drawing, are passed over. Of several faces at the same depth it is the first, or
    the last where the depth test lets equal depths pass.
    """
    # The greatest face has the least complement.
    order = lambda face: ~face if drawing.test.compare == "less_equal" else face

    def stored(form: EdgeForm, source: Int[Array, " n"], side: int) -> Array:
        depth = _tested_depth(drawing, form, source, side)
        if behind is not None:
            passed = lax.gather(behind, corner(form), GATHER, (side, side), mode=CLIPPED_READS)
            depth = jnp.where(passed == source[:, None, None], jnp.inf, depth)
        if source.shape[0] > 1:
            # As it would be stored alone, whatever the compiler would fuse it with. Windows that are written one after
            # the other are not evaluated apart in either case.
            depth = lax.optimization_barrier(depth)
        high = lax.bitcast_convert_type(depth, jnp.int32).astype(jnp.int64) << _FACE_BITS
        low = order(source)[:, None, None].astype(jnp.int64) & ((1 << _FACE_BITS) - 1)
        return high | low

    def depth_and_face(key: Array, first: Array | int) -> Any:
        depth = lax.bitcast_convert_type((key >> _FACE_BITS).astype(jnp.int32), jnp.float32)
        face = order(key.astype(jnp.int32))
        # The bits of an infinite depth, and of no depth at all, encode no number below infinity.
        seen = depth < jnp.inf
        return finish(jnp.where(seen, depth, jnp.inf), jnp.where(seen, face, -1), first)

    with jax.enable_x64(True):
        return _least(drawing, stored, jnp.iinfo(jnp.int64).max, jnp.int64, depth_and_face)


def _ceil_div(count: Int[Array, "*n"], length: int) -> Int[Array, "*n"]:
    return lax.div(count + (length - 1), jnp.full_like(count, length))


def corner(form: EdgeForm) -> Int[Array, "n 2"]:
    """Row and column of each window's first pixel."""
    return jnp.stack([form.row, form.column], axis=-1)


def _least(
    drawing: Drawing,
    stored: Callable[[EdgeForm, Int[Array, " n"], int], Array],
    nothing: float | int,
    dtype: DTypeLike,
    finish: Finish,
) -> Any:
    """What `finish` makes of the least at every pixel of what any window stores there.

    **Arguments:**

    - `stored`: returns what windows store, (n, side, side), given triangles' edge functions, their faces and the
        windows' side.
    - `nothing`: what the buffer holds at first.
    """

    def write(buffer: Array, form: EdgeForm, source: Array, side: int) -> Array:
        if is_on_gpu() or side < _MIN_IN_TURN or buffer.size * buffer.dtype.itemsize > _MAX_IN_TURN:
            updates = stored(form, source, side)
            return lax.scatter_min(buffer, corner(form), updates, SCATTER, mode=DROPPED_WRITES)

        def one(number: Array, buffer: Array) -> Array:
            own, face = _of((form, source), number[None])
            place = own.row[0], own.column[0]
            least = jnp.minimum(lax.dynamic_slice(buffer, place, (side, side)), stored(own, face, side)[0])
            return lax.dynamic_update_slice(buffer, least, place)

        # XLA makes one kernel of such a loop, which keeps a window in registers: no array of all windows is written.
        return lax.fori_loop(jnp.int32(0), _up_to_last(source), one, buffer)

    return drawing.image(write, nothing, dtype, finish)


@jax.custom_batching.custom_vmap
def _up_to_last(source: Int[Array, " n"]) -> Int[Array, ""]:
    """How many windows there are up to the last one of a triangle."""
    number = jnp.arange(1, source.shape[0] + 1, dtype=jnp.int32)
    return jnp.max(jnp.where(source >= 0, number, 0))


@_up_to_last.def_vmap
def _up_to_last_of_all(size: int, is_mapped: list[bool], source: Int[Array, "b n"]) -> tuple[Int[Array, ""], bool]:
    """The most of all: a loop of one length. Lengths of their own would keep or drop whole buffers at each step."""
    return _up_to_last(jnp.max(source, axis=0)), False
