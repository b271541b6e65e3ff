"""Percentage-closer filtering (Reeves, Salesin & Cook 1987)."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._misc import as_float, concrete
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._taps import PaddedMap, Sites, pad, sites_of, sum_of_parts
from ._abstract import AbstractFilter

# Narrower than this a box cannot be told from a point.
_LEAST_RADIUS = 1e-3
# Texels beside each other share what it takes to find them.
_COST_OF_A_TEXEL = 0.4


class PercentageCloser(AbstractFilter):
    """The share of a box of the map that does not shadow the receiver.

    The box slides and grows smoothly: a texel counts by the part of it that the box covers. A radius of 0.5 is the
    bilinear compare; 2.5 covers 5 x 5 texels.

    - `radius`: half the box's width, in texels.
    - `max_radius`: the largest radius that can be asked for, in texels; the number of taps grows with its square. It
        defaults to `radius`, and is rounded up to a half texel.

    **Raises** `ValueError` if `radius` is negative or above `max_radius`.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)

    def __init__(self, radius: float | Scalar = 2.5, max_radius: float | None = None):
        self.radius = as_float(radius)
        # At least 1: a box without width still needs the least one to divide by.
        self.max_radius = max(1.0, math.ceil(2 * float(radius) if max_radius is None else 2 * max_radius) / 2)

    def __check_init__(self):
        radius = concrete(self.radius)
        if radius is not None and not 0 <= radius <= self.max_radius:
            raise ValueError(
                f"the filter's radius is {radius} texels; expected 0 to max_radius = {self.max_radius:g}: give a "
                "larger max_radius"
            )

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        row = _Row(self.max_radius)
        sites = sites_of(lookup, jnp.clip(self.radius, _LEAST_RADIUS, self.max_radius))
        return sum_of_parts(row, pad(shadow_map, row.texels), compare, sites, jnp.arange(row.texels))


class _Row(eqx.Module):
    """One row of the box's texels, numbered from the lowest that any box of these radii covers."""

    max_radius: float = eqx.field(static=True)

    @property
    def texels(self) -> int:
        """Texels that a box may cover along a side."""
        return math.ceil(2 * self.max_radius) + 1

    @property
    def cost(self) -> float:
        return _COST_OF_A_TEXEL * self.texels

    def __call__(
        self, padded: PaddedMap, compare: AbstractCompare, sites: Sites, number: Int[Array, ""]
    ) -> Float[Array, "*n"]:
        column, left = _lower_edge(sites.x, sites.radius)
        row, below = _lower_edge(sites.y, sites.radius)
        place = padded.place(column, row, sites.layer) + number * padded.stride
        row = row + number
        total = sum(
            _share(left, sites.radius, i) * sites.lit(padded, compare, place + i, column + i, row)
            for i in range(self.texels)
        )
        return _share(below, sites.radius, number) * total


def _lower_edge(position: Float[Array, "*n"], radius: Float[Array, "..."]) -> tuple[Array, Array]:
    """The texel that the lower edge of a box round `position` lies in, and how far into that texel it lies."""
    own = jnp.floor(position)
    # Measured from the position's own texel, so that shares add up to 1 however far away that is.
    edge = position - own - radius
    first = jnp.floor(edge)
    return own + first, edge - first


def _share(edge: Float[Array, "*n"], radius: Float[Array, "..."], number: Array | int) -> Float[Array, "*n"]:
    """Share of a box's width that lies in texel `number` from the one its lower `edge` lies in."""
    upper = edge + 2 * radius - number
    # Rather than a clip, whose derivatives halve on its corners at some cost.
    ends = jnp.where(upper < 0, 0, jnp.where(upper < 1, upper, 1))
    return (ends - jnp.where(number == 0, edge, 0)) / (2 * radius)
