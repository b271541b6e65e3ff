"""Settings of the techniques that draw the shadows of real-time engines, with the engines' names and units."""

from typing import Annotated, ClassVar, Literal

from ._settings import Fitted, Form, Limits, Unit
from .quantities import FARTHEST, Fraction, Texels
from .scene import LightKind
from .techniques import Technique

Side = Literal["front", "back", "double"]
"""The faces of a mesh that an engine draws."""
Sides = Side | tuple[Side, ...]
"""One side for all meshes, or one for each."""
ShadowSides = Sides | tuple[Side | None, ...]
"""One side for all meshes, or one for each. `None` for the engine's choice."""
OTHER_SIDE: dict[Side, Side] = {"front": "back", "back": "front", "double": "double"}
"""The side that three.js draws into shadow maps for each side of a material, from the renderer's table."""
ShadowType = Literal["BasicShadowMap", "PCFShadowMap", "PCFSoftShadowMap", "VSMShadowMap"]
BabylonFilter = Literal[
    "NONE",
    "POISSONSAMPLING",
    "EXPONENTIALSHADOWMAP",
    "BLUREXPONENTIALSHADOWMAP",
    "CLOSEEXPONENTIALSHADOWMAP",
    "BLURCLOSEEXPONENTIALSHADOWMAP",
    "PCF",
    "PCSS",
]
"""A `FILTER_` constant of the shadow generator, without that prefix."""
BabylonQuality = Literal["HIGH", "MEDIUM", "LOW"]
"""A `QUALITY_` constant of the shadow generator."""
PlayCanvasShadow = Literal["PCF1_32F", "PCF3_32F", "PCF5_32F"]
"""A `SHADOW_` constant of PlayCanvas, without that prefix."""
BevyFilter = Literal["Gaussian", "Hardware2x2"]
"""A `ShadowFilteringMethod` of Bevy."""
GodotQuality = Literal["HARD", "SOFT_VERY_LOW", "SOFT_LOW", "SOFT_MEDIUM", "SOFT_HIGH", "SOFT_ULTRA"]
"""A `RenderingServer.SHADOW_QUALITY_` constant of Godot, without that prefix."""
GodotMode = Literal["SHADOW_ORTHOGONAL", "SHADOW_PARALLEL_4_SPLITS"]
"""A `directional_shadow_mode` of Godot."""
EngineName = Literal[
    "godot", "bevy", "filament", "unity", "three.js", "babylon.js", "playcanvas", "godot_compatibility"
]
"""An engine's name on the command line."""
ENGINES: dict[EngineName, str] = {
    "godot": "Godot 4",
    "bevy": "Bevy",
    "filament": "Filament",
    "unity": "Unity URP",
    "three.js": "three.js",
    "babylon.js": "Babylon.js",
    "playcanvas": "PlayCanvas",
    "godot_compatibility": "Godot 4 Compatibility",
}
"""The engines' names in sentences."""
POLYGON_OFFSETS: dict[EngineName, tuple[float, float]] = {"filament": (2.0, 0.5), "unity": (2.5, 1.0)}
"""The factor and the units of the polygon offset that engines add to the bias of a light when they draw their maps."""
ImportedTechnique = Literal["three.js", "shadow_map", "playcanvas", "bevy", "godot_compatibility"]
"""The technique for a configuration from an engine's scene."""

_Sides = Annotated[Sides, Form("front, back or double, or a list with one of them for each mesh")]
_ShadowSides = Annotated[ShadowSides, Form("front, back or double, or a list with one of them or null for each mesh")]
# Window depth is from 0 to 1.
_Depth = Annotated[float, Limits(-1, 1), Fitted()]
_Length = Annotated[float, Limits(-FARTHEST, FARTHEST), Unit("world units")]


class Engine(Technique):
    """The shadows of an engine. Its map has the resolution of the section shadow_map. Filter, bias and compare are the
    engine's own.

    - `biases`: the keys of its depth bias and its normal bias; `bias_names`: the engine's names for them.
    - `follows_view`: whether the cameras of a directional light follow the view, so that texels have no fixed width.
    - `filter_key`: the key of its filter; `filters`: the filters that are fitted, for directional and spot lights and
      for point lights.
    - `kinds`: the kinds of lights that it draws.
    - `has_square_maps`: whether the maps of all lights must be square.
    - `default_size`: the default side of its maps, in texels.
    - `suffix`: suffix of a file in the language of the engine's users.
    """

    is_whole = True
    biases: ClassVar[tuple[str, str]] = ("bias", "normal_bias")
    bias_names: ClassVar[tuple[str, str]] = ("bias", "normalBias")
    follows_view: ClassVar[bool] = False
    filter_key: ClassVar[str]
    filters: ClassVar[tuple[str, ...]]
    point_filters: ClassVar[tuple[str, ...]]
    kinds: ClassVar[tuple[LightKind, ...]] = ("directional", "spot", "point")
    has_square_maps: ClassVar[bool] = False
    default_size: ClassVar[int]
    suffix: ClassVar[str] = "js"
    subpixels: Annotated[
        int,
        Limits(1, 1 << 16),
        "steps per texel at which the engine's rasterizer places vertices: 256 on most graphics hardware, 16 in "
        "Chromium without it",
    ] = 256


