"""Settings of techniques and of the layouts of their maps. A class has the name of its module in `shadow`."""

from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Len

from ._settings import Fitted, Form, Limits, Settings, Unit
from .filters import Shape
from .quantities import MAX_FACTOR, MAX_LAYERS, MAX_VIRTUAL, Distance, Fraction, Size, Texels

DepthRange = Literal["camera", "surface"]
"""The depths that a layout fits maps to: from the camera's near to far, or the depths of the visible surface."""
CascadeFit = Literal["cascade", "scene"]
CascadeSelection = Literal["interval", "map"]
"""The cascade of a point: by its depth, or the first whose map contains it."""
WarpMethod = Literal["lispsm", "perspective", "trapezoidal"]
"""The warp of a light's view: light space perspective, perspective, or trapezoidal shadow maps."""
LevelNorm = Literal["area", "worst"]
"""The size of a texel on the screen that is matched to a pixel: its area, or its longest extent."""
VolumeMethod = Literal["z_fail", "z_pass"]
ShaderLanguage = Literal["glsl", "wgsl", "hlsl"]
"""The shader languages: GLSL 3.30 or ES 3.00, WGSL, HLSL of shader model 5."""

MARGIN = 8.0
"""The margin of a layout's maps without a filter of known reach, in texels."""
MAX_LEVEL_BIAS = 16.0
SPARE = 1.0
"""Texels of a map's margin beyond the filter's reach, for points within half a texel of the border."""
MAX_ACROSS = 1024
"""The maximum number of pages along a side of a virtual map. Tables have an entry for each page."""

_ShadowDistance = Annotated[
    Distance | None,
    "depth beyond which nothing is shadowed, in world units; default: the camera's far",
]


class Technique(Settings):
    """How shadows are drawn."""

    type: Any
    is_whole: ClassVar[bool] = False
    """Whether all of its numbers are its own, so that the sections bias and filter change nothing."""


class OwnTechnique(Technique):
    """A user's technique."""

    is_whole = True


class Mapped(Technique):
    """Shadow maps, set up by the sections shadow_map, bias, compare and filter."""

    @property
    def layers(self) -> int:
        """The number of maps of a light that has one view."""
        return 1


class SingleMap(Mapped):
    """Shadow maps, set up by the sections shadow_map, bias, compare and filter."""

    type: Literal["shadow_map"] = "shadow_map"


class FittedLayout(Mapped):
    """Maps that are fitted to the camera's view, under directional lights."""

    shadow_distance: _ShadowDistance = None
    margin: Annotated[
        Texels | None, "margin of maps beyond the visible surface, in texels; default: the filter's reach"
    ] = None


class Cascades(FittedLayout):
    """Cascaded shadow maps: a map for each of several ranges of the camera's depth, under directional lights."""

    type: Literal["cascades"] = "cascades"
    distances: Annotated[
        tuple[Distance, ...] | None,
        Len(1, MAX_LAYERS),
        Form(f"a list of 1 to {MAX_LAYERS} depths"),
        Unit("world units"),
        Fitted(searched=True),
        "end of each slice along the camera's axis, in world units; instead of count and logarithmic",
    ] = None
    count: Annotated[int, Limits(1, MAX_LAYERS), "number of cascades"] = 4
    logarithmic: Annotated[
        Fraction,
        Fitted(searched=True),
        "spacing of the slices: from 0 for equal depths to 1 for equal ratios of depths",
    ] = 0.5
    # The side of a cascade is at most a thousand times another cascade's side.
    shares: Annotated[
        tuple[Annotated[float, Limits(1e-3, 1e3)], ...] | None,
        Len(1, MAX_LAYERS),
        Form(f"a list of 1 to {MAX_LAYERS} shares, relative to one another"),
        Fitted(searched=True),
        "share of each cascade in the texels of count times shadow_map.resolution, relative to the others; default: "
        "equal",
    ] = None
    depths: Annotated[
        DepthRange, "depths that are sliced: the camera's near to its far, or the range of the visible surface"
    ] = "camera"
    fit: Annotated[CascadeFit, "content of a cascade: its slice, or everything up to its end"] = "cascade"
    stabilize: Annotated[bool, "whether texels stay in place on surfaces when the camera moves and turns"] = True
    select: Annotated[CascadeSelection, "a receiver's cascade: by its depth, or the first whose map contains it"] = (
        "interval"
    )
    blend: Annotated[Fraction, Fitted(), "fraction of each slice over which its cascade fades into the next"] = 0.1
    max_blend: Annotated[
        Fraction | None, "greatest blend for which maps are drawn; default: blend, in a fit its upper bound"
    ] = None
    fade: Annotated[Fraction, "fraction of the last slice over which shadows fade out before the shadow distance"] = 0.0
    ascending = (("blend", "max_blend", True),)

    @property
    def layers(self) -> int:
        return self.count if self.distances is None else len(self.distances)


