"""Sections that say by which technique shadows are drawn; those of shadow maps alone: the map and the compare."""

from typing import Annotated, Literal

from pydantic import Field, Tag

from ._section import Pair, Section, Size, Texels, Unit, by_type

LEAST_WIDTH = 1e-6
"""The least width of a soft compare, in texels: far less than single precision tells of depths, and still not 0 under
1 / width."""

Kernel = Literal["logistic", "linear", "smoothstep", "gaussian", "exponential"]
"""Shape of a soft compare's step."""


class ShadowMappingConfig(Section):
    """Shadow maps, as the sections shadow_map, bias, compare and filter say."""

    type: Literal["shadow_map"] = "shadow_map"


class ShadowVolumesConfig(Section):
    """Hard shadows by counting shadow volumes, without a map."""

    type: Literal["shadow_volumes"] = "shadow_volumes"
    method: Literal["z_fail", "z_pass"] = Field(
        default="z_fail", description="which faces are counted: behind the surface, or in front of it"
    )


class ProjectiveTextureConfig(Section):
    """The casters' silhouette, drawn into a texture and projected onto what does not cast."""

    type: Literal["projective_texture"] = "projective_texture"
    resolution: Annotated[Size, Unit("texels")] = Field(default=(512, 512), description="[height, width] in texels")
    blur: Annotated[float, Unit("texels")] = Field(
        default=0.0, ge=0, le=256, description="radius of the kernel that blurs it, in texels"
    )
    kernel: Literal["box", "tent", "gaussian"] = Field(default="box", description="shape of the blur")


TechniqueConfig = Annotated[
    Annotated[ShadowMappingConfig, Tag("shadow_map")]
    | Annotated[ShadowVolumesConfig, Tag("shadow_volumes")]
    | Annotated[ProjectiveTextureConfig, Tag("projective_texture")],
    by_type("shadow_map"),
]


class ShadowMapConfig(Section):
    """The map that is drawn from the light."""

    resolution: Annotated[Size, Unit("texels")] = Field(default=(1024, 1024), description="[height, width] in texels")
    cull: Literal["none", "back", "front"] = Field(
        default="none", description="faces that are not drawn into the map; front: only if all that casts is closed"
    )
    depth_format: Literal["float32", "unorm24", "unorm16"] = Field(
        default="float32", description="how depths are stored"
    )
    polygon_offset: Pair | None = Field(
        default=None, description="[factor, units] of a bias stored in the map, as in OpenGL; default: none"
    )
    layer: Literal["nearest", "midpoint", "second"] = Field(
        default="nearest", description="which surface is stored, the midpoint being that of the nearest two"
    )
    silhouettes: bool | None = Field(
        default=None,
        description="whether texels hold where in them casters end; default: in fits that move lights or meshes",
    )


class HardCompareConfig(Section):
    """Lit or shadowed, nothing between."""

    type: Literal["hard"] = "hard"
    operator: Literal["less_equal", "less"] = Field(
        default="less_equal", description="of receiver against stored depth"
    )


class SoftCompareConfig(Section):
    """A compare with a slope, so that it has a gradient."""

    type: Literal["soft"] = "soft"
    width: Texels = Field(default=0.5, ge=LEAST_WIDTH, description="width of the step, in texels of depth")
    kernel: Kernel = Field(default="logistic", description="shape of the step")


CompareConfig = Annotated[
    Annotated[HardCompareConfig, Tag("hard")] | Annotated[SoftCompareConfig, Tag("soft")], by_type("hard")
]
