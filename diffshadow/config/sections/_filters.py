"""Sections of the filters, which average compares.

A section's keys are the arguments of the module that `builds` names.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, Tag

from ._section import FARTHEST, Conflict, Fitted, Form, Section, Texels, Unit, as_list, by_type, fault, ordered

Radius = Annotated[Texels, Fitted()]
# The radius of a kernel that is unrolled texel by texel. Compilation takes minutes for much larger radii.
UnrolledRadius = Annotated[float, Field(le=128), Unit("texels"), Fitted()]
LeastVariance = Annotated[float, Fitted()]
MOST_TAPS = 1 << 20
"""The most taps in a tile of patterns."""
_LEAST_VARIANCE = "least variance of depth, where depth is 0 at the map's near plane and 1 at its far plane"


class _FilterConfig(Section):
    builds: ClassVar[str]
    """The name in `diffshadow.shadow` of the module that the section builds."""
    grows_with_radius: ClassVar[bool] = False
    """Whether the module takes an upper bound of its radius."""
    radius_key: ClassVar[str] = "radius"
    """The key that sets how far its taps reach."""
    beyond_radius: ClassVar[float] = 0.0
    """How far beyond its radius the filter reads the map, in texels."""

    @property
    def looks_up_nearest(self) -> bool:
        """Whether it reads nearest texels, so that it has no gradient by where it reads."""
        return False

    @property
    def reach(self) -> float:
        """How far from the receiver's texel coordinates the filter reads the map, in texels."""
        return getattr(self, self.radius_key, 0.0) + self.beyond_radius


class NearestConfig(_FilterConfig):
    """A single compare with the nearest texel."""

    type: Literal["nearest"] = "nearest"
    builds: ClassVar[str] = "Nearest"

    @property
    def looks_up_nearest(self) -> bool:
        return True


class BilinearConfig(_FilterConfig):
    """Bilinear interpolation of four compares."""

    type: Literal["bilinear"] = "bilinear"
    builds: ClassVar[str] = "Bilinear"
    beyond_radius: ClassVar[float] = 0.5


class FourTapConfig(_FilterConfig):
    """Four bilinear taps on the diagonals."""

    type: Literal["four_tap"] = "four_tap"
    radius: Radius = Field(default=1.0, ge=0, description="distance of the taps from the centre, in texels")
    builds: ClassVar[str] = "FourTap"
    beyond_radius: ClassVar[float] = 0.5


class PercentageCloserConfig(_FilterConfig):
    """A box filter with fractional edges."""

    type: Literal["pcf"] = "pcf"
    radius: UnrolledRadius = Field(default=2.0, ge=0, description="half the box's width, in texels")
    builds: ClassVar[str] = "PercentageCloser"
    grows_with_radius: ClassVar[bool] = True


class TentConfig(_FilterConfig):
    """A tent filter, with weights that fall off linearly from the centre."""

    type: Literal["tent"] = "tent"
    radius: UnrolledRadius = Field(default=2.0, ge=0, description="half the tent's width, in texels")
    builds: ClassVar[str] = "Tent"
    grows_with_radius: ClassVar[bool] = True


class CastanoConfig(_FilterConfig):
    """A fixed kernel evaluated with few bilinear taps."""

    type: Literal["castano"] = "castano"
    size: Annotated[Literal[3, 5, 7], Unit("texels")] = Field(default=5, description="width of the kernel, in texels")
    builds: ClassVar[str] = "Castano"

    @property
    def reach(self) -> float:
        return (self.size + 1) / 2


class SeparableConfig(_FilterConfig):
    """A symmetric kernel with given weights, the same along both axes."""

    type: Literal["separable"] = "separable"
    weights: Annotated[
        tuple[Annotated[float, Field(ge=0, le=1000)], ...], as_list, Form("a list of weights"), Fitted()
    ] = Field(
        default=(0.75, 0.25),
        min_length=1,
        max_length=16,
        description="weights of the bilinear compares 1, 2, ... texels from the middle, whose weight is 1",
    )
    builds: ClassVar[str] = "Separable"

    @property
    def reach(self) -> float:
        return len(self.weights) + 1.0


class PatternedConfig(_FilterConfig):
    """A filter whose taps follow a pattern, a different one for each pixel of a tile."""

    pattern: Literal["stratified", "uniform", "poisson", "vogel", "sobol", "halton"] = Field(
        default="stratified", description="how the taps are distributed on a disk"
    )
    samples: Annotated[int, Unit("taps per pixel")] = Field(default=32, ge=1, le=4096, description="taps per pixel")
    pattern_size: Annotated[int, Unit("pixels")] = Field(
        default=8, ge=1, le=256, description="width of the tile of patterns, in pixels; default: 8, or 1 for vogel"
    )
    rotated: bool = Field(
        default=False, description="whether each pixel also rotates its pattern; default: false, or true for vogel"
    )

    def faults(self) -> Iterator[Conflict]:
        taps = self.samples * self.pattern_size**2
        if taps > MOST_TAPS:
            message = f"is {self.samples} with pattern_size {self.pattern_size}, which makes {taps:,} taps per tile"
            expected = f"at most {MOST_TAPS:,}, which take seconds to generate"
            yield ("samples",), fault(message, expected, "lower one of them")

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"pattern_size": 1, "rotated": True, **data} if data.get("pattern") == "vogel" else data


