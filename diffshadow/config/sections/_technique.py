"""Sections of the shadow technique, the shadow map and the compare."""

from typing import Annotated, Literal

from pydantic import Field, Tag

from ._section import Pair, Section, Size, Texels, Unit, by_type

LEAST_WIDTH = 1e-6
"""The least width of a soft compare, in texels: far below the resolution of float32 depth, and 1 / width is finite."""

SoftKernel = Literal["logistic", "linear", "smoothstep", "gaussian", "exponential"]
"""Shape of a soft compare's step."""


class ShadowMappingConfig(Section):
    """Shadow maps, set up by the sections shadow_map, bias, compare and filter."""

    type: Literal["shadow_map"] = "shadow_map"


class ShadowVolumesConfig(Section):
    """Hard shadows from shadow volumes, without a map."""

    type: Literal["shadow_volumes"] = "shadow_volumes"
    method: Literal["z_fail", "z_pass"] = Field(
        default="z_fail", description="which volume faces are counted: those behind the surface, or in front of it"
    )


class ProjectiveTextureConfig(Section):
    """The casters' silhouette, drawn into a texture and projected onto the meshes that do not cast."""

    type: Literal["projective_texture"] = "projective_texture"
    resolution: Annotated[Size, Unit("texels")] = Field(default=(512, 512), description="[height, width] in texels")
    blur: Annotated[float, Unit("texels")] = Field(
        default=0.0, ge=0, le=256, description="radius of the texture's blur, in texels"
    )
    kernel: Literal["box", "tent", "gaussian"] = Field(default="box", description="shape of the blur")


TechniqueConfig = Annotated[
    Annotated[ShadowMappingConfig, Tag("shadow_map")]
    | Annotated[ShadowVolumesConfig, Tag("shadow_volumes")]
    | Annotated[ProjectiveTextureConfig, Tag("projective_texture")],
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
