"""Ambient, diffuse and specular reflection of one light (Phong 1975, Blinn 1977).

    image = albedo · ambient + visibility · arriving · (albedo · max(N·L, 0) + specular · highlight)
    arriving = intensity · attenuation(distance) · cone

Shadow takes away what comes from the light itself, and never the ambient part. All colours are linear.
"""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._misc import as_float, concrete, dot, normalize, safe_norm
from .._types import Scalar, Vec3, VectorMap, Visibility
from ..geometry import AbstractCamera, AbstractLight, SpotLight
from ..raster import Surface

Model = Literal["blinn_phong", "phong"]


def _colour(value: Any) -> Vec3:
    return jnp.broadcast_to(as_float(value), (3,))


class Attenuation(eqx.Module):
    """How light at a finite distance `d` falls off, `1 / (constant + linear · d + quadratic · d²)`, `d` in world units.

    The OpenGL specification, version 2.1, section 2.14.1. The default is no fall-off.

    **Raises** `ValueError` unless all are 0 or more and `constant` more than 0.
    """

    constant: Scalar = eqx.field(converter=as_float, default=1.0)
    linear: Scalar = eqx.field(converter=as_float, default=0.0)
    quadratic: Scalar = eqx.field(converter=as_float, default=0.0)

    def __check_init__(self):
        values = [concrete(v) for v in (self.constant, self.linear, self.quadratic)]
        known = [float(v) for v in values if v is not None]
        if any(not (v >= 0 and np.isfinite(v)) for v in known) or (values[0] is not None and not values[0] > 0):
            raise ValueError(
                f"the attenuation is {known}; expected three finite numbers of 0 or more, the constant one above 0"
            )

    def __call__(self, distance: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The share of light left at `distance`, in world units."""
        return 1 / (self.constant + self.linear * distance + self.quadratic * distance**2)


class Phong(eqx.Module):
    """Reflection of a light by surfaces that are partly matt and partly glossy.

    - `ambient`: (3,), light that comes from everywhere and that nothing shadows.
    - `intensity`: (3,), of the light; a matt white surface that faces it shines with this much.
    - `specular`: share of the light that the highlight reflects; `shininess`: its exponent.
    - `background`: (3,), colour of pixels without a surface.
    - `attenuation`: with the distance to a light that is not directional.
    - `inner_angle`: degrees. Inside this half-angle a spot light shines in full, and from there to its `outer_angle`
        it fades by a smooth step in the cosine. Left out, its cone is not obeyed.
    - `model`: `"blinn_phong"`, highlight (N·H)^shininess with H halfway between the ways to light and eye (Blinn 1977),
        or `"phong"`, (R·V)^shininess with R the mirrored light (Phong 1975).

    Colours are linear, each a number or three.

    **Raises** `ValueError` if the model is unknown, the shininess not above 0, or the inner angle not in [0, 90).
    """

    ambient: Vec3 = eqx.field(converter=_colour, default=0.3)
    intensity: Vec3 = eqx.field(converter=_colour, default=0.7)
    specular: Scalar = eqx.field(converter=as_float, default=0.15)
    shininess: Scalar = eqx.field(converter=as_float, default=32.0)
    background: Vec3 = eqx.field(converter=_colour, default=0.9)
    attenuation: Attenuation = eqx.field(default_factory=Attenuation)
    inner_angle: Scalar | None = eqx.field(converter=lambda x: None if x is None else as_float(x), default=None)
    model: Model = eqx.field(static=True, default="blinn_phong")

    def __check_init__(self):
        if self.model not in ("blinn_phong", "phong"):
            raise ValueError(f'the shading model is {self.model!r}; expected "blinn_phong" or "phong"')
        shininess = concrete(self.shininess)
        if shininess is not None and not shininess > 0:
            raise ValueError(f"the shininess is {shininess}; expected more than 0")
        inner = None if self.inner_angle is None else concrete(self.inner_angle)
        if inner is not None and not 0 <= inner < 90:
            raise ValueError(f"the inner_angle is {inner}; expected degrees in [0, 90)")

    def __call__(
        self, surface: Surface, visibility: Visibility, light: AbstractLight, camera: AbstractCamera
    ) -> VectorMap:
        """The image of `surface` lit by `light`, seen by `camera`.

        **Arguments:**

        - `visibility`: (h, w), of the light, in [0, 1].

        **Returns:** (h, w, 3), linear, 0 or more; it may exceed 1. Differentiable, without NaN, by all arguments.
        """
        path = light.towards(surface.position)
        to_light = normalize(path)
        normal = surface.shading_normal
        cosine = jnp.maximum(dot(normal, to_light), 0)[..., None]
        highlight = self._highlight(normal, to_light, _towards_camera(surface, camera))[..., None]
        # A surface turned away from the light has no highlight either.
        reflected = surface.albedo * cosine + self.specular * jnp.where(cosine > 0, highlight, 0)
        arriving = (visibility * self._fall_off(path, to_light, light))[..., None] * self.intensity
        image = surface.albedo * self.ambient + arriving * reflected
        return jnp.where(surface.mask[..., None], image, self.background)

    def _highlight(self, normal: VectorMap, to_light: VectorMap, to_camera: VectorMap) -> Float[Array, "h w"]:
        if self.model == "blinn_phong":
            cosine = dot(normal, normalize(to_light + to_camera))
        else:
            mirrored = 2 * dot(normal, to_light)[..., None] * normal - to_light
            cosine = dot(mirrored, to_camera)
        positive = cosine > 0
        return jnp.where(positive, jnp.where(positive, cosine, 1) ** self.shininess, 0)

    def _fall_off(self, path: VectorMap, to_light: VectorMap, light: AbstractLight) -> Float[Array, "h w"]:
        """The share of light that neither distance nor the spot's cone takes away."""
        if light.is_directional:
            return jnp.ones(path.shape[:-1])
        share = self.attenuation(safe_norm(path))
        if self.inner_angle is None or not isinstance(light, SpotLight):
            return share
        outer = jnp.cos(jnp.deg2rad(light.outer_angle))
        # An inner angle beyond the outer one makes the cone's rim hard.
        width = jnp.maximum(jnp.cos(jnp.deg2rad(self.inner_angle)) - outer, 1e-6)
        t = jnp.clip((-dot(to_light, normalize(light.direction)) - outer) / width, 0, 1)
        return share * t * t * (3 - 2 * t)


def _towards_camera(surface: Surface, camera: AbstractCamera) -> VectorMap:
    view = camera.view()
    if view.is_perspective:
        return normalize(camera.eye - surface.position)
    return jnp.broadcast_to(view.world_to_eye[2, :3], surface.position.shape)
