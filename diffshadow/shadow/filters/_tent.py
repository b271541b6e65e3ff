"""Percentage-closer filtering with a tent instead of a box."""

import equinox as eqx
import jax.numpy as jnp

from ..._misc import as_float
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import SeparableRow, sum_over_rows
from ._abstract import AbstractFilter
from ._prefilter import check_radius, radius_limit


class Tent(AbstractFilter):
    """The mean of compares with all texels around the receiver, weighted by a tent.

    The tent moves and grows smoothly: each texel is weighted by the integral of the tent over it. Visibility then has a
    continuous derivative along the map, while that of a box has kinks.

    - `radius`: from the tent's peak to its edge, in texels.
    - `max_radius`: upper bound on `radius`, in texels; the number of taps grows with its square. Defaults to `radius`;
        rounded up to a half texel.

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
        row = SeparableRow(self.max_radius, jnp.minimum(self.radius, self.max_radius), "tent")
        return sum_over_rows(row, shadow_map, compare, lookup)
