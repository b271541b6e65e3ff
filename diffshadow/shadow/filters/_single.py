"""One look-up: the hardware's two filter modes."""

from ..._types import Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import single_tap
from ._abstract import AbstractFilter


class Nearest(AbstractFilter):
    """Compares with the one texel that contains the receiver (Williams 1978)."""

    @property
    def reach(self) -> float:
        return 0.0

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return single_tap(shadow_map, lookup, compare, "nearest")


class Bilinear(AbstractFilter):
    """Compares with the four texels around the receiver and interpolates the results."""

    @property
    def reach(self) -> float:
        return 0.5

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return single_tap(shadow_map, lookup, compare, "bilinear")
