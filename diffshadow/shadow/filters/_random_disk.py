"""Random disk sampling (Uralsky, "Efficient Soft-Edged Shadows Using Pixel Shader Branching", GPU Gems 2, ch. 17)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..._arithmetic import as_number
from ..._types import AsScalar, Mask, Visibility
from ...settings.filters import RandomDisk as Settings
from ...settings.filters import TapMode
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import Constant, ShaderPart, number, numbers, text_of
from ..kernels import mean_of_taps
from ..patterns import EARLY_SAMPLES, Pattern, stratified
from ._abstract import AbstractFilter


class RandomDisk(AbstractFilter):
    """The mean of taps at the points of a pattern, scaled to a disk.

    - `radius`: radius of the disk, in texels.
    - `pattern`: the positions of the taps; by default stratified points.
    - `lookup`: `"bilinear"` or `"nearest"` taps. With nearest taps, `radius` has no gradient.
    - `early_out`: whether to skip the other samples if the first 8 agree. The first samples are near the rim.

    !!! Example

        ```python
        disk = shadow.RandomDisk(2.0, shadow.vogel(8))
        shadow.ShadowMapping(disk, shadow.Bias(1.0)).visibility(state, surface).shape  # (32, 32)
        ```
    """

    settings: ClassVar = Settings

    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)
    pattern: Pattern = eqx.field(default_factory=stratified)
    lookup: TapMode = eqx.field(static=True, default=Settings.lookup)
    early_out: bool = eqx.field(static=True, default=Settings.early_out)

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

    def shader(self) -> ShaderPart:
        early = self.early_out and self.pattern.samples > EARLY_SAMPLES
        constants = (
            Constant("RADIUS", number(self.radius), "of the disk, in texels"),
            *constants_of_pattern(self.pattern, ""),
            Constant("BILINEAR", self.lookup == "bilinear", "whether taps are interpolated"),
            Constant("EARLY_SAMPLES", EARLY_SAMPLES if early else 0, "after which a pixel stops where all agree"),
        )
        return ShaderPart(constants, text_of("kernels/_taps.glsl", "_patterns.glsl", "filters/_random_disk.glsl"))


def constants_of_pattern(pattern: Pattern, prefix: str) -> tuple[Constant, ...]:
    """A pattern as constants of a shader. Their names begin with `prefix`."""
    samples, size = pattern.offsets.shape[:2]
    return (
        Constant(f"{prefix}SAMPLES", samples, "points of the pattern for each pixel"),
        Constant(f"{prefix}PATTERN_SIZE", size, "pixels along a side of the tile that the pattern repeats"),
        Constant(f"{prefix}ROTATED", pattern.rotated, "whether each pixel turns its points"),
        Constant(f"{prefix}PATTERN", numbers(pattern.offsets), "x and y of each point: point, row, column"),
    )
