"""Sections of the shadow technique, the shadow map and the compare."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from ._biases import MOST_LAYERS
from ._engines import BabylonJsConfig, ThreeJsConfig
from ._section import (
    MOST_FACTOR,
    Conflict,
    Fitted,
    Form,
    Fraction,
    Pair,
    Section,
    Size,
    Texels,
    Unit,
    WorldUnits,
    as_list,
    by_type,
    exclusive,
    fault,
)

LEAST_WIDTH = 1e-6
"""The least width of a soft compare, in texels: far below the resolution of float32 depth, and 1 / width is finite."""

MOST_ACROSS = 1024
"""The most pages along a side of a virtual map: tables have an entry for each page."""

SPARE = 1.0
"""Texels of a map's margin beyond the filter's reach: for what is within half a texel of the border."""

SoftKernel = Literal["logistic", "linear", "smoothstep", "gaussian", "exponential"]
"""Shape of a soft compare's step."""


# The side of a cascade is at most a thousand times that of another.
_Share = Annotated[float, Field(ge=1e-3, le=1e3)]


class MappedConfig(Section):
    """Shadow maps, set up by the sections shadow_map, bias, compare and filter."""

    @property
    def layers(self) -> int:
        """The number of maps of a light that has one view."""
        return 1


class ShadowMappingConfig(MappedConfig):
    """Shadow maps, set up by the sections shadow_map, bias, compare and filter."""

    type: Literal["shadow_map"] = "shadow_map"


class CascadesConfig(MappedConfig):
    """Cascaded shadow maps: a map for each of several ranges of the camera's depth, under directional lights."""

    type: Literal["cascades"] = "cascades"
    count: int = Field(default=4, ge=1, le=MOST_LAYERS, description="number of cascades")
    logarithmic: Annotated[Fraction, Fitted(searched=True)] = Field(
        default=0.5,
        description="spacing of the slices: from 0 for equal depths to 1 for equal ratios of depths",
    )
    distances: (
        Annotated[
            tuple[Annotated[WorldUnits, Field(gt=0)], ...],
            as_list,
            Form("a list of depths"),
            Unit("world units"),
            Fitted(searched=True),
        ]
        | None
    ) = Field(
        default=None,
        min_length=1,
        max_length=MOST_LAYERS,
        description="end of each slice along the camera's axis, in world units; instead of count and logarithmic",
    )
    shares: (
        Annotated[tuple[_Share, ...], as_list, Form("a list of shares, relative to one another"), Fitted(searched=True)]
        | None
    ) = Field(
        default=None,
        min_length=1,
        max_length=MOST_LAYERS,
        description="how many texels each cascade has, relative to the others, of count times shadow_map.resolution; "
        "default: as many",
    )
    depths: Literal["camera", "surface"] = Field(
        default="camera", description="what is sliced: from the camera's near to its far, or the depths that it sees"
    )
    shadow_distance: Annotated[WorldUnits | None, Field(gt=0)] = Field(
        default=None, description="depth beyond which nothing is shadowed, in world units; default: the camera's far"
    )
    fit: Literal["cascade", "scene"] = Field(
        default="cascade", description="what a cascade contains: its slice, or all that lies before its slice's end"
    )
    stabilize: bool = Field(
        default=True, description="whether texels stay where they are on surfaces as the camera moves and turns"
    )
    select: Literal["interval", "map"] = Field(
        default="interval", description="a receiver's cascade: that of its depth, or the first whose map contains it"
    )
    blend: Annotated[Fraction, Fitted()] = Field(
        default=0.1, description="part of each slice over which its cascade fades into the next"
    )
    max_blend: Fraction | None = Field(
        default=None,
        description="greatest blend, which maps are drawn for; default: blend, in a fit its upper bound",
    )
    fade: Fraction = Field(
        default=0.0, description="part of the last slice over which shadows fade out before the shadow distance"
    )
    margin: Annotated[Texels | None, Field(ge=0)] = Field(
        default=None, description="how far maps extend beyond their slices, in texels; default: the filter's reach"
    )

    @property
    def layers(self) -> int:
        return self.count if self.distances is None else len(self.distances)

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from exclusive(data, "distances", "shadow_distance")
        if data.get("distances") is not None and data.get("depths", "camera") != "camera":
            yield ("depths",), fault("is surface, and distances are given", "camera", "remove depths, or distances")

    def faults(self) -> Iterator[Conflict]:
        given = self.distances or ()
        for i, (before, after) in enumerate(itertools.pairwise(given)):
            if after <= before:
                message = f"is {after:g}, after {before:g}"
                yield ("distances", i + 1), fault(message, "increasing depths", "sort them, without repetitions")
        if self.max_blend is not None and self.blend > self.max_blend:
            yield ("blend",), fault(f"is {self.blend:g}", f"at most max_blend, {self.max_blend:g}", "lower it")
        if self.shares is not None and len(self.shares) != self.layers:
            message = f"has {len(self.shares)} shares, for {self.layers} cascades"
            yield ("shares",), fault(message, "as many", "give one for each cascade")