class RandomDiskConfig(PatternedConfig):
    """Taps on a disk."""

    type: Literal["random_disk"] = "random_disk"
    radius: Radius = Field(default=2.0, ge=0, description="radius of the disk, in texels")
    lookup: Literal["bilinear", "nearest"] = Field(default="bilinear", description="how each tap reads the map")
    early_out: bool = Field(
        default=False, description="whether to skip the other taps where the first few are all lit or all shadowed"
    )
    builds: ClassVar[str] = "RandomDisk"
    beyond_radius: ClassVar[float] = 0.5

    @property
    def looks_up_nearest(self) -> bool:
        return self.lookup == "nearest"


class PercentageCloserSoftConfig(PatternedConfig):
    """A disk as wide as the penumbra, which is estimated by a blocker search."""

    type: Literal["pcss"] = "pcss"
    light_size: Annotated[float | None, Fitted()] = Field(
        default=None,
        ge=0,
        le=FARTHEST,
        description="light's radius in world units, or half a directional light's angle in degrees; "
        "default: the light's own",
    )
    search_samples: Annotated[int, Unit("taps per pixel")] = Field(
        default=16, ge=1, le=4096, description="taps per pixel of the blocker search"
    )
    min_radius: Radius = Field(default=0.0, ge=0, description="least radius of the disk, in texels")
    max_radius: Texels = Field(default=32.0, ge=0, description="greatest radius of disk and blocker search, in texels")
    builds: ClassVar[str] = "PercentageCloserSoft"
    radius_key: ClassVar[str] = "max_radius"
    beyond_radius: ClassVar[float] = 0.5

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from ordered(cls, data, "min_radius", "max_radius", equal=True)


class _PrefilteredConfig(_FilterConfig):
    """A map that is blurred before it is sampled. The compare is ignored."""

    radius: UnrolledRadius = Field(default=2.0, ge=0, description="radius of the blur, in texels")
    kernel: Literal["box", "tent", "gaussian"] = Field(default="box", description="shape of the blur")
    light_bleeding: Annotated[float, Fitted()] = Field(
        default=0.0, ge=0, le=0.99, description="visibility up to which a receiver counts as dark"
    )
    grows_with_radius: ClassVar[bool] = True
    beyond_radius: ClassVar[float] = 0.5


class VarianceConfig(_PrefilteredConfig):
    """Chebyshev's bound from the mean of depth and its square."""

    type: Literal["vsm"] = "vsm"
    least_variance: LeastVariance = Field(default=1e-6, ge=1e-12, le=1, description=_LEAST_VARIANCE)
    builds: ClassVar[str] = "VarianceShadowMap"


class ExponentialConfig(_PrefilteredConfig):
    """Exponential of depth, which is blurred independently of the receiver's depth."""

    type: Literal["esm"] = "esm"
    exponent: Annotated[float, Fitted()] = Field(
        default=80.0, ge=0, le=80, description="steepness of the falloff behind an occluder, per depth from near to far"
    )
    builds: ClassVar[str] = "ExponentialShadowMap"


class ExponentialVarianceConfig(_PrefilteredConfig):
    """The lesser of Chebyshev's bounds for two exponentials of depth."""

    type: Literal["evsm"] = "evsm"
    positive_exponent: Annotated[float, Fitted()] = Field(
        default=40.0, ge=1e-3, le=42, description="exponent of the positive warp, which separates overlapping occluders"
    )
    negative_exponent: Annotated[float, Fitted()] = Field(
        default=5.0,
        ge=1e-3,
        le=42,
        description="exponent of the negative warp, which separates receivers from deeper surfaces",
    )
    least_variance: LeastVariance = Field(default=1e-6, ge=1e-12, le=1, description=_LEAST_VARIANCE)
    builds: ClassVar[str] = "ExponentialVarianceShadowMap"


class MomentsConfig(_PrefilteredConfig):
    """Hamburger's bound from four moments of depth."""

    type: Literal["msm"] = "msm"
    moment_bias: Annotated[float, Fitted()] = Field(
        default=3e-6, ge=1e-7, le=1, description="weight of the safe moments blended in against rounding"
    )
    builds: ClassVar[str] = "MomentShadowMap"


FilterConfig = Annotated[
    Annotated[NearestConfig, Tag("nearest")]
    | Annotated[BilinearConfig, Tag("bilinear")]
    | Annotated[FourTapConfig, Tag("four_tap")]
    | Annotated[PercentageCloserConfig, Tag("pcf")]
    | Annotated[TentConfig, Tag("tent")]
    | Annotated[CastanoConfig, Tag("castano")]
    | Annotated[SeparableConfig, Tag("separable")]
    | Annotated[RandomDiskConfig, Tag("random_disk")]
    | Annotated[PercentageCloserSoftConfig, Tag("pcss")]
    | Annotated[VarianceConfig, Tag("vsm")]
    | Annotated[ExponentialConfig, Tag("esm")]
    | Annotated[ExponentialVarianceConfig, Tag("evsm")]
    | Annotated[MomentsConfig, Tag("msm")],
    by_type("random_disk"),
]
