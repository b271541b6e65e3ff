"""Sections of the shading. Shaded images are for viewing only: no metric uses them."""

from typing import Annotated, Literal

from pydantic import Field, Tag

from ._section import MOST_FACTOR, Factor, Fraction, Radiance, Section, by_type


class AttenuationConfig(Section):
    """Attenuation of light with the distance d: 1 / (constant + linear d + quadratic d²)."""

    # Light attenuated below a millionth is black, and light amplified beyond a million is white.
    constant: float = Field(default=1.0, ge=1 / MOST_FACTOR, le=MOST_FACTOR, description="constant term")
    linear: Factor = Field(default=0.0, description="linear term, per world unit")
    quadratic: Factor = Field(default=0.0, description="quadratic term, per squared world unit")


class _LitConfig(Section):
    """Ambient, diffuse and specular light."""

    model: Literal["blinn_phong", "phong"] = Field(default="blinn_phong", description="shape of the highlight")
    ambient: Radiance = Field(default=(0.3, 0.3, 0.3), description="ambient light, which casts no shadows")
    intensity: Radiance | None = Field(
        default=None, description="intensity of each light; default: 0.7, divided among the lights"
    )
    specular: Factor = Field(default=0.15, description="specular reflectance")
    shininess: float = Field(default=32.0, gt=0, le=MOST_FACTOR, description="specular exponent")
    background: Radiance = Field(default=(0.9, 0.9, 0.9), description="colour where no surface is seen")
    attenuation: AttenuationConfig = Field(
        default_factory=AttenuationConfig, description="attenuation with the distance to a light"
    )


class PhongConfig(_LitConfig):
    """Shadow removes diffuse and specular light; ambient light remains."""

    type: Literal["phong"] = "phong"


class ModulatedConfig(_LitConfig):
    """Shadow multiplies the shaded image by a constant."""

    type: Literal["modulated"] = "modulated"
    factor: Fraction = Field(default=0.5, description="factor on the image in full shadow")


ShadingConfig = Annotated[
    Annotated[PhongConfig, Tag("phong")] | Annotated[ModulatedConfig, Tag("modulated")], by_type("phong")
]