class ShadowVolumesConfig(Section):
    """Hard shadows from shadow volumes, without a map."""

    type: Literal["shadow_volumes"] = "shadow_volumes"
    method: Literal["z_fail", "z_pass"] = Field(
        default="z_fail", description="which volume faces are counted: those behind the surface, or in front of it"
    )


class IrregularZBufferConfig(Section):
    """Hard shadows at the surface's own points, by testing triangles against them in the light's view."""

    type: Literal["irregular_z_buffer"] = "irregular_z_buffer"


class ProjectiveTextureConfig(Section):
    """The casters' silhouette, drawn into a texture and projected onto the meshes that do not cast."""

    type: Literal["projective_texture"] = "projective_texture"
    resolution: Annotated[Size, Unit("texels")] = Field(default=(512, 512), description="[height, width] in texels")
    blur: Annotated[float, Unit("texels")] = Field(
        default=0.0, ge=0, le=256, description="radius of the texture's blur, in texels"
    )
    kernel: Literal["box", "tent", "gaussian"] = Field(default="box", description="shape of the blur")


class PerspectiveWarpConfig(MappedConfig):
    """One map under each directional light, warped so that what is close to the camera gets more texels."""

    type: Literal["perspective_warp"] = "perspective_warp"
    method: Literal["lispsm", "perspective", "trapezoidal"] = Field(
        default="lispsm", description="how the warp's strength is found; lispsm has the least worst aliasing"
    )
    strength: Annotated[float | None, Field(ge=0, le=MOST_FACTOR), Fitted(searched=True)] = Field(
        default=None, description="the warp's strength, 0 for none; default: what method finds"
    )
    focus: Annotated[float, Field(gt=0, le=1), Fitted(searched=True)] = Field(
        default=0.3, description="part of what is seen, at the camera, that takes 80 % of a trapezoidal map"
    )
    shadow_distance: Annotated[WorldUnits | None, Field(gt=0)] = Field(
        default=None, description="depth beyond which nothing is shadowed, in world units; default: the camera's far"
    )
    depths: Literal["camera", "surface"] = Field(
        default="camera",
        description="what the map shows: all depths of the camera, or those that it sees; default: camera, or surface "
        "for perspective",
    )
    margin: Annotated[Texels | None, Field(ge=0)] = Field(
        default=None, description="how far the map extends beyond what is seen, in texels; default: the filter's reach"
    )

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"depths": "surface", **data} if data.get("method") == "perspective" else data