class ThreeJs(Engine):
    """The shadows of three.js r187, with the names, units and defaults of light.shadow and renderer.shadowMap."""

    filter_key = "shadow_type"
    filters = ("BasicShadowMap", "PCFShadowMap", "VSMShadowMap")
    # The engine does not draw VSM for a point light.
    point_filters = ("BasicShadowMap", "PCFShadowMap")
    default_size = 512

    type: Literal["three.js"] = "three.js"
    shadow_type: Annotated[ShadowType, "renderer.shadowMap.type"] = "PCFShadowMap"
    bias: Annotated[
        _Depth,
        Unit("window depth"),
        "light.shadow.bias: added to receivers' depth, so negative values lift them",
    ] = 0.0
    normal_bias: Annotated[_Length, Fitted(), "light.shadow.normalBias: shift of receivers along their normals"] = 0.0
    radius: Annotated[Texels, Fitted(), "light.shadow.radius: filter radius; no effect in BasicShadowMap"] = 1.0
    intensity: Annotated[Fraction, "light.shadow.intensity"] = 1.0
    blur_samples: Annotated[int, Limits(1, 256), "light.shadow.blurSamples, in VSMShadowMap"] = 8
    side: Annotated[_Sides, "material.side, for all meshes or for each"] = "front"
    shadow_side: Annotated[
        _ShadowSides | None,
        "material.shadowSide, for all meshes or for each; default, and null in a list: the opposite side, but the same "
        "side in VSMShadowMap",
    ] = None
    reversed_depth: Annotated[bool, "whether the renderer has reversedDepthBuffer"] = False


class BabylonJs(Engine):
    """The shadows of Babylon.js 9.34 (WebGL2), with the names, units and defaults of its ShadowGenerator. The map must
    be square."""

    filter_key = "filter"
    filters = ("NONE", "POISSONSAMPLING", "PCF", "PCSS")
    # Under a point light, the engine draws the others as POISSONSAMPLING.
    point_filters = ("NONE", "POISSONSAMPLING")
    has_square_maps = True
    default_size = 1024

    type: Literal["babylon.js"] = "babylon.js"
    filter: Annotated[BabylonFilter, "the generator's FILTER_ constant"] = "NONE"
    quality: Annotated[BabylonQuality, "filteringQuality, for filters PCF and PCSS"] = "HIGH"
    bias: Annotated[_Depth, Unit("parts of the depth range"), "bias: pushes casters away from the light"] = 5e-5
    normal_bias: Annotated[
        _Length,
        Fitted(searched=True),
        "normalBias: how far casters' vertices move against their normals",
    ] = 0.0
    darkness: Annotated[Fraction, "darkness: the visibility in full shadow"] = 0.0
    blur_scale: Annotated[
        float,
        Limits(0, 1024, above_low=True),
        Unit("texels"),
        Fitted(),
        "blurScale: radius of POISSONSAMPLING, or a map's size divided by its blur's size",
    ] = 2.0
    depth_scale: Annotated[
        float,
        Limits(0, 1000, above_low=True),
        Fitted(),
        "depthScale: steepness of exponential maps",
    ] = 50.0
    frustum_edge_falloff: Annotated[Fraction, "frustumEdgeFalloff: width of the border over which shadows fade out"] = (
        0.0
    )
    contact_hardening_light_size_uv_ratio: Annotated[
        Fraction, Fitted(), "contactHardeningLightSizeUVRatio: radius of PCSS divided by the map's width"
    ] = 0.1
    blur_kernel: Annotated[int, Limits(0, 256), "blurKernel, with use_kernel_blur"] = 1
    blur_box_offset: Annotated[int, Limits(0, 64), "blurBoxOffset, without use_kernel_blur"] = 1
    use_kernel_blur: Annotated[bool, "useKernelBlur: whether the blur is a Gaussian"] = False
    force_back_faces_only: Annotated[bool, "forceBackFacesOnly: whether only back faces cast"] = False
    back_face_culling: Annotated[
        bool | tuple[bool, ...],
        Form("true or false, or a list with one of them for each mesh"),
        "material.backFaceCulling, for all meshes or for each",
    ] = True
    float_maps: Annotated[bool, "usefullFloatFirst: floats rather than half floats in the map"] = False


