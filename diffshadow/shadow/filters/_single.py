"""One look-up: the hardware's two filter modes."""

from typing import ClassVar

from ..._types import Visibility
from ...settings import filters
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import ShaderPart, text_of
from ..kernels import single_tap
from ._abstract import AbstractFilter


class Nearest(AbstractFilter):
    """Compares with the one texel that contains the receiver (Williams 1978)."""

    settings: ClassVar = filters.Nearest

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return single_tap(shadow_map, lookup, compare, "nearest")

    def shader(self) -> ShaderPart:
        return ShaderPart((), text_of("kernels/_taps.glsl", "filters/_nearest.glsl"))


class Bilinear(AbstractFilter):
    """Compares with the four texels around the receiver and interpolates the results.

    !!! Example

        ```python
        shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(1.0)).visibility(state, surface).shape  # (32, 32)
        ```
    """

    settings: ClassVar = filters.Bilinear

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return single_tap(shadow_map, lookup, compare, "bilinear")

    def shader(self) -> ShaderPart:
        return ShaderPart((), text_of("kernels/_taps.glsl", "filters/_bilinear.glsl"))
