"""Percentage-closer filters of any radius."""

import abc
from typing import Any, ClassVar

import equinox as eqx

from ..._arithmetic import as_number
from ..._types import AsScalar, Visibility
from ...settings.filters import Sized as Settings
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import Constant, ShaderPart, number, text_of
from ..kernels import MIN_RADIUS, AbstractRow, check_radius, limit_radius, sum_over_rows
from ._abstract import AbstractFilter


class AbstractSizedFilter(AbstractFilter):
    """The weighted mean of compares with all texels under a kernel.

    - `radius`: half the kernel's width, in texels.
    - `max_radius`: upper bound on `radius`, in texels; the number of taps grows with its square. Defaults to `radius`,
        or to 8 if `radius` is traced; rounded up to a half texel.

    **Raises** `ValueError` if `radius` is above `max_radius`.
    """

    settings: ClassVar = Settings

    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)
    max_radius: float | Any = eqx.field(static=True, default=None)

    def __post_init__(self):
        limit_radius(self)

    def _check_rules(self):
        check_radius(self)

    @abc.abstractmethod
    def row(self) -> AbstractRow:
        """One row of the texels under the kernel, and their weights."""

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return sum_over_rows(self.row(), shadow_map, compare, lookup)

    def shader_of(self, file: str) -> ShaderPart:
        """The shader's part whose text is in this file of `shadow`."""
        radius = max(min(number(self.radius), number(self.max_radius)), MIN_RADIUS)
        constants = (
            Constant("RADIUS", radius, "half the kernel's width, in texels"),
            Constant("MAX_RADIUS", number(self.max_radius), "the most it may be, in texels"),
            Constant("TEXELS", self.row().texels, "along a side of the square that is read"),
        )
        return ShaderPart(constants, text_of(file))
