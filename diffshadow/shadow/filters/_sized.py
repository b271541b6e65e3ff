"""Percentage-closer filters of any radius."""

import abc
from typing import ClassVar

import equinox as eqx

from ..._misc import as_float
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import AbstractRow, check_radius, radius_limit, sum_over_rows
from ._abstract import AbstractFilter, reach_of


class AbstractSizedFilter(AbstractFilter):
    """The weighted mean of compares with all texels under a kernel.

    - `name`: what errors call the filter.
    - `radius`: half the kernel's width, in texels.
    - `max_radius`: upper bound on `radius`, in texels; the number of taps grows with its square. Defaults to `radius`;
        rounded up to a half texel.

    **Raises** `ValueError` if `radius` is negative or above `max_radius`.
    """

    name: ClassVar[str]

    radius: Scalar
    max_radius: float = eqx.field(static=True)

    def __init__(self, radius: float | Scalar = 2.5, max_radius: float | None = None):
        self.radius = as_float(radius)
        self.max_radius = radius_limit(radius, max_radius)

    def __check_init__(self):
        check_radius(self.name, self.radius, self.max_radius)

    @abc.abstractmethod
    def row(self) -> AbstractRow:
        """One row of the texels under the kernel, and their weights."""

    @property
    def reach(self) -> float | None:
        return reach_of(self.radius)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return sum_over_rows(self.row(), shadow_map, compare, lookup)
