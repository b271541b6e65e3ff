"""Ambient, diffuse and specular reflection of lights (Phong 1975, Blinn 1977).

    image = albedo · ambient + Σ visibility · arriving · (albedo · max(N·L, 0) + specular · highlight)
    arriving = intensity · attenuation(distance) · cone

with the sum over the lights. Shadow removes the light's own contribution, and never the ambient one. All colours are
linear.
"""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arithmetic import as_number, dot, normalize, safe_norm
from .._checks import CheckedModule
from .._types import AsScalar, VectorMap
from .._words import counted
from ..geometry import AbstractCamera, AbstractLight
from ..raster import Surface
from ..settings import shading
from ..settings.shading import INTENSITY, Highlight
from ._abstract import AbstractShading, Lights, Visibilities, each_light
from ._colour import Colour, as_colour, as_colours


class Attenuation(CheckedModule):
    """Distance attenuation, `1 / (constant + linear · d + quadratic · d²)`, with distance `d` in world units.

    As in the OpenGL specification, version 2.1, section 2.14.1. The default is no attenuation.
    """

    settings: ClassVar = shading.Attenuation

    constant: AsScalar = eqx.field(converter=as_number, default=shading.Attenuation.constant)
    linear: AsScalar = eqx.field(converter=as_number, default=shading.Attenuation.linear)
    quadratic: AsScalar = eqx.field(converter=as_number, default=shading.Attenuation.quadratic)

    def __call__(self, distance: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The fraction of the light that arrives at `distance`, in world units."""
        return 1 / (self.constant + self.linear * distance + self.quadratic * distance**2)


class Phong(AbstractShading):
    """Ambient, diffuse and specular reflection.

    - `ambient`: light from all directions, without shadows; added once, not once for each light.
    - `intensity`: each light's intensity: the colour of a white diffuse surface that faces the light. With several
        lights, divide it by their number to keep the brightness. `intensities`: an intensity for each light, instead of
        `intensity`.
    - `specular`: fraction of the light that the highlight reflects; `shininess`: its exponent.
    - `background`: colour of pixels without a surface.
    - `attenuation`: attenuation with the distance to a light that is not directional.
    - `model`: `"blinn_phong"`, highlight (N·H)^shininess with H the half vector (Blinn 1977), or `"phong"`,
        (R·V)^shininess with R the reflected light direction (Phong 1975).

    Colours are linear; give one number or three. Each is kept as a `Colour`, whose `array` is (3,). A spot light with
    an inner angle lights only its cone.
    """

    settings: ClassVar = shading.Phong

    ambient: Colour = eqx.field(converter=as_colour, default=shading.Phong.ambient)
    intensity: Colour = eqx.field(converter=as_colour, default=INTENSITY)
    intensities: tuple[Colour, ...] | None = eqx.field(converter=as_colours, default=shading.Phong.intensities)
    specular: AsScalar = eqx.field(converter=as_number, default=shading.Phong.specular)
    shininess: AsScalar = eqx.field(converter=as_number, default=shading.Phong.shininess)
    background: Colour = eqx.field(converter=as_colour, default=shading.Phong.background)
    attenuation: Attenuation = eqx.field(default_factory=Attenuation)
    model: Highlight = eqx.field(static=True, default=shading.Phong.model)

    def __call__(self, surface: Surface, visibility: Visibilities, light: Lights, camera: AbstractCamera) -> VectorMap:
        """The image of `surface`. Arguments, result and errors are as for `AbstractShading`.

        **Raises** `ValueError` also if `intensities` are given and their number differs from the number of lights.
        """
        to_camera, pairs = _towards_camera(surface, camera), each_light(visibility, light)
        intensities = (self.intensity,) * len(pairs) if self.intensities is None else self.intensities
        if len(intensities) != len(pairs):
            raise ValueError(
                f"Phong.intensities has {counted(len(intensities), 'entry')} for {counted(len(pairs), 'light')}; "
                "expected one for each light"
            )
        image = surface.albedo * self.ambient.array
        for (seen, each), intensity in zip(pairs, intensities, strict=True):
            image = image + seen[..., None] * intensity.array * self._reflected(surface, each, to_camera)
        return jnp.where(surface.mask[..., None], image, self.background.array)

    def of_light(self, index: int) -> "Phong":
        """The shading of the scene with only the light at this index."""
        if self.intensities is None:
            return self
        return dataclasses.replace(self, intensity=self.intensities[index], intensities=None)

    def _reflected(self, surface: Surface, light: AbstractLight, to_camera: VectorMap) -> VectorMap:
        """Diffuse and specular reflection of an unshadowed light of intensity 1."""
        path = light.towards(surface.position)
        to_light = normalize(path)
        normal = surface.shading_normal
        cosine = jnp.maximum(dot(normal, to_light), 0)[..., None]
        highlight = self._highlight(normal, to_light, to_camera)[..., None]
        # A surface that faces away from the light has no highlight either.
        reflected = surface.albedo * cosine + self.specular * jnp.where(cosine > 0, highlight, 0)
        return self._fall_off(path, surface, light)[..., None] * reflected

    def _highlight(self, normal: VectorMap, to_light: VectorMap, to_camera: VectorMap) -> Float[Array, "h w"]:
        if self.model == "blinn_phong":
            cosine = dot(normal, normalize(to_light + to_camera))
        else:
            mirrored = 2 * dot(normal, to_light)[..., None] * normal - to_light
            cosine = dot(mirrored, to_camera)
        positive = cosine > 0
        return jnp.where(positive, jnp.where(positive, cosine, 1) ** self.shininess, 0)

    def _fall_off(self, path: VectorMap, surface: Surface, light: AbstractLight) -> Float[Array, "h w"]:
        """The fraction of the light that remains after distance attenuation and the spot's cone."""
        if light.is_directional:
            return jnp.ones(path.shape[:-1])
        return self.attenuation(safe_norm(path)) * light.cone_fraction(surface.position)


def _towards_camera(surface: Surface, camera: AbstractCamera) -> VectorMap:
    view = camera.view()
    if view.is_perspective:
        return normalize(camera.eye - surface.position)
    return jnp.broadcast_to(view.world_to_eye[2, :3], surface.position.shape)
