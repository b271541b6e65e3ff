"""Random disk sampling (Uralsky, "Efficient Soft-Edged Shadows Using Pixel Shader Branching", GPU Gems 2, ch. 17)."""

import equinox as eqx
import jax.numpy as jnp

from ..._checks import check_choice, check_not_negative
from ..._misc import as_float
from ..._types import Mask, Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import TapMode, mean_of_taps
from ..patterns import EARLY_SAMPLES, Pattern, stratified
from ._abstract import AbstractFilter, reach_of


class RandomDisk(AbstractFilter):
    """The mean of taps at the points of a pattern, scaled to a disk.

    - `radius`: of the disk, in texels.
    - `pattern`: where the taps lie; the classic offset table if left out.
    - `lookup`: `"bilinear"` or `"nearest"` taps. With nearest taps, `radius` has no gradient.
    - `early_out`: whether to take the first 8 samples, which lie far out, and skip the others where these agree.

    **Raises** `ValueError` if `radius` is negative, or `lookup` is unknown.
    """

    radius: Scalar
    pattern: Pattern
    lookup: TapMode = eqx.field(static=True)
    early_out: bool = eqx.field(static=True)

    def __init__(
        self,
        radius: float | Scalar = 2.0,
        pattern: Pattern | None = None,
        lookup: TapMode = "bilinear",
        early_out: bool = False,
    ):
        self.radius = as_float(radius)
        self.pattern = stratified() if pattern is None else pattern
        self.lookup = lookup
        self.early_out = early_out

    def __check_init__(self):
        check_choice("the random disk's lookup", self.lookup, TapMode.__args__)
        check_not_negative("the random disk's radius", self.radius)

    @property
    def reach(self) -> float | None:
        return reach_of(self.radius, 0.5)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        def mean(pattern: Pattern, active: Mask | None = None) -> Visibility:
            return mean_of_taps(shadow_map, lookup, compare, self.radius, pattern, self.lookup, active)

        offsets, count = self.pattern.offsets, self.pattern.samples
        if not self.early_out or count <= EARLY_SAMPLES:
            return mean(self.pattern)
        part = lambda offsets: Pattern(offsets, self.pattern.rotated)
        first = mean(part(offsets[:EARLY_SAMPLES]))
        agree = (first == 0) | (first == 1)
        others = mean(part(offsets[EARLY_SAMPLES:]), ~agree)
        weight = EARLY_SAMPLES / count
        return jnp.where(agree, first, weight * first + (1 - weight) * others)
