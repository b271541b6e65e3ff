"""Sections of the techniques that draw shadows as real-time engines do, in the engines' own names and units."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ._section import FARTHEST, Fitted, Form, Fraction, Section, Texels, Unit, as_list

Side = Literal["front", "back", "double"]
_Sides = Annotated[
    Side | Annotated[tuple[Side, ...], as_list],
    Form("front, back or double, or a list with one of them for each mesh"),
]
_ShadowSides = Annotated[
    Side | Annotated[tuple[Side | None, ...], as_list],
    Form("front, back or double, or a list with one of them or null for each mesh"),
]
# Window depth is from 0 to 1.
_Depth = Annotated[float, Field(ge=-1, le=1), Unit("window depth")]
_Length = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST), Unit("world units")]


class EngineConfig(Section):
    """The shadows of an engine. Its map has the resolution of the section shadow_map; filter, bias and compare are the
    engine's own."""

    builds: ClassVar[str]

    subpixels: int = Field(
        default=256,
        ge=1,
        le=1 << 16,
        description="steps to a texel at which the engine's rasterizer places vertices: 256 on most graphics hardware, "
        "16 in Chromium without it",
    )


class ThreeJsConfig(EngineConfig):
    """The shadows of three.js r187, by the names, units and defaults of light.shadow and renderer.shadowMap."""

    builds: ClassVar[str] = "ThreeJs"

    type: Literal["three.js"] = "three.js"
    shadow_type: Literal["BasicShadowMap", "PCFShadowMap", "PCFSoftShadowMap", "VSMShadowMap"] = Field(
        default="PCFShadowMap", description="renderer.shadowMap.type"
    )
    bias: Annotated[_Depth, Fitted()] = Field(
        default=0.0, description="light.shadow.bias: added to receivers' depth, so negative values lift them"
    )
    normal_bias: Annotated[_Length, Fitted()] = Field(
        default=0.0, description="light.shadow.normalBias: how far receivers move along their normals"
    )
    radius: Annotated[Texels, Field(ge=0), Fitted()] = Field(
        default=1.0, description="light.shadow.radius: of the filter; without effect in BasicShadowMap"
    )
    intensity: Fraction = Field(default=1.0, description="light.shadow.intensity")
    blur_samples: int = Field(default=8, ge=1, le=256, description="light.shadow.blurSamples, in VSMShadowMap")
    side: _Sides = Field(default="front", description="material.side of all meshes, or of each")
    shadow_side: _ShadowSides | None = Field(
        default=None,
        description="material.shadowSide of all meshes, or of each; default, and null in a list: the other side, in "
        "VSMShadowMap the same",
    )
    reversed_depth: bool = Field(default=False, description="whether the renderer has reversedDepthBuffer")


class BabylonJsConfig(EngineConfig):
    """The shadows of Babylon.js 9.34 (WebGL2), by the names, units and defaults of its ShadowGenerator. The map must be
    square."""

    builds: ClassVar[str] = "BabylonJs"

    type: Literal["babylon.js"] = "babylon.js"
    filter: Literal[
        "NONE",
        "POISSONSAMPLING",
        "EXPONENTIALSHADOWMAP",
        "BLUREXPONENTIALSHADOWMAP",
        "CLOSEEXPONENTIALSHADOWMAP",
        "BLURCLOSEEXPONENTIALSHADOWMAP",
        "PCF",
        "PCSS",
    ] = Field(default="NONE", description="the generator's FILTER_ constant")
    quality: Literal["HIGH", "MEDIUM", "LOW"] = Field(
        default="HIGH", description="filteringQuality, for filters PCF and PCSS"
    )
    bias: Annotated[float, Field(ge=-1, le=1), Unit("parts of the depth range"), Fitted()] = Field(
        default=5e-5, description="bias: pushes casters away from the light"
    )
    normal_bias: Annotated[_Length, Fitted(searched=True)] = Field(
        default=0.0, description="normalBias: how far casters' vertices move against their normals"
    )
    darkness: Fraction = Field(default=0.0, description="darkness: the visibility in full shadow")
    blur_scale: Annotated[float, Field(gt=0, le=1024), Unit("texels"), Fitted()] = Field(
        default=2.0, description="blurScale: radius of POISSONSAMPLING, or size of a map over that of its blur"
    )
    depth_scale: Annotated[float, Field(gt=0, le=1000), Fitted()] = Field(
        default=50.0, description="depthScale: steepness of exponential maps"
    )
    frustum_edge_falloff: Fraction = Field(
        default=0.0, description="frustumEdgeFalloff: width of the border in which shadows fade out"
    )
    contact_hardening_light_size_uv_ratio: Annotated[Fraction, Fitted()] = Field(
        default=0.1, description="contactHardeningLightSizeUVRatio: radius of PCSS over the map's width"
    )
    blur_kernel: int = Field(default=1, ge=0, le=256, description="blurKernel, with use_kernel_blur")
    blur_box_offset: int = Field(default=1, ge=0, le=64, description="blurBoxOffset, without use_kernel_blur")
    use_kernel_blur: bool = Field(default=False, description="useKernelBlur: whether the blur is a Gaussian")
    force_back_faces_only: bool = Field(default=False, description="forceBackFacesOnly: whether only back faces cast")
    back_face_culling: bool | Annotated[tuple[bool, ...], as_list] = Field(
        default=True, description="material.backFaceCulling of all meshes, or of each"
    )
    float_maps: bool = Field(default=False, description="usefullFloatFirst: floats rather than half floats in the map")
