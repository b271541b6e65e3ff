"""Four bilinear taps."""

import equinox as eqx
import jax.numpy as jnp

from ..._checks import check_not_negative
from ..._misc import as_float
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import mean_of_taps
from ..patterns import Pattern
from ._abstract import AbstractFilter, reach_of


class FourTap(AbstractFilter):
    """The mean of four bilinear compares at the corners (±radius, ±radius), `radius` in texels: 16 texels in all.

    **Raises** `ValueError` if `radius` is negative or not finite.
    """

    radius: Scalar = eqx.field(converter=as_float, default=1.0)

    def __check_init__(self):
        check_not_negative("the four taps' radius", self.radius)

    @property
    def reach(self) -> float | None:
        return reach_of(self.radius, 0.5)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        corners = Pattern(jnp.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])[:, None, None])
        return mean_of_taps(shadow_map, lookup, compare, self.radius, corners, "bilinear")
