"""Kernels: the texels that a filter reads around a receiver, and their weights.

A filter is a sum over steps, such as taps or rows of texels. At each step its kernel reads a few neighbouring texels.
The weights of a step are separable: a texel's weight is the product of its column's weight and its row's weight.
"""

import abc
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._compare import AbstractCompare
from .._lookup import Lookup
from ._padded_map import PaddedMap

# The cost of a compare with one texel of a row, in taps. A tap costs more because it stores its texel's index.
_COST_OF_A_TEXEL = 0.1


class Span(NamedTuple):
    """The weight of a column or row of texels, and its part under the kernel, relative to its middle."""

    weight: Float[Array, "*n"] | float
    low: Float[Array, "*n"] | float = -0.5
    high: Float[Array, "*n"] | float = 0.5


class Footprint(NamedTuple):
    """The texels that a step reads.

    - `column`, `row`: (n,), column and row of the first texel, integers; `rows` begin `up` rows above this texel.
    - `columns`, `rows`: the consecutive columns and rows from there.
    """

    column: Float[Array, "*n"]
    row: Float[Array, "*n"]
    columns: Sequence[Span]
    rows: Sequence[Span]
    up: Int[Array, "*n"] | int = 0

    def lit(self, padded: PaddedMap, compare: AbstractCompare, lookup: Lookup) -> Float[Array, "*n"]:
        """The weighted sum of compares with the texels' stored depths."""
        first = padded.place(self.column, self.row, lookup.layer)

        def row(up: Array | int) -> Array:
            total = jnp.zeros_like(lookup.depth)
            for i, span in enumerate(self.columns):
                stored = padded.depth_at(first, up * padded.stride + i)
                total = total + span.weight * compare(stored, self.depth(lookup, i, up), lookup.depth_per_texel)
            return total

        rows = (span.weight * row(self.up + j) for j, span in enumerate(self.rows))
        return sum(rows, start=jnp.zeros_like(lookup.x))

    def depth(self, lookup: Lookup, right: Array | int, up: Array | int) -> Float[Array, "*n"]:
        """The depth that a texel is compared with: the depth of the receiver plane at the texel's centre."""
        if lookup.slope is None:
            return lookup.depth
        along_x, along_y = lookup.slope
        x, y = self.column + right + 0.5 - lookup.x, self.row + up + 0.5 - lookup.y
        depth = lookup.depth + along_x * x + along_y * y
        return depth if lookup.deepest is None else jnp.minimum(depth, lookup.deepest)


class AbstractKernel(eqx.Module):
    """The texels that a filter reads around each look-up, step by step, and their weights.

    Its arrays are scalars or have one value per look-up. Visibility is differentiable with respect to them.

    - `cost`: cost of a step, in taps.
    """

    @property
    @abc.abstractmethod
    def cost(self) -> float: ...

    @abc.abstractmethod
    def footprint(self, lookup: Lookup, step: Any) -> Footprint:
        """The texels that look-ups read at a step. There is one step for all look-ups, or one for each."""

    @abc.abstractmethod
    def reach(self, lookup: Lookup, steps: Any) -> Float[Array, "..."]:
        """Half the width, in texels, of a square around a look-up that contains all texels it reads."""


class AbstractRow(AbstractKernel):
    """One row of the square of texels that a filter reads. A step is the row's number, counted from the lowest row.

    - `texels`: number of texels per side of the square.
    """

    @property
    @abc.abstractmethod
    def texels(self) -> int: ...

    @property
    def cost(self) -> float:
        return _COST_OF_A_TEXEL * self.texels


class AbstractSizedRow(AbstractRow):
    """One row of the texels under a kernel whose radius may vary.

    - `max_radius`: upper bound on the radius, in texels; `radius`: one for all look-ups, or one for each.
    """

    max_radius: float = eqx.field(static=True)
    radius: Float[Array, "..."]

    @property
    def texels(self) -> int:
        return math.ceil(2 * self.max_radius) + 1

    def reach(self, lookup: Lookup, steps: Any) -> Float[Array, "..."]:
        return self.radius
