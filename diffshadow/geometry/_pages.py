"""Virtual shadow maps, which store only some parts of the map: its pages."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import sums_up_to, take

Whole = Int[Array, "*n"]
Broadcast = Int[Array, "*#n"]


class Tile(NamedTuple):
    """The part of a virtual map that a layer shows, or one part for each of several layers or points.

    - `origin`: (2,), x and y of its first texel in the virtual map.
    - `size`: side of the virtual map, in texels.
    """

    origin: Int[Array, "*n 2"]
    size: Int[Array, "*n"]

    def facing(self, layer: Int[Array, "*n"]) -> "Tile":
        """The tile of each point's `layer`, from the tiles of several layers."""
        return Tile(take(self.origin, layer), take(self.size, layer))


class Pages(eqx.Module):
    """The resident pages of a virtual map. Each page has its own layer.

    A virtual map has levels. Level 0, the finest, has `2^(levels - 1)` pages per side. Each further level has half as
    many pages, of twice the size. The last level is the root, whose only page is the whole map. A layer has its page
    and a gutter around it, in texels of the level's whole map. At the border of that map, the layer is moved inwards.
    The root's layer has no gutter, and fills the layer.

    - `page`: side of a page, in texels; a power of two.
    - `gutter`: texels around the page, on each side, at most half of `page`.
    - `levels`: the number of levels, 2 or more.
    - `level`, `row`, `column`: (l,), the page in each layer, sorted by level; only the first `count` layers have a
        page.
    - `count`: the number of resident pages.
    """

    page: int = eqx.field(static=True)
    gutter: int = eqx.field(static=True)
    levels: int = eqx.field(static=True)
    level: Int[Array, " l"]
    row: Int[Array, " l"]
    column: Int[Array, " l"]
    count: Int[Array, ""]

    @classmethod
    @eqx.filter_jit
    def of(cls, resident: Bool[Array, " n"], page: int, gutter: int, levels: int, capacity: int) -> "Pages":
        """The pages that are `resident` (n,), numbered by level, row and column (`number`).

        **Arguments:**

        - `capacity`: the number of layers, at least as many as are resident.
        """
        starts = _starts(levels)
        layer = jnp.where(resident, sums_up_to(resident) - 1, capacity)
        numbers = jnp.arange(resident.shape[0], dtype=jnp.int32)
        # Layers without a page show the root.
        shown = jnp.full(capacity, starts[-1], jnp.int32).at[layer].set(numbers, mode="drop")
        level = jnp.searchsorted(jnp.asarray(starts), shown, side="right").astype(jnp.int32) - 1
        within, across = shown - jnp.asarray(starts)[level], _across(levels, level)
        return cls(page, gutter, levels, level, within // across, within % across, jnp.sum(resident, dtype=jnp.int32))

    @staticmethod
    def total(levels: int) -> int:
        """The number of pages in all levels."""
        return int(_starts(levels)[-1]) + 1

    @staticmethod
    def number(levels: int, level: Broadcast, row: Broadcast, column: Broadcast) -> Int[Array, "..."]:
        """A page's index among the pages of all levels, from its row and column in its level."""
        return take(jnp.asarray(_starts(levels)), level) + row * _across(levels, level) + column

    @property
    def side(self) -> int:
        """Side of a layer, in texels."""
        return side_of(self.page, self.gutter)

    @property
    def across(self) -> int:
        """The number of pages along a side of level 0."""
        return 1 << (self.levels - 1)

    def size(self, level: Whole) -> Whole:
        """Side of the whole map of `level`, in texels."""
        return jnp.where(level == self.levels - 1, self.side, self.page * _across(self.levels, level))

    @property
    @eqx.filter_jit
    def tile(self) -> Tile:
        """What each layer shows."""
        size = self.size(self.level)
        inside = lambda k: jnp.clip(k * self.page - self.gutter, 0, size - self.side)
        return Tile(jnp.stack([inside(self.column), inside(self.row)], axis=-1), size)

    @eqx.filter_jit
    def table(self) -> Int[Array, " n"]:
        """The layer of each page of all levels, by its index; -1 if it is not resident."""
        layers = jnp.arange(self.level.shape[0], dtype=jnp.int32)
        number = Pages.number(self.levels, self.level, self.row, self.column)
        table = jnp.full(Pages.total(self.levels), -1, jnp.int32)
        return table.at[jnp.where(layers < self.count, number, table.size)].set(layers, mode="drop")

    def finest(self) -> Int[Array, "c c"]:
        """The layer of the finest resident page over each page of level 0."""
        return finest_of(self.table(), self.levels)


def side_of(page: int, gutter: int) -> int:
    """Side of a layer, in texels, for pages of this side and gutters of this width."""
    return page + 2 * gutter


@eqx.filter_jit
def finest_of(table: Int[Array, " n"], levels: int) -> Int[Array, "c c"]:
    """For each page of level 0, the entry in `table` of the finest page that contains it. Pages with a negative entry
    do not count. -1 if no page counts."""
    cells = jnp.arange(1 << (levels - 1), dtype=jnp.int32)
    row, column = jnp.meshgrid(cells, cells, indexing="ij")

    def finer(step: Array, found: Array) -> Array:
        level = levels - 1 - step
        entry = take(table, Pages.number(levels, level, row >> level, column >> level))
        return jnp.where(entry >= 0, entry, found)

    return lax.fori_loop(jnp.int32(0), jnp.int32(levels), finer, jnp.full(row.shape, -1, jnp.int32))


def cell_of(window: Float[Array, "*n"], levels: int) -> Int[Array, "*n"]:
    """The row or column of the page of level 0 at a position across the map, which runs from 0 to 1."""
    across = 1 << (levels - 1)
    return jnp.clip(jnp.floor(window * across), 0, across - 1).astype(jnp.int32)


def _across(levels: int, level: Whole) -> Whole:
    return jnp.left_shift(jnp.int32(1), levels - 1 - level)


def _starts(levels: int) -> np.ndarray:
    """The number of each level's first page."""
    counts = 4 ** np.arange(levels)[::-1]
    return (np.cumsum(counts) - counts).astype(np.int32)
