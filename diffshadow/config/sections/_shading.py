"""The section that says how pictures are shaded. Nothing is measured on them."""

from typing import Annotated, Literal

from pydantic import Field, Tag

from ._section import MOST_FACTOR, Factor, Radiance, Section, Share, by_type


class AttenuationConfig(Section):
    """How light falls off with the distance d: 1 / (constant + linear d + quadratic d²)."""

    # What falls off to less than a millionth is dark, and what grows to more than a million times is white.
    constant: float = Field(default=1.0, ge=1 / MOST_FACTOR, le=MOST_FACTOR, description="at no distance")
    linear: Factor = Field(default=0.0, description="per world unit")
    quadratic: Factor = Field(default=0.0, description="per squared world unit")


class _LitConfig(Section):
    """Ambient, diffuse and specular light."""

    model: Literal["blinn_phong", "phong"] = Field(default="blinn_phong", description="shape of the highlight")
    ambient: Radiance = Field(default=(0.3, 0.3, 0.3), description="light from everywhere, which nothing shadows")
    intensity: Radiance | None = Field(
        default=None, description="of each light; default: 0.7, divided among the lights"
    )
    specular: Factor = Field(default=0.15, description="share of the light that the highlight reflects")
    shininess: float = Field(default=32.0, gt=0, le=MOST_FACTOR, description="the highlight's exponent")
    background: Radiance = Field(default=(0.9, 0.9, 0.9), description="where no surface is seen")
    attenuation: AttenuationConfig = Field(
        default_factory=AttenuationConfig, description="fall-off with the distance to a light"
    )


class PhongConfig(_LitConfig):
    """Shadow takes away the diffuse and specular light, and leaves the ambient."""

    type: Literal["phong"] = "phong"


class ModulatedConfig(_LitConfig):
    """Shadow multiplies the finished picture by a constant."""

    type: Literal["modulated"] = "modulated"
    factor: Share = Field(default=0.5, description="what shadow leaves of the picture")


ShadingConfig = Annotated[
    Annotated[PhongConfig, Tag("phong")] | Annotated[ModulatedConfig, Tag("modulated")], by_type("phong")
]
