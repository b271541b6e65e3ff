"""Drawing a large image in bands of rows, from the bottom to the top, so that the buffer stays in a CPU's cache.

Triangles are sorted by the band of their first row. Windows that reach into the next band are written into
the padding of the buffer. The padding becomes the first rows of the next buffer. Large triangles are cut into blocks
again for each band.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from .._arithmetic import sums_up_to, take
from .._device import is_on_gpu
from .._types import ClipVertices, Faces, Resolution, Viewport
from ._alpha_test import AlphaTest
from ._bins import CLIPPED, LARGE, Box, Corners, Facing, classify
from ._compact import Groups
from ._depth_test import DepthTest
from ._windows import PADDING, Chunk, Drawing, DrawPass, Finish, Write

# Buffers up to this size, in bytes, are not split. Larger buffers are split into bands of at least this size and at
# least this many rows.
_MAX_IN_ONE, _MIN_BYTES, _MIN_ROWS = 1 << 25, 1 << 21, 128


def bands_of(buffer: Resolution, bytes_a_pixel: int) -> int:
    """The number of bands of an image."""
    height, width = buffer
    size = height * (width + PADDING) * bytes_a_pixel
    if is_on_gpu() or size <= _MAX_IN_ONE:
        return 1
    # A power of two, because it divides the height of most images.
    return 1 << min(size // _MIN_BYTES, height // _MIN_ROWS).bit_length() - 1


class BandDrawing(Drawing):
    """Draws triangles into an image that is divided into `bands` bands.

    **Arguments:** the others are as for `DrawPass` and `bin_triangles`.
    """

    def __init__(
        self,
        clip: ClipVertices,
        faces: Faces,
        resolution: Viewport,
        facing: Facing,
        test: DepthTest,
        polygon_offset: Float[Array, "2"] | None,
        buffer: Resolution,
        bands: int,
        alpha_test: AlphaTest | None = None,
    ):
        self.alpha_test = alpha_test
        self.resolution, self.buffer, self.bands = resolution, buffer, bands
        self.facing, self.test, self.polygon_offset = facing, test, polygon_offset
        self.rows = -(-buffer[0] // bands)
        classified = classify(clip, faces, resolution, facing)
        self.triangles = classified.grouped(clip, faces)
        first, last = (row // self.rows for row in (classified.box.bottom, classified.box.top))
        self.by_band = _by_band(self.triangles.groups, classified.of_class, first, last, bands)

    def image(self, write: Write, nothing: float | int, dtype: DTypeLike, finish: Finish) -> Any:
        height, width = self.buffer
        empty = jnp.full((self.rows, width + PADDING), nothing, dtype)

        def band(number: Array, carry: tuple[Array, Any]) -> tuple[Array, Any]:
            reaching, images = carry
            first = number * self.rows
            buffer = _BandPass(self, number).draw(jnp.concatenate([reaching, empty]), write)
            done = finish(buffer[: self.rows, :width], first)
            images = jax.tree.map(
                lambda image, rows: lax.dynamic_update_slice_in_dim(image, rows, first, 0), images, done
            )
            return buffer[self.rows :], images

        shapes = jax.eval_shape(lambda rows: finish(rows, 0), empty[:, :width])
        images = jax.tree.map(lambda rows: jnp.zeros((self.bands * self.rows, width), rows.dtype), shapes)
        _, images = lax.fori_loop(jnp.int32(0), jnp.int32(self.bands), band, (empty[:PADDING], images))
        return jax.tree.map(lambda image: image[:height], images)


class _BandPass(DrawPass):
    """Draws triangles into a band."""

    def __init__(self, whole: BandDrawing, number: Array):
        triangles, sorted_ = whole.triangles, whole.by_band
        windows = number * LARGE + jnp.arange(LARGE, dtype=jnp.int32)
        # Large triangles of this band and of the band below are adjacent in the order; tall triangles are separate.
        below, here, tall = (whole.bands * LARGE + n for n in (jnp.maximum(number - 1, 0), number, whole.bands))
        self.near = sorted_.starts[here] + sorted_.counts[here] - sorted_.starts[below]
        self.tall = sorted_.starts[tall]
        large = sorted_.starts[below], self.near + sorted_.counts[tall]
        clipped = triangles.groups.starts[CLIPPED], triangles.groups.counts[CLIPPED]
        starts, counts = (
            jnp.concatenate([values[windows], jnp.stack([*rest])])
            for values, *rest in zip((sorted_.starts, sorted_.counts), large, clipped, strict=True)
        )
        groups = Groups(sorted_.elements, starts, counts)
        super().__init__(
            dataclasses.replace(triangles, groups=groups),
            whole.resolution,
            whole.facing,
            whole.test,
            whole.polygon_offset,
            (whole.rows, whole.buffer[1]),
            whole.alpha_test,
        )
        self.first, self.last = number * whole.rows, number * whole.rows + (whole.rows - 1)

    def _chunk(self, of_class: Array | int, number: Array, length: int) -> Chunk:
        if of_class is not LARGE:
            return super()._chunk(of_class, number, length)
        groups = self.triangles.groups
        rank = number * length + jnp.arange(length, dtype=jnp.int32)
        used = rank < groups.counts[LARGE]
        place = rank + jnp.where(rank < self.near, groups.starts[LARGE], self.tall - self.near)
        return Chunk(take(groups.elements, jnp.where(used, place, 0)), used, None)

    def _box(self, corners: Corners, layer: Array | None) -> Box:
        box = super()._box(corners, layer)
        return box._replace(bottom=jnp.maximum(box.bottom, self.first), top=jnp.minimum(box.top, self.last))

    def _place(self, x: Array, y: Array, layer: Array | None) -> tuple[Array, Array]:
        return y - self.first, x


def _by_band(
    groups: Groups, of_class: Int[Array, " n"], first: Int[Array, " n"], last: Int[Array, " n"], bands: int
) -> Groups:
    """The elements sorted by band. Elements that must be clipped stay last.

    Group `band * LARGE + k` has the windows of class `k` in a band, and group `bands * LARGE + band` has its large
    triangles. The last group has the tall triangles, which reach beyond the next band.

    **Arguments:**

    - `first`, `last`: (n,), the bands of each triangle's first and last row.
    """
    large = bands * LARGE + jnp.where(last - first <= 1, first, bands)
    key = take(jnp.where(of_class == LARGE, large, first * LARGE + of_class), groups.elements)
    number, keys = groups.starts[CLIPPED], bands * (LARGE + 1) + 1
    is_sorted = jnp.arange(key.shape[0], dtype=jnp.int32) < number
    counts = jnp.zeros(keys, jnp.int32).at[jnp.where(is_sorted, key, keys)].add(1, mode="drop")
    starts = sums_up_to(counts) - counts

    def put(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        following, elements = carry
        place = following[key[i]]
        return following.at[key[i]].set(place + 1), elements.at[place].set(groups.elements[i])

    _, elements = lax.fori_loop(jnp.int32(0), number, put, (starts, groups.elements))
    return Groups(elements, starts, counts)
