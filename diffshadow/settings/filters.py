"""Settings of the filters, which average compares. A class has the name of its module in `shadow`."""

from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Len

from ._settings import At, Fitted, Form, Limits, Settings, Unit
from .patterns import Samples
from .quantities import FARTHEST, Texels

Shape = Literal["box", "tent", "gaussian"]
"""Shapes of a kernel. All end at the radius: half the box's width, half the tent's, or three standard deviations of the
Gaussian."""
TapMode = Literal["nearest", "bilinear"]
KernelSize = Literal[3, 5, 7]

Radius = Annotated[Texels, Fitted()]
# The radius of a kernel that is unrolled texel by texel. Compilation takes minutes for much larger radii.
KernelRadius = Annotated[float, Limits(0, 128), Unit("texels"), Fitted()]
_LeastVariance = Annotated[
    float,
    Limits(1e-12, 1),
    Fitted(),
    "minimum variance of depth, where depth is 0 at the map's near plane and 1 at its far plane",
]


class Filter(Settings):
    """How compares are averaged."""

    type: Any
    radius_key: ClassVar[str] = "radius"
    """The key that sets the reach of its taps."""
    beyond_radius: ClassVar[float] = 0.0
    """The distance beyond its radius at which the filter reads the map, in texels."""
    grows_with_radius: ClassVar[bool] = False
    """Whether the module takes an upper bound of its radius."""

    @property
    def looks_up_nearest(self) -> bool:
        """Whether it reads nearest texels. It then has no gradient with respect to the position that it reads."""
        return False

    @property
    def reach(self) -> float:
        """The distance from the receiver's texel coordinates at which the filter reads the map, in texels."""
        return self.reach_of(self)

    @classmethod
    def reach_of(cls, values: Any) -> Any:
        """The reach for other `values` of its keys, such as the values of a module."""
        return getattr(values, cls.radius_key, 0.0) + cls.beyond_radius


class Nearest(Filter):
    """A single compare with the nearest texel."""

    type: Literal["nearest"] = "nearest"

    @property
    def looks_up_nearest(self) -> bool:
        return True


class Bilinear(Filter):
    """Bilinear interpolation of four compares."""

    type: Literal["bilinear"] = "bilinear"
    beyond_radius: ClassVar[float] = 0.5


class FourTap(Filter):
    """Four bilinear taps on the diagonals."""

    type: Literal["four_tap"] = "four_tap"
    radius: Annotated[Radius, "distance of the taps from the centre, in texels"] = 1.0
    beyond_radius: ClassVar[float] = 0.5


class Sized(Filter):
    """A kernel over all texels within its radius."""

    radius: Annotated[KernelRadius, "half the kernel's width, in texels"] = 2.5
    grows_with_radius: ClassVar[bool] = True


class PercentageCloser(Sized):
    """A box filter with fractional edges."""

    type: Literal["pcf"] = "pcf"


class Tent(Sized):
    """A tent filter, with weights that fall off linearly from the centre."""

    type: Literal["tent"] = "tent"


class Castano(Filter):
    """A fixed kernel evaluated with few bilinear taps."""

    type: Literal["castano"] = "castano"
    size: Annotated[KernelSize, Unit("texels"), "width of the kernel, in texels"] = 5

    @classmethod
    def reach_of(cls, values: Any) -> float:
        return (values.size + 1) / 2


class Separable(Filter):
    """A symmetric kernel with given weights, the same along both axes."""

    type: Literal["separable"] = "separable"
    # The number of taps grows with the square of the number of weights.
    weights: Annotated[
        tuple[Annotated[float, Limits(0, 1000)], ...],
        Len(1, 16),
        Form("a list of 1 to 16 weights"),
        Fitted(),
        "weights of the bilinear compares 1, 2, ... texels from the centre, relative to the weight at the centre",
    ] = (0.75, 0.25)

    @classmethod
    def reach_of(cls, values: Any) -> float:
        return len(values.weights) + 1.0


class RandomDisk(Filter):
    """Taps on a disk."""

    type: Literal["random_disk"] = "random_disk"
    radius: Annotated[Radius, "radius of the disk, in texels"] = 2.0
    lookup: Annotated[TapMode, "how each tap reads the map"] = "bilinear"
    early_out: Annotated[bool, "whether to skip the other taps if the first few are all lit or all shadowed"] = False
    beyond_radius: ClassVar[float] = 0.5

    @property
    def looks_up_nearest(self) -> bool:
        return self.lookup == "nearest"


class PercentageCloserSoft(Filter):
    """A disk as wide as the penumbra, which is estimated by a blocker search."""

    type: Literal["pcss"] = "pcss"
    light_size: Annotated[
        float | None,
        Limits(0, FARTHEST),
        Fitted(),
        "light's radius in world units, or half a directional light's angle in degrees; default: the light's own",
    ] = None
    search_samples: Annotated[Samples, At(), "taps per pixel of the blocker search"] = 16
    min_radius: Annotated[Radius, "least radius of the disk, in texels"] = 0.0
    max_radius: Annotated[Texels, "greatest radius of disk and blocker search, in texels"] = 32.0
    radius_key: ClassVar[str] = "max_radius"
    beyond_radius: ClassVar[float] = 0.5
    ascending = (("min_radius", "max_radius", True),)


class Prefiltered(Filter):
    """A map that is blurred before it is sampled. The compare is ignored."""

    radius: Annotated[KernelRadius, "radius of the blur, in texels"] = Sized.radius
    kernel: Annotated[Shape, "shape of the blur"] = "box"
    light_bleeding: Annotated[float, Limits(0, 0.99), Fitted(), "visibility up to which receivers count as dark"] = 0.0
    beyond_radius: ClassVar[float] = 0.5
    grows_with_radius: ClassVar[bool] = True


class VarianceShadowMap(Prefiltered):
    """Chebyshev's bound from the mean of depth and its square."""

    type: Literal["vsm"] = "vsm"
    least_variance: _LeastVariance = 1e-6


class ExponentialShadowMap(Prefiltered):
    """Exponential of depth, which is blurred independently of the receiver's depth."""

    type: Literal["esm"] = "esm"
    # e^-80 is still a normal number in 32 bits; e^-88 is not.
    exponent: Annotated[
        float, Limits(0, 80), Fitted(), "steepness of the falloff behind an occluder, per depth from near to far"
    ] = 80.0


# e^84, the square of the largest warped depth, is still finite in float32.
_Exponent = Annotated[float, Limits(1e-3, 42), Fitted()]


class ExponentialVarianceShadowMap(Prefiltered):
    """The smaller of Chebyshev's bounds for two exponentials of depth."""

    type: Literal["evsm"] = "evsm"
    positive_exponent: Annotated[_Exponent, "exponent of the positive warp; it separates overlapping occluders"] = 40.0
    negative_exponent: Annotated[
        _Exponent, "exponent of the negative warp; it separates receivers from deeper surfaces"
    ] = 5.0
    least_variance: _LeastVariance = 1e-6


class MomentShadowMap(Prefiltered):
    """Hamburger's bound from four moments of depth."""

    type: Literal["msm"] = "msm"
    moment_bias: Annotated[
        float, Limits(1e-7, 1), Fitted(), "weight of the safe moments blended in against rounding"
    ] = 3e-6
