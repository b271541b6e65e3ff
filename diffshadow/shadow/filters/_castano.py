"""Castaño's kernels (Castaño, "Shadow Mapping Summary, Part 1", The Witness, 2013)."""

from typing import ClassVar

import equinox as eqx

from ..._arithmetic import as_float
from ..._types import Scalar, Visibility
from ...settings.filters import Castano as Settings
from ...settings.filters import KernelSize
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import ShaderPart
from ..kernels import WeightedRow, sum_over_rows
from ._abstract import AbstractFilter
from ._separable import shader_of_weights

CASTANO_KERNELS: dict[int, tuple[int, ...]] = {3: (1, 2, 1), 5: (1, 3, 4, 3, 1), 7: (1, 5, 12, 16, 12, 5, 1)}
"""Weights along each axis, by size, of the equivalent bilinear compares one texel apart."""


class Castano(AbstractFilter):
    """A bell-shaped kernel of fixed width: `size` by `size` bilinear compares one texel apart, weighted by
    `CASTANO_KERNELS` along both axes.

    On a GPU, 4, 9 or 16 bilinear look-ups between texels give the same result. It has no numbers to fit. `Separable`
    has weights, and `Tent` a radius.

    - `size`: 3, 5 or 7.
    """

    settings: ClassVar = Settings

    size: KernelSize = eqx.field(static=True, default=Settings.size)

    @property
    def normalized(self) -> tuple[Scalar, ...]:
        """The shader, which is that of `Separable`."""
        weights = CASTANO_KERNELS[self.size]
        return tuple(as_float(weight / sum(weights)) for weight in weights[self.size // 2 :])

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return sum_over_rows(WeightedRow(self.normalized), shadow_map, compare, lookup)

    def shader(self) -> ShaderPart:
        return shader_of_weights(self.normalized)
