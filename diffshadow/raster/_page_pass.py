"""Draws the resident pages of a virtual map.

All faces are binned once for each level that has pages. A face is drawn once into every page that its pixel box
touches. These pairs are numbered like the blocks of large triangles, and a table gives the page of a pair. Corners,
edge functions and depth planes come from the level's whole map, so a page's pixels equal that map's to the bit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import sums_up_to, take
from .._types import ClipVertices, Faces
from ..geometry import Pages, Textures
from ._alpha_test import AlphaTest
from ._bins import CLASSES, CLIPPED, NOTHING, Box, Corners, Facing, Triangles, classify
from ._compact import Groups, group
from ._depth_test import DepthTest
from ._items import Items
from ._windows import PADDING, BufferDrawing, Chunk, DrawPass, Write

# The table of resident pages that a face may touch has this many cells per side.
_CELLS = 64


class Pairs(NamedTuple):
    """The pairs of faces and pages of a level.

    - `left`, `bottom`, `columns`: (f,), the first column and row of pages that each face's box touches, and the number
      of columns.
    - `items`: the pairs of each face, in the order of the level's groups: all pages that its box touches, resident or
      not, or all resident pages of the level if they are fewer.
    - `starts`, `counts`: (c,), the first pair of each class, and the number of its pairs.
    - `first`, `resident`: the first layer of the level, and the number of its layers.
    """

    left: Int[Array, " f"]
    bottom: Int[Array, " f"]
    columns: Int[Array, " f"]
    items: Items
    starts: Int[Array, " c"]
    counts: Int[Array, " c"]
    first: Int[Array, ""]
    resident: Int[Array, ""]


class Level(NamedTuple):
    """A mesh's triangles in the whole map of a level: the fields of `Triangles` that differ between levels, and the
    pairs with its pages."""

    level: Int[Array, ""]
    x: Float[Array, " v"]
    y: Float[Array, " v"]
    z: Float[Array, " v"]
    groups: Groups
    pairs: Pairs


class PagedDrawing(BufferDrawing):
    """Draws triangles into the pages of a virtual map. A buffer holds all layers, one above the other.

    **Arguments:** as for `DrawPass` and `bin_triangles`.
    """

    def __init__(
        self,
        clip: ClipVertices,
        faces: Faces,
        pages: Pages,
        facing: Facing,
        test: DepthTest,
        polygon_offset: Float[Array, "2"] | None = None,
        textures: Textures | None = None,
    ):
        self.textures = textures
        size = pages.side, pages.side
        self.alpha_test = None if textures is None else AlphaTest(textures, clip, faces, size)
        self.clip, self.faces, self.pages = clip, faces, pages
        self.facing = facing
        self.test, self.polygon_offset = test, polygon_offset
        self.table = pages.table()
        # Computed here, because buffers of faces are drawn in 64-bit mode.
        levels = jnp.arange(pages.levels, dtype=jnp.int32)
        self.levels = lax.map(lambda level: _binned(clip, faces, pages, level, facing), levels)

    def full(self, value: float | int, dtype: DTypeLike) -> Array:
        side = self.pages.side + PADDING
        return jnp.full((self.pages.level.shape[0] * side, side), value, dtype)

    def padded(self, image: Array, value: float | int) -> Array:
        wide = jnp.pad(image, ((0, 0), (0, PADDING), (0, PADDING)), constant_values=value)
        return wide.reshape(-1, wide.shape[-1])

    def cut(self, buffer: Array) -> Array:
        side = self.pages.side
        return buffer.reshape(-1, side + PADDING, side + PADDING)[:, :side, :side]

    def draw(self, buffer: Array, write: Write) -> Array:
        def of_level(number: Array, buffer: Array) -> Array:
            level = jax.tree.map(lambda values: values[number], self.levels)
            return _LevelPass(self, level).draw(buffer, write)

        return lax.fori_loop(jnp.int32(0), jnp.int32(self.pages.levels), of_level, buffer)


class _LevelPass(DrawPass):
    """Draws triangles into the pages of one level."""

    def __init__(self, whole: PagedDrawing, level: Level):
        triangles = Triangles(whole.clip, level.x, level.y, level.z, whole.faces, level.groups)
        self.pages, self.pairs = whole.pages, level.pairs
        size = self.pages.size(level.level)
        self.origins = self.pages.tile.origin
        self.level, self.table = level.level, whole.table
        textures, clip = whole.textures, whole.clip
        alpha_test = None if textures is None else AlphaTest(textures, clip, whole.faces, (size, size))
        layers = self.pages.level.shape[0] * self.pages.side, self.pages.side
        super().__init__(triangles, (size, size), whole.facing, whole.test, whole.polygon_offset, layers, alpha_test)

    @property
    def _counts(self) -> Int[Array, " c"]:
        return self.pairs.counts

    def _chunk(self, of_class: Array | int, number: Array, length: int) -> Chunk:
        pairs = self.pairs
        rank = number * length + jnp.arange(length, dtype=jnp.int32)
        used = rank < pairs.counts[of_class]
        owner, within, _ = pairs.items.chunk(pairs.starts[of_class] + number * length, length)
        face, count = take(self.triangles.groups.elements, owner), take(pairs.items.lengths, owner)
        left, bottom, columns = (take(values, face) for values in (pairs.left, pairs.bottom, pairs.columns))
        row, column = bottom + within // columns, left + within % columns
        page = Pages.number(self.pages.levels, self.level, row, column)
        # Faces that touch more pages than are resident loop over the resident pages.
        by_page = used & (count < pairs.resident)
        layer = jnp.where(by_page, take(self.table, jnp.where(by_page, page, 0)), pairs.first + within)
        return Chunk(face, used & (layer >= 0), jnp.where(used, jnp.maximum(layer, 0), 0))

    def _box(self, corners: Corners, layer: Array | None) -> Box:
        box, (left, bottom), last = super()._box(corners, None), self._origin(layer), self.pages.side - 1
        return Box(
            jnp.maximum(box.left, left),
            jnp.maximum(box.bottom, bottom),
            jnp.minimum(box.right, left + last),
            jnp.minimum(box.top, bottom + last),
        )

    def _origin(self, layer: Array | None) -> tuple[Array, Array]:
        assert layer is not None
        return take(self.origins[:, 0], layer), take(self.origins[:, 1], layer)

    def _place(self, x: Array, y: Array, layer: Array | None) -> tuple[Array, Array]:
        assert layer is not None
        return layer * (self.pages.side + PADDING) + y, x


def _binned(clip: ClipVertices, faces: Faces, pages: Pages, level: Int[Array, ""], facing: Facing) -> Level:
    """The triangles in the whole map of a level, and the pairs with its pages. There are no pairs if it has no
    pages."""
    bins = lambda: _binned_level(clip, faces, pages, level, facing)
    nothing = lambda: jax.tree.map(lambda array: jnp.zeros(array.shape, array.dtype), jax.eval_shape(bins))
    return lax.cond(jnp.any(_of_level(pages, level)), bins, nothing)


def _binned_level(clip: ClipVertices, faces: Faces, pages: Pages, level: Int[Array, ""], facing: Facing) -> Level:
    mine = _of_level(pages, level)
    across, size = jnp.maximum(pages.across >> level, 1), pages.size(level)
    resident = jnp.sum(mine, dtype=jnp.int32)
    # At each corner of the grid of cells, the number of cells below and to the left with resident pages. A cell has one
    # or more pages.
    most = min(pages.across, _CELLS)
    pages_to_cell = jnp.maximum(across // most, 1)
    corner = jnp.where(mine, pages.row // pages_to_cell + 1, most + 1), pages.column // pages_to_cell + 1
    within = jnp.zeros((most + 1, most + 1), jnp.int32).at[corner].set(1, mode="drop")
    within = jax.vmap(sums_up_to)(jax.vmap(sums_up_to, 1, 1)(within)).reshape(-1)

    def touched(box: Box) -> Box:
        """The columns and rows of pages whose layers a box touches. Layers at the map's border extend further."""
        reaches = lambda page: jnp.clip(page, 0, across - 1)
        first = lambda low: reaches(jnp.where(low < pages.side, 0, (low - pages.gutter) // pages.page))
        last = lambda high: reaches(
            jnp.where(high >= size - pages.side, across - 1, (high + pages.gutter) // pages.page)
        )
        return Box(first(box.left), first(box.bottom), last(box.right), last(box.top))

    x, y, z, box, of_class = classify(clip, faces, (size, size), facing)
    left, bottom, right, top = touched(box)
    first_x, first_y, last_x, last_y = (
        page // pages_to_cell for page in (left, bottom, right + pages_to_cell, top + pages_to_cell)
    )
    up_to = lambda row, column: take(within, row * (most + 1) + column)
    touches = up_to(last_y, last_x) - up_to(first_y, last_x) - up_to(last_y, first_x) + up_to(first_y, first_x) > 0
    # A triangle that must be clipped may lie in any page.
    clipped = of_class == CLIPPED
    groups = group(jnp.where(clipped | touches, of_class, NOTHING), CLASSES)
    columns = jnp.maximum(right - left + 1, 1)
    lengths = jnp.where(clipped, resident, jnp.minimum(columns * (top - bottom + 1), resident))
    order = jnp.arange(faces.shape[0], dtype=jnp.int32)
    in_order = jnp.where(order < jnp.sum(groups.counts, dtype=jnp.int32), take(lengths, groups.elements), 0)
    items = Items.of(in_order)
    before = jnp.concatenate([jnp.zeros(1, jnp.int32), items.ends])
    starts = take(before, groups.starts)
    counts = take(before, groups.starts + groups.counts) - starts
    first = jnp.argmax(mine).astype(jnp.int32)
    pairs = Pairs(left, bottom, columns, items, starts, counts, first, resident)
    return Level(level, x, y, z, groups, pairs)


def _of_level(pages: Pages, level: Int[Array, ""]) -> Bool[Array, " l"]:
    """The layers that have a page of this level."""
    return (pages.level == level) & (jnp.arange(pages.level.shape[0]) < pages.count)
