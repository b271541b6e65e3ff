"""Sections of images: the shading, for viewing only, and the reference."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from ..._words import counted
from ...settings import Setting, reference, shading
from ...settings.quantities import Factor, Fraction
from .._errors import KeyPath
from ._scene import colour_of
from ._section import Conflict, Section, Variants, fault

if TYPE_CHECKING:
    from ._config import Config

# 36 bytes each, all in memory at once: 2.4 GB.
_MAX_CAMERA_RAYS = 1 << 26
# Two hours at ten million per second.
_MAX_SHADOW_RAYS = 1 << 36
EACH_INTENSITY = "intensities."
"""The part before the index of a light in the names of single intensities."""


class AttenuationConfig(Section, shading.Attenuation):
    """Attenuation of light with the distance d: 1 / (constant + linear d + quadratic d²)."""


class LitConfig(Section, shading.Lit):
    """Ambient, diffuse and specular light. `moving`: the numbers of the section that can be fitted to a picture, by
    key."""

    attenuation: AttenuationConfig = Field(
        default_factory=AttenuationConfig, description="attenuation with the distance to a light"
    )
    exclusive = (("intensities", "intensity"),)
    moving: ClassVar[Mapping[str, Setting]] = {
        **{
            key: kind
            for name in ("ambient", "intensity", "background")
            for key, kind in colour_of(name, Factor).items()
        },
        **{key: shading.Lit.each()[key] for key in ("specular", "shininess")},
        **{f"attenuation.{key}": kind for key, kind in shading.Attenuation.each().items()},
    }

    def path_of(self, key: str) -> str:
        """The path of a number in the module."""
        return key

    def moving_in(self, config: "Config") -> Mapping[str, Setting]:
        """The numbers that can be fitted in `config`: one intensity for all lights, or one for each light."""
        count, found = len(config.scene.each_light), dict(self.moving)
        if self.intensities is not None or self.fits_each_intensity(config):
            found = {key: kind for key, kind in found.items() if not key.startswith("intensity.")}
        if self.intensities is not None or count > 1:
            for i in range(count):
                found |= colour_of(f"{EACH_INTENSITY}{i}", Factor)
        return found

    def fits_each_intensity(self, config: "Config") -> bool:
        """Whether each light's intensity is fitted separately."""
        return any(name.startswith(f"shading.{EACH_INTENSITY}") for name in config.fit.parameters)

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        lights = len(config.scene.each_light)
        if self.intensities is not None and len(self.intensities) != lights:
            message = f"has {counted(len(self.intensities), 'entry')}, and the scene has {counted(lights, 'light')}"
            yield ("shading", "intensities"), fault(message, "one for each light", "add or remove some")


class PhongConfig(LitConfig, shading.Phong):
    """Shadow removes diffuse and specular light; ambient light remains."""


class ModulatedConfig(LitConfig, shading.ModulatedShadow):
    """Shadow multiplies the shaded image by a constant."""

    moving: ClassVar[Mapping[str, Setting]] = {**LitConfig.moving, "factor": Setting.of(Fraction)}

    def path_of(self, key: str) -> str:
        return key if key == "factor" else f"lit.{key}"


SHADINGS = Variants(shading.Shading, "phong", __name__)
ShadingConfig = Annotated[LitConfig, SHADINGS]


class TracedReferenceConfig(Section, reference.TracedReference):
    """A ray-traced reference."""

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        lights, pixels = config.scene.each_light.values(), config.scene.camera.pixels
        points = pixels * self.supersampling**2 * len(lights)
        mend = "lower it, or scene.camera.resolution"
        if points > _MAX_CAMERA_RAYS:
            message = f"is {self.supersampling}, which makes {points:,} camera rays over all pixels and lights"
            expected = f"at most {_MAX_CAMERA_RAYS:,}, which take 2.4 GB"
            yield ("reference", "supersampling"), fault(message, expected, mend)
        rays = pixels * max(self.samples, self.supersampling**2) * sum(light.has_size for light in lights)
        if rays > _MAX_SHADOW_RAYS:
            message = f"is {self.samples}, which makes {rays:,} shadow rays over all pixels and lights"
            yield ("reference", "samples"), fault(message, f"at most {_MAX_SHADOW_RAYS:,}, which take hours", mend)


class PictureReferenceConfig(Section, reference.PictureReference):
    """A picture of the shaded scene. A fit finds the camera, lights, meshes and colours that reproduce it."""

    moving: ClassVar[Mapping[str, Setting]] = {"exposure": reference.PictureReference.each()["exposure"]}

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        for key, section in (("sweep", config.sweep), ("advise", config.advise)):
            if section is not None:
                what = fault("is given with reference.type picture", "a single fit to a picture", "remove one of them")
                yield (key,), what


class ImageReferenceConfig(Section, reference.ImageReference):
    """A reference from an image file."""

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        lights = len(config.scene.each_light)
        if lights > 1:
            message = f"is a single image, for {lights} lights"
            yield ("reference", "type"), fault(message, "one light, or a traced reference", "set it to traced")


REFERENCES = Variants(reference.Reference, "traced", __name__)
ReferenceConfig = Annotated[reference.Reference, REFERENCES]
