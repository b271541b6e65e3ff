"""Sections that say how shadows are computed: the map, the bias, the compare and the filter."""

import math
from typing import Annotated, Literal

from pydantic import Field, Tag, field_validator

from ._section import Section, Size, Texels, Unit, by_type, fault

Kernel = Literal["logistic", "linear", "smoothstep", "gaussian", "exponential"]
"""Shape of a soft compare's step."""


class ShadowMapConfig(Section):
    """The map that is drawn from the light."""

    resolution: Annotated[Size, Unit("texels")] = Field(default=(1024, 1024), description="[height, width] in texels")
    cull: Literal["none", "back", "front"] = Field(default="none", description="faces that are not drawn into the map")


class BiasConfig(Section):
    """How far receivers are moved towards the light before the compare."""

    constant: Texels = Field(default=0.5, ge=0, description="constant bias, in texels")
    slope: Texels = Field(default=0.5, ge=0, description="bias per unit of the receiver's slope, in texels")
    normal_offset: Texels = Field(default=0.0, ge=0, description="shift along the receiver's normal, in texels")


class HardCompareConfig(Section):
    """Lit or shadowed, nothing between."""

    type: Literal["hard"] = "hard"
    operator: Literal["less_equal", "less"] = Field(
        default="less_equal", description="of receiver against stored depth"
    )


class SoftCompareConfig(Section):
    """A compare with a slope, so that it has a gradient."""

    type: Literal["soft"] = "soft"
    width: Texels = Field(default=0.5, gt=0, description="width of the step, in texels of depth")
    kernel: Kernel = Field(default="logistic", description="shape of the step")


class NearestConfig(Section):
    """The one texel under the receiver."""

    type: Literal["nearest"] = "nearest"


class BilinearConfig(Section):
    """Four compares, blended."""

    type: Literal["bilinear"] = "bilinear"


class FourTapConfig(Section):
    """Four bilinear taps on the diagonals."""

    type: Literal["four_tap"] = "four_tap"
    radius: Texels = Field(default=1.0, ge=0, description="of the taps from the middle, in texels")


class PercentageCloserConfig(Section):
    """A box of texels with fractional edges."""

    type: Literal["pcf"] = "pcf"
    radius: Texels = Field(default=2.0, ge=0, description="half the box's width, in texels")


class RandomDiskConfig(Section):
    """Stratified taps on a disk, another pattern for each pixel of a tile."""

    type: Literal["random_disk"] = "random_disk"
    radius: Texels = Field(default=2.0, ge=0, description="of the disk, in texels")
    samples: Annotated[int, Unit("taps a pixel")] = Field(
        default=32, ge=1, le=4096, description="taps a pixel, the product of two whole numbers: 32 is 4 x 8"
    )
    pattern_size: Annotated[int, Unit("pixels")] = Field(
        default=8, ge=1, le=256, description="width of the tile of patterns, in pixels"
    )
    lookup: Literal["bilinear", "nearest"] = Field(default="bilinear", description="how each tap reads the map")
    early_out: bool = Field(
        default=False, description="whether to spare pixels that a first few taps find all lit or shadowed"
    )

    @field_validator("samples")
    @classmethod
    def _has_a_grid(cls, samples: int) -> int:
        u, _ = sample_grid(samples)
        if u == 1 and samples > 3:
            below, above = (_composite(samples, step) for step in (-1, 1))
            raise fault(
                f"is {samples}, a prime number",
                "a product of two whole numbers, so that the taps fill a grid",
                f"take {below} ({_times(below)}) or {above} ({_times(above)})",
            )
        return samples

    @property
    def grid(self) -> tuple[int, int]:
        """`samples` as (samples_u, samples_v)."""
        return sample_grid(self.samples)


def sample_grid(samples: int) -> tuple[int, int]:
    """The factors (u, v) of `samples` nearest to a square, `u <= v`."""
    u = next(n for n in range(math.isqrt(samples), 0, -1) if samples % n == 0)
    return u, samples // u


def _composite(samples: int, step: int) -> int:
    samples += step
    while sample_grid(samples)[0] == 1:
        samples += step
    return samples


def _times(samples: int) -> str:
    return " x ".join(map(str, sample_grid(samples)))


CompareConfig = Annotated[
    Annotated[HardCompareConfig, Tag("hard")] | Annotated[SoftCompareConfig, Tag("soft")], by_type("hard")
]
FilterConfig = Annotated[
    Annotated[NearestConfig, Tag("nearest")]
    | Annotated[BilinearConfig, Tag("bilinear")]
    | Annotated[FourTapConfig, Tag("four_tap")]
    | Annotated[PercentageCloserConfig, Tag("pcf")]
    | Annotated[RandomDiskConfig, Tag("random_disk")],
    by_type("random_disk"),
]

FILTERS: dict[str, type[Section]] = {
    "nearest": NearestConfig,
    "bilinear": BilinearConfig,
    "four_tap": FourTapConfig,
    "pcf": PercentageCloserConfig,
    "random_disk": RandomDiskConfig,
}
"""Each filter's section by its `type`."""
