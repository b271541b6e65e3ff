"""Sections of the shading. Shaded images are for viewing only: no metric uses them."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from ...settings import shading
from ._section import Conflict, Section, Variants, exclusive


class AttenuationConfig(Section, shading.Attenuation):
    """Attenuation of light with the distance d: 1 / (constant + linear d + quadratic d²)."""


class _LitConfig(Section, shading.Lit):
    """Ambient, diffuse and specular light."""

    attenuation: AttenuationConfig = Field(
        default_factory=AttenuationConfig, description="attenuation with the distance to a light"
    )

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        """`intensity` together with `intensities`."""
        yield from exclusive(data, "intensities", "intensity")


class PhongConfig(_LitConfig, shading.Phong):
    """Shadow removes diffuse and specular light; ambient light remains."""


class ModulatedConfig(_LitConfig, shading.ModulatedShadow):
    """Shadow multiplies the shaded image by a constant."""


SHADINGS = Variants(shading.Shading, "phong", __name__)
ShadingConfig = Annotated[_LitConfig, SHADINGS]