class PerspectiveWarp(FittedLayout):
    """One map under each directional light, warped so that surfaces close to the camera get more texels."""

    type: Literal["perspective_warp"] = "perspective_warp"
    method: Annotated[WarpMethod, "method for the warp's strength; lispsm has the lowest maximum of aliasing"] = (
        "lispsm"
    )
    strength: Annotated[
        float | None,
        Limits(0, MAX_FACTOR),
        Fitted(searched=True),
        "the warp's strength, 0 for none; default: by method",
    ] = None
    focus: Annotated[
        float,
        Limits(0, 1, above_low=True),
        Fitted(searched=True),
        "fraction of the view, at the camera, that gets 80 % of a trapezoidal map",
    ] = 0.3
    depths: Annotated[
        DepthRange | None,
        "depths that the map shows: the camera's whole range, or the range of the visible surface; "
        "default: camera, or surface for perspective",
    ] = None


class ResolutionMatched(FittedLayout):
    """A virtual map under each directional light. Only the pages that the camera needs are drawn, at the resolution of
    the screen."""

    type: Literal["resolution_matched"] = "resolution_matched"
    page: Annotated[
        int, Limits(16, 1024), Unit("texels"), "side of a page without its gutter, a power of two, in texels"
    ] = 64
    finest: Annotated[
        int, Limits(32, MAX_VIRTUAL), Unit("texels"), "side of the map at its finest level, a power of two, in texels"
    ] = 16384
    norm: Annotated[
        LevelNorm, "measure of a texel on the screen that matches a pixel: its area, or its longest extent"
    ] = "area"
    level_bias: Annotated[
        float,
        Limits(-MAX_LEVEL_BIAS, MAX_LEVEL_BIAS),
        Fitted(searched=True),
        "added to levels, -1 halves the size of texels on the screen; raised if the map is too small",
    ] = 0.0


class ShadowVolumes(Technique):
    """Hard shadows from shadow volumes, without a map."""

    type: Literal["shadow_volumes"] = "shadow_volumes"
    method: Annotated[
        VolumeMethod, "which faces of volumes count: faces behind the surface, or faces in front of it"
    ] = "z_fail"


class IrregularZBuffer(Technique):
    """Hard shadows at the surface's own points. Triangles are tested against the points in the light's view."""

    type: Literal["irregular_z_buffer"] = "irregular_z_buffer"


class ProjectiveShadow(Technique):
    """The casters' silhouette, drawn into a texture and projected onto the meshes that do not cast."""

    type: Literal["projective_texture"] = "projective_texture"
    resolution: Annotated[Size, Unit("texels"), "[height, width] in texels"] = (512, 512)
    blur: Annotated[float, Limits(0, 256), Unit("texels"), "radius of the texture's blur, in texels"] = 0.0
    kernel: Annotated[Shape, "shape of the blur"] = "box"
