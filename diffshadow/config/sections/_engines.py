"""Sections of the techniques that draw shadows as real-time engines do, in the engines' own names and units."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ._section import FARTHEST, Fitted, Form, Fraction, Section, Texels, Unit, as_list

Side = Literal["front", "back", "double"]
_Sides = Annotated[
    Side | Annotated[tuple[Side, ...], as_list],
    Form("front, back or double, or a list with one of them for each mesh"),
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
    shadow_side: _Sides | None = Field(
        default=None,
        description="material.shadowSide of all meshes, or of each; default: the other side, in VSMShadowMap the same",
    )
    reversed_depth: bool = Field(default=False, description="whether the renderer has reversedDepthBuffer")
