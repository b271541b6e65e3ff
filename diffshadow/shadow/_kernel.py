"""Kernels: what a filter reads round a receiver, and what each texel counts.

A filter is a sum of steps, such as taps or rows of texels; at each step its kernel names a few texels beside each
other. A kernel is separable: a texel counts by the product of what its column and its row count.
"""

import abc
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ._compare import AbstractCompare
from ._lookup import Lookup
from ._padded_map import PaddedMap
from .silhouettes import WHOLE_TEXEL, Rectangle

# A compare with a texel of a row, in nearest taps, which have to find theirs.
_COST_OF_A_TEXEL = 0.4


class Sites(eqx.Module):
    """Look-ups laid out in any way, and what the texels that they read depend on.

    - `x`, `y`, `depth`, `depth_per_texel`, `slope`, `layer`, `deepest`: as in `Lookup`.
    - `radius`: in texels, of each or of all.
    - `turn`: cosine and sine of the angle by which each turns its pattern; none where none does.
    """

    x: Float[Array, "*n"]
    y: Float[Array, "*n"]
    depth: Float[Array, "*n"]
    depth_per_texel: Float[Array, "*n"]
    slope: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None
    layer: Int[Array, "*n"] | None
    radius: Float[Array, "..."]
    turn: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None
    deepest: Float[Array, "*n"] | None = None

    def held(self) -> "Sites":
        """Without derivative by position."""
        return eqx.tree_at(lambda s: (s.x, s.y), self, lax.stop_gradient((self.x, self.y)))

    def map(self, function: Callable[[Array], Array]) -> "Sites":
        """With `function` of every array but a `radius` of all."""
        return jax.tree.map(lambda leaf: function(leaf) if leaf.ndim else leaf, self)


def sites_of(lookup: Lookup, radius: Float[Array, "..."] | float = 0.0) -> Sites:
    """The look-ups, pixel by pixel."""
    slope = None if lookup.slope is None else (lookup.slope[..., 0], lookup.slope[..., 1])
    x, y, radius = lookup.texel[..., 0], lookup.texel[..., 1], jnp.asarray(radius)
    return Sites(x, y, lookup.depth, lookup.depth_per_texel, slope, lookup.layer, radius, deepest=lookup.deepest)


class Span(NamedTuple):
    """What a column or a row of texels counts, and from where to where it is covered, seen from its middle."""

    weight: Float[Array, "*n"] | float
    low: Float[Array, "*n"] | float = WHOLE_TEXEL.left
    high: Float[Array, "*n"] | float = WHOLE_TEXEL.right


class Footprint(NamedTuple):
    """The texels that a step reads.

    - `column`, `row`: (...,), of the first, whole numbers; rows count from `up` above it.
    - `columns`, `rows`: those from there on.
    """

    column: Float[Array, "*n"]
    row: Float[Array, "*n"]
    columns: Sequence[Span]
    rows: Sequence[Span]
    up: Int[Array, "*n"] | int = 0

    def places(self, padded: PaddedMap, sites: Sites) -> list[tuple[Array, Array | int]]:
        """Where all texels are stored, row by row: the place of the first, and how many there are from it to them."""
        first = padded.place(self.column, self.row, sites.layer)
        texels = [(i, j) for j in range(len(self.rows)) for i in range(len(self.columns))]
        return [(first, (self.up + j) * padded.stride + i) for i, j in texels]

    def lit(self, padded: PaddedMap, compare: AbstractCompare, sites: Sites) -> Float[Array, "*n"]:
        """The sum of compares with the texels' stored depths."""
        first = padded.place(self.column, self.row, sites.layer)

        def row(up: Array | int) -> Array:
            total = jnp.zeros_like(sites.depth)
            for i, span in enumerate(self.columns):
                stored = padded.depth_at(first, up * padded.stride + i)
                total = total + span.weight * compare(stored, self._depth(sites, i, up), sites.depth_per_texel)
            return total

        return sum((span.weight * row(self.up + j) for j, span in enumerate(self.rows)), start=jnp.zeros_like(sites.x))

    def correction(
        self,
        padded: PaddedMap,
        compare: AbstractCompare,
        sites: Sites,
        number: Int[Array, "*n"],
        motion: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None,
    ) -> Float[Array, "*n"]:
        """By how much the sum changes as a caster ends in the texel of this `number`, which has a silhouette.

        It then counts by the mean over the part of it that is covered. With a `motion`, the outline has moved by that.
        """
        i, j = number % len(self.columns), number // len(self.columns)
        column, row = _choose(self.columns, i), _choose(self.rows, j)
        place = padded.place(self.column, self.row, sites.layer) + (self.up + j) * padded.stride + i
        depth = self._depth(sites, i, self.up + j)
        against = lambda stored: compare(stored, depth, sites.depth_per_texel)
        part = Rectangle(column.low, column.high, row.low, row.high)
        return column.weight * row.weight * padded.change_by_silhouette(against, place, part, motion)

    def _depth(self, sites: Sites, right: Array | int, up: Array | int) -> Float[Array, "*n"]:
        """What a texel is compared with: the depth at which its centre meets the receiver's plane."""
        if sites.slope is None:
            return sites.depth
        along_x, along_y = sites.slope
        x, y = self.column + right + 0.5 - sites.x, self.row + up + 0.5 - sites.y
        depth = sites.depth + along_x * x + along_y * y
        return depth if sites.deepest is None else jnp.minimum(depth, sites.deepest)


def _choose(spans: Sequence[Span], number: Int[Array, "*n"]) -> Span:
    chosen = spans[0]
    for i, span in enumerate(spans[1:], start=1):
        chosen = Span(*(jnp.where(number == i, new, old) for new, old in zip(span, chosen, strict=True)))
    return chosen


class AbstractKernel(eqx.Module):
    """What a filter reads round a site, step by step. It treats each site by itself.

    - `cost`: of a step, in nearest taps.
    """

    @property
    @abc.abstractmethod
    def cost(self) -> float: ...

    @abc.abstractmethod
    def footprint(self, sites: Sites, step: Any) -> Footprint:
        """The texels that sites read at a step, for one of the filter's steps or one for each site."""

    @abc.abstractmethod
    def reach(self, sites: Sites, steps: Any) -> Float[Array, "..."]:
        """Half the width of a square round a site that holds all that it reads, in texels."""


class AbstractRow(AbstractKernel):
    """One row of the texels that a filter reads, a square of them; a step is the row's number from the lowest.

    - `texels`: along a side of the square.
    """

    @property
    @abc.abstractmethod
    def texels(self) -> int: ...

    @property
    def cost(self) -> float:
        return _COST_OF_A_TEXEL * self.texels