class PlayCanvas(Engine):
    """The shadows of PlayCanvas 2.23 (WebGL2, without clustered lighting), with the names, units and defaults of its
    LightComponent. The map must be square."""

    biases = ("shadow_bias", "normal_offset_bias")
    bias_names = ("shadowBias", "normalOffsetBias")
    follows_view = True
    filter_key = "shadow_type"
    filters = ("PCF1_32F", "PCF3_32F", "PCF5_32F")
    # The engine draws PCF5 of a point light as PCF3.
    point_filters = ("PCF1_32F", "PCF3_32F")
    has_square_maps = True
    default_size = 1024

    type: Literal["playcanvas"] = "playcanvas"
    shadow_type: Annotated[PlayCanvasShadow, "shadowType, a SHADOW_ constant"] = "PCF3_32F"
    shadow_bias: Annotated[
        Fraction,
        Fitted(),
        "shadowBias: a tenth of the casters' polygon offset, or hundredths of a point light's range",
    ] = 0.05
    normal_offset_bias: Annotated[
        Fraction, Unit("world units"), Fitted(), "normalOffsetBias: shift of receivers along their normals"
    ] = 0.0
    shadow_intensity: Annotated[Fraction, "shadowIntensity"] = 1.0
    shadow_distance: Annotated[
        float, Limits(0, FARTHEST, above_low=True), Unit("world units"), "shadowDistance of a directional light"
    ] = 40.0
    num_cascades: Annotated[int, Limits(1, 4), "numCascades of a directional light"] = 1
    cascade_distribution: Annotated[
        Fraction, "cascadeDistribution: from ends of cascades at equal parts to ends at equal ratios"
    ] = 0.5
    side: Annotated[_Sides, "faces that material.cull keeps, for all meshes or for each"] = "front"


_Distance = Annotated[float, Limits(0, FARTHEST, above_low=True), Unit("world units")]


class Bevy(Engine):
    """The shadows of Bevy 0.19 under directional and spot lights, with the names, units and defaults of its lights. The
    map must be square."""

    biases = ("shadow_depth_bias", "shadow_normal_bias")
    bias_names = ("shadow_depth_bias", "shadow_normal_bias")
    follows_view = True
    filter_key = "shadow_filtering_method"
    filters = ("Hardware2x2", "Gaussian")
    point_filters = ()
    kinds = ("directional", "spot")
    has_square_maps = True
    default_size = 2048
    suffix = "rs"

    type: Literal["bevy"] = "bevy"
    shadow_filtering_method: Annotated[BevyFilter, "ShadowFilteringMethod of the camera"] = "Gaussian"
    shadow_depth_bias: Annotated[_Length, Fitted(), "shadow_depth_bias: shift of receivers towards the light"] = 0.02
    shadow_normal_bias: Annotated[
        float,
        Limits(0, 1024),
        Unit("diagonals of a texel"),
        Fitted(),
        "shadow_normal_bias: shift of receivers along their normals",
    ] = 1.8
    num_cascades: Annotated[int, Limits(1, 4), "num_cascades of a directional light"] = 4
    minimum_distance: Annotated[_Distance, "minimum_distance: start of the first cascade"] = 0.1
    maximum_distance: Annotated[_Distance, "maximum_distance: end of the last cascade"] = 150.0
    first_cascade_far_bound: Annotated[_Distance, "first_cascade_far_bound: end of the first of several cascades"] = (
        10.0
    )
    overlap_proportion: Annotated[
        float, Limits(0, 1, below_high=True), "overlap_proportion: the share in which a cascade fades into the next"
    ] = 0.2
    shadow_map_near_z: Annotated[_Distance, "shadow_map_near_z: near plane of a spot light"] = 0.1
    side: Annotated[_Sides, "faces that cull_mode of the material keeps, for all meshes or for each"] = "front"


class GodotCompatibility(Engine):
    """The shadows of Godot 4.6 in its Compatibility renderer, with the names, units and defaults of its lights. The map
    must be square."""

    biases = ("shadow_bias", "shadow_normal_bias")
    bias_names = ("shadow_bias", "shadow_normal_bias")
    follows_view = True
    filter_key = "soft_filter_quality"
    filters = ("HARD", "SOFT_LOW", "SOFT_HIGH")
    point_filters = ("HARD",)
    has_square_maps = True
    default_size = 4096
    suffix = "gd"

    type: Literal["godot_compatibility"] = "godot_compatibility"
    soft_filter_quality: Annotated[GodotQuality, "SHADOW_QUALITY of soft filters"] = "SOFT_LOW"
    shadow_bias: Annotated[
        float, Limits(0, 16), Fitted(searched=True), "shadow_bias: moves casters away from the light's camera"
    ] = 0.1
    shadow_normal_bias: Annotated[
        float, Limits(0, 16), Fitted(), "shadow_normal_bias: shift of receivers along the normals of vertices"
    ] = 2.0
    directional_shadow_mode: Annotated[GodotMode, "directional_shadow_mode"] = "SHADOW_PARALLEL_4_SPLITS"
    directional_shadow_max_distance: Annotated[_Distance, "directional_shadow_max_distance"] = 100.0
    directional_shadow_pancake_size: Annotated[
        float,
        Limits(0, FARTHEST),
        Unit("world units"),
        "directional_shadow_pancake_size: depth of the space for casters in front of the view",
    ] = 20.0
    directional_shadow_fade_start: Annotated[
        Fraction, "directional_shadow_fade_start: fraction of the shadow distance at which shadows begin to fade out"
    ] = 0.8
    side: Annotated[_Sides, "faces that the material's cull mode keeps, for all meshes or for each"] = "front"
