"""Percentage-closer filtering with a tent instead of a box."""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._misc import as_float
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._kernel import AbstractRow, Footprint, Sites, Span, sites_of
from .._lookup import Lookup
from .._map import ShadowMap
from .._sum import sum_over_rows
from ._abstract import AbstractFilter
from ._prefilter import check_radius, radius_limit, share


class Tent(AbstractFilter):
    """The mean of compares with all texels round a receiver, weighed by a tent.

    The tent slides and grows smoothly: a texel counts by the integral of the tent over it. Visibility then has a
    continuous slope along the map, where that of a box has kinks.

    - `radius`: from the tent's top to where it ends, in texels.
    - `max_radius`: the largest radius that can be asked for, in texels; the number of taps grows with its square. It
        defaults to `radius`, and is rounded up to a half texel.

    **Raises** `ValueError` if `radius` is negative or above `max_radius`.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)

    def __init__(self, radius: float | Scalar = 2.5, max_radius: float | None = None):
        self.radius = as_float(radius)
        self.max_radius = radius_limit(radius, max_radius)

    def __check_init__(self):
        check_radius("tent", self.radius, self.max_radius)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        sites = sites_of(lookup, jnp.minimum(self.radius, self.max_radius))
        return sum_over_rows(_Row(self.max_radius), shadow_map, compare, sites)


class _Row(AbstractRow):
    """One row of the tent's texels, numbered from the lowest that the widest tent covers."""

    max_radius: float = eqx.field(static=True)

    @property
    def texels(self) -> int:
        """Texels that a tent may cover along a side."""
        return math.ceil(2 * self.max_radius) + 1

    def footprint(self, sites: Sites, step: Int[Array, "*n"]) -> Footprint:
        column, left = self._first(sites.x)
        row, below = self._first(sites.y)
        span = lambda first, i: Span(share("tent", sites.radius, first + i, first + (i + 1)))
        return Footprint(column, row, [span(left, i) for i in range(self.texels)], [span(below, step)], step)

    def reach(self, sites: Sites, steps: Any) -> Float[Array, "..."]:
        return sites.radius

    def _first(self, position: Float[Array, "*n"]) -> tuple[Array, Array]:
        """The first texel along one axis, and where it begins, seen from `position`."""
        own = jnp.floor(position)
        # Measured from the position's own texel, so that shares add up to 1 however far away that is.
        within = position - own
        first = jnp.floor(within - self.max_radius)
        return own + first, first - within
