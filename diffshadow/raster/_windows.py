"""Writing triangles into the depth and face buffers, a window of pixels at a time.

Every triangle of a size class is evaluated in a window of that size at its own lower left corner. Windows are written
in chunks, by a scatter that keeps the least. No sort and no list of triangles for each tile is needed. The buffers
are padded, so that a window may reach beyond the image.

All loops run as often as the triangles need, and nothing but the number of faces and the resolution has a static size:
a compiled program draws any triangles.

Where the face is needed too, depth and face travel together as one 64-bit number, the depth's bits above the face's:
positive floats are ordered as their bits are, so the least number is the nearest depth and, among equals, the first
face. That takes half the time of a second pass that looks for the face whose depth has settled.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from .._misc import take
from .._types import FaceMap, Resolution
from ._bins import BLOCK, CLIPPED, LARGE, WINDOWS, Corners, Cull, Triangles, draws, pixel_box, to_window
from ._clip import FAN, clip_triangles
from ._coverage import DepthPlane, EdgeForm, edge_form, plane_of_clip, plane_of_corners, window_depth
from ._depth_test import DepthTest

PADDING = max(*WINDOWS, BLOCK)
SCATTER = lax.ScatterDimensionNumbers(
    update_window_dims=(1, 2), inserted_window_dims=(), scatter_dims_to_operand_dims=(0, 1)
)
GATHER = lax.GatherDimensionNumbers(offset_dims=(1, 2), collapsed_slice_dims=(), start_index_map=(0, 1))
IN_BOUNDS = lax.GatherScatterMode.PROMISE_IN_BOUNDS
_FACE_BITS = 32
# How many are drawn, clipped and tested at once: triangles of a size class, faces to clip, and blocks.
_SMALL = 1 << 9
_CLIPPED = 1 << 7
_BLOCKS = 1 << 9

Write = Callable[[Array, EdgeForm, Int[Array, " n"], int], Array]
"""Writes windows of a side into a buffer, given their triangles and the faces that these are part of, -1 for none."""


class DrawPass:
    """Draws triangles into buffers.

    **Arguments:**

    - `triangles`: see `bin_triangles`; `cull`: as given there.
    """

    def __init__(
        self,
        triangles: Triangles,
        resolution: Resolution,
        cull: Cull,
        test: DepthTest,
        polygon_offset: Float[Array, "2"] | None = None,
    ):
        self.triangles, self.resolution = triangles, resolution
        self.cull: Cull = cull
        self.test, self.polygon_offset = test, polygon_offset

    def draw(self, buffer: Int[Array, "H W"] | Float[Array, "H W"], write: Write) -> Array:
        """`buffer` after all triangles are written into it."""
        if self.triangles.faces.shape[0] == 0:
            return buffer
        return self._large(self._small(buffer, write), write)

    def _loop(self, steps: Int[Array, ""], body: Callable[[Array, Array], Array], buffer: Array) -> Array:
        return lax.fori_loop(jnp.int32(0), steps.astype(jnp.int32), body, buffer)

    def _form(self, corners: Corners, plane: DepthPlane, x: Array, y: Array) -> EdgeForm:
        return edge_form(lax.optimization_barrier(corners), plane, x, y, self.test, self.polygon_offset)

    def _small(self, buffer: Array, write: Write) -> Array:
        """Writes the triangles of all size classes."""
        groups = self.triangles.groups
        length = min(_SMALL, groups.elements.shape[0])
        chunks = (groups.counts[:LARGE] + length - 1) // length
        ends = jnp.cumsum(chunks, dtype=jnp.int32)

        def chunk(number: Array, buffer: Array) -> Array:
            size_class = jnp.sum(number >= ends, dtype=jnp.int32)
            face, used = groups.chunk(size_class, number - (ends - chunks)[size_class], length)
            corners = self.triangles.corners(face)
            box = pixel_box(*corners.snapped(), self.resolution)
            x, y = (jnp.where(used, low, 0) for low in (box.left, box.bottom))
            form, source = self._form(corners, plane_of_corners(corners), x, y), jnp.where(used, face, -1)
            branches = [lambda buffer, side=side: write(buffer, form, source, side) for side in WINDOWS]
            return lax.switch(size_class, branches, buffer)

        return self._loop(ends[-1], chunk, buffer)

    def _large(self, buffer: Array, write: Write) -> Array:
        """Writes large triangles, and then what clipping leaves of others, block by block."""
        groups = self.triangles.groups
        at_once = min(_CLIPPED, groups.elements.shape[0])
        large = groups.chunks(LARGE, FAN * at_once)

        def whole(number: Array) -> tuple[Corners, DepthPlane, Array]:
            face, used = groups.chunk(LARGE, number, FAN * at_once)
            corners = self.triangles.corners(face)
            return corners, plane_of_corners(corners), jnp.where(used, face, -1)

        def clipped(number: Array) -> tuple[Corners, DepthPlane, Array]:
            face, used = groups.chunk(CLIPPED, number - large, at_once)
            vertices = [take(self.triangles.faces[:, k], face) for k in range(3)]
            corners = jnp.stack([take(self.triangles.clip, vertex) for vertex in vertices], axis=1)
            parts = clip_triangles(corners, self.resolution)
            window = to_window(parts.reshape(-1, 4), self.resolution)
            each = lambda values: jnp.repeat(values, FAN)
            plane = jax.tree.map(each, plane_of_clip(corners, self.resolution))
            parts = Corners(*([*values.reshape(-1, 3).T] for values in window))
            return parts, plane, each(jnp.where(used, face, -1))

        def batch(number: Array, buffer: Array) -> Array:
            return self._blocks(buffer, write, *lax.cond(number < large, whole, clipped, number))

        return self._loop(large + groups.chunks(CLIPPED, at_once), batch, buffer)

    def _blocks(
        self, buffer: Array, write: Write, corners: Corners, plane: DepthPlane, source: Int[Array, " n"]
    ) -> Array:
        """Writes triangles block by block."""
        fixed = corners.snapped()
        box = pixel_box(*fixed, self.resolution)
        left, bottom = box.left // BLOCK, box.bottom // BLOCK
        columns = jnp.maximum(box.right // BLOCK - left + 1, 1)
        drawn = (source >= 0) & draws(*fixed, box, self.cull)
        # The blocks of all boxes are numbered: a triangle's numbers end before its entry of `ends`.
        lengths = jnp.where(drawn, columns * (box.top // BLOCK - bottom + 1), 0)
        ends = jnp.cumsum(lengths, dtype=jnp.int32)

        def candidates(number: Array, buffer: Array) -> Array:
            block = number * _BLOCKS + jnp.arange(_BLOCKS, dtype=jnp.int32)
            exists = block < ends[-1]
            owner = jnp.where(exists, jnp.searchsorted(ends, block, side="right").astype(jnp.int32), 0)
            within, across = block - take(ends - lengths, owner), take(columns, owner)
            x, y = take(left, owner) + within % across, take(bottom, owner) + within // across
            x, y = (jnp.where(exists, tile * BLOCK, 0) for tile in (x, y))
            own, own_plane = jax.tree.map(lambda values: take(values, owner), (corners, plane))
            form = self._form(own, own_plane, x, y)
            return write(buffer, form, jnp.where(exists, take(source, owner), -1), BLOCK)

        return self._loop((ends[-1] + _BLOCKS - 1) // _BLOCKS, candidates, buffer)


def least_depth(drawing: DrawPass) -> Float[Array, "h w"]:
    """The least depth at every pixel, infinite where there is none."""
    stored = lambda form, source, side: window_depth(form, source >= 0, side, drawing.test)
    return _least(drawing, stored, jnp.inf, jnp.float32)


def least_depth_and_face(drawing: DrawPass, behind: FaceMap | None) -> tuple[Float[Array, "h w"], Int[Array, "h w"]]:
    """The least depth at every pixel, and its face, -1 where there is none; faces in `behind` (h, w) are passed over.

    Of several faces at the same depth it is the first, or the last where the depth test lets equal depths pass.
    """
    # The least complement is that of the greatest face.
    order = lambda face: ~face if drawing.test.compare == "less_equal" else face
    padded = None if behind is None else jnp.pad(behind, ((0, PADDING), (0, PADDING)), constant_values=-1)

    def stored(form: EdgeForm, source: Int[Array, " n"], side: int) -> Array:
        depth = window_depth(form, source >= 0, side, drawing.test)
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
        key = _least(drawing, stored, nothing, jnp.int64)
        depth = lax.bitcast_convert_type((key >> _FACE_BITS).astype(jnp.int32), jnp.float32)
        face = order(key.astype(jnp.int32))
    # The bits of an infinite depth, and of none at all, are those of no number below infinity.
    seen = depth < jnp.inf
    return jnp.where(seen, depth, jnp.inf), jnp.where(seen, face, -1)


def corner(form: EdgeForm) -> Int[Array, "n 2"]:
    """Row and column of each window's first pixel."""
    return jnp.stack([form.y, form.x], axis=-1)


def _least(
    drawing: DrawPass,
    stored: Callable[[EdgeForm, Int[Array, " n"], int], Array],
    nothing: float | int,
    dtype: DTypeLike,
) -> Array:
    """The least of what is `stored` (n, side, side) by any window at every pixel."""
    height, width = drawing.resolution
    buffer = jnp.full((height + PADDING, width + PADDING), nothing, dtype)

    def write(buffer: Array, form: EdgeForm, source: Array, side: int) -> Array:
        return lax.scatter_min(buffer, corner(form), stored(form, source, side), SCATTER, mode=IN_BOUNDS)

    return drawing.draw(buffer, write)[:height, :width]
