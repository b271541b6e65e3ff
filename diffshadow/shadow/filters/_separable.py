"""A separable kernel with free weights."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx

from ..._arithmetic import as_float, as_numbers
from ..._types import AsScalars, Scalar, Visibility
from ...settings.filters import Separable as Settings
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import Constant, ShaderPart, numbers, text_of
from ..kernels import WeightedRow, sum_over_rows
from ._abstract import AbstractFilter


class Separable(AbstractFilter):
    """A symmetric kernel of fixed width with free weights: bilinear compares one texel apart, weighted along both axes
    and divided by the weights' sum.

    With n weights there are (2n + 1)² compares. All kernels of `Castano` have this form; size 5 has the weights 3/4 and
    1/4.

    - `weights`: weights of the compares 1, 2, ... texels from the centre, relative to the weight at the centre; each 0
      or more.
    """

    settings: ClassVar = Settings

    weights: AsScalars = eqx.field(converter=as_numbers, default=Settings.weights)

    @property
    def normalized(self) -> tuple[Scalar, ...]:
        """The weights of the compares 0, 1, 2, ... texels from the middle, which sum to 1 over both sides."""
        each = (as_float(1), *self.weights)
        total = each[0] + 2 * sum(self.weights)
        return tuple(weight / total for weight in each)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return sum_over_rows(WeightedRow(self.normalized), shadow_map, compare, lookup)

    def shader(self) -> ShaderPart:
        return shader_of_weights(self.normalized)


def shader_of_weights(normalized: Sequence[Scalar]) -> ShaderPart:
    """The shader of bilinear compares with these weights, from the middle outwards."""
    half = numbers(normalized)
    weights = (0.0, *reversed(half[1:]), *half, 0.0)
    constants = (
        Constant("TEXELS", 2 * len(half), "along a side of the square that is read"),
        Constant("WEIGHTS", weights, "of bilinear compares one texel apart, between two zeros"),
    )
    return ShaderPart(constants, text_of("filters/_separable.glsl"))