class ResolutionMatchedConfig(MappedConfig):
    """A virtual map under each directional light, of which the pages that the camera needs are drawn, at the resolution
    of the screen."""

    type: Literal["resolution_matched"] = "resolution_matched"
    page: Annotated[int, Unit("texels")] = Field(
        default=64, ge=16, le=1024, description="side of a page without its gutter, a power of two, in texels"
    )
    finest: Annotated[int, Unit("texels")] = Field(
        default=16384, ge=32, le=65536, description="side of the map at its finest level, a power of two, in texels"
    )
    norm: Literal["area", "worst"] = Field(
        default="area", description="what of a texel on the screen is matched to a pixel: its area, or longest extent"
    )
    level_bias: Annotated[float, Fitted(searched=True)] = Field(
        default=0.0,
        ge=-16,
        le=16,
        description="added to levels, -1 halves the size of texels on the screen; raised if the map is too small",
    )
    shadow_distance: Annotated[WorldUnits | None, Field(gt=0)] = Field(
        default=None, description="depth beyond which nothing is shadowed, in world units; default: the camera's far"
    )
    margin: Annotated[Texels | None, Field(ge=0)] = Field(
        default=None, description="width of the gutter around pages, in texels; default: the filter's reach"
    )

    def faults(self) -> Iterator[Conflict]:
        for key, value in (("page", self.page), ("finest", self.finest)):
            if value & (value - 1):
                below = 1 << (value.bit_length() - 1)
                yield (key,), fault(f"is {value}", "a power of two", f"set it to {below} or {2 * below}")
        if not 2 <= self.finest / self.page <= MOST_ACROSS:
            message = f"is {self.finest}, and pages are {self.page} texels wide"
            yield ("finest",), fault(message, f"from 2 to {MOST_ACROSS} pages", "change it, or page")
        if self.margin is not None and self.margin > self.page // 2:
            message = f"is {self.margin:g}, and pages are {self.page} texels wide"
            yield ("margin",), fault(message, "at most half of that", "lower it, or enlarge page")


TechniqueConfig = Annotated[
    Annotated[ShadowMappingConfig, Tag("shadow_map")]
    | Annotated[CascadesConfig, Tag("cascades")]
    | Annotated[PerspectiveWarpConfig, Tag("perspective_warp")]
    | Annotated[ResolutionMatchedConfig, Tag("resolution_matched")]
    | Annotated[ShadowVolumesConfig, Tag("shadow_volumes")]
    | Annotated[IrregularZBufferConfig, Tag("irregular_z_buffer")]
    | Annotated[ProjectiveTextureConfig, Tag("projective_texture")]
    | Annotated[ThreeJsConfig, Tag("three.js")]
    | Annotated[BabylonJsConfig, Tag("babylon.js")],
    by_type("shadow_map"),
]


class ShadowMapConfig(Section):
    """The depth map drawn from the light."""

    resolution: Annotated[Size, Unit("texels")] = Field(default=(1024, 1024), description="[height, width] in texels")
    cull: Literal["none", "back", "front"] = Field(
        default="none", description="faces left out of the map; front works for closed casters only"
    )
    depth_format: Literal["float32", "unorm24", "unorm16"] = Field(
        default="float32", description="storage format of depth"
    )
    polygon_offset: Pair | None = Field(
        default=None, description="[factor, units] of a bias stored in the map, as in OpenGL; default: none"
    )
    depth_layer: Literal["nearest", "midpoint", "second"] = Field(
        default="nearest", description="which depth is stored: of the nearest surface, the second, or midway between"
    )
    silhouettes: bool | None = Field(
        default=None,
        description="whether texels store where silhouettes cross them; default: in fits that move lights or meshes",
    )


class HardCompareConfig(Section):
    """A binary compare: lit or shadowed."""

    type: Literal["hard"] = "hard"
    operator: Literal["less_equal", "less"] = Field(
        default="less_equal", description="compare of receiver depth against stored depth"
    )


class SoftCompareConfig(Section):
    """A compare with a smooth step, so that it has a gradient."""

    type: Literal["soft"] = "soft"
    width: Texels = Field(default=0.5, ge=LEAST_WIDTH, description="width of the step, in texels of depth")
    kernel: SoftKernel = Field(default="logistic", description="shape of the step")


CompareConfig = Annotated[
    Annotated[HardCompareConfig, Tag("hard")] | Annotated[SoftCompareConfig, Tag("soft")], by_type("hard")
]
