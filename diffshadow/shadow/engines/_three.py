"""The shadows of three.js (r187, `WebGLRenderer`)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_number, in_unit_range, safe_norm
from ..._checks import as_tuple
from ..._types import AsScalar, Resolution, Visibility
from ...geometry import WORLD, Origin, PointLight, Scene
from ...raster import Surface
from ...settings import maps
from ...settings.engines import OTHER_SIDE, ShadowSides, ShadowType, Side, Sides
from ...settings.engines import ThreeJs as Settings
from .._compare import AbstractCompare, HardCompare
from ..patterns import interleaved_gradient_noise
from ._abstract import AbstractEngineShadows, Place
from ._axes import engine_light
from ._code import three_js_code
from ._convert import OFFSET_PROFILES, LightFrame, PlainBias
from ._engine_map import EngineMap, each_of
from ._given import THREE_NUDGE, three_directional_light, three_point_light, three_spot_light
from ._light import EngineLight
from ._textures import bilinear, bilinear_in_cube, nearest, nearest_in_cube, place_in_cube, with_borders
from ._variance import at_receivers, blurred, chebyshev

_TAPS = 5
# The radius of a disk with the same standard deviation as a box from -1 to 1.
_BOX = 2 / math.sqrt(3)
_GOLDEN_ANGLE = 2.399963229728653


class ThreeJs(AbstractEngineShadows):
    """The shadows of three.js, release 187, in its `WebGLRenderer`.

    - `shadow_type`: `renderer.shadowMap.type`. `PCFSoftShadowMap` is drawn as `PCFShadowMap`, as in the engine.
    - `bias`: added to the receiver's window depth after the divide; negative values lift it towards the light.
    - `normal_bias`: the shift of receivers along their interpolated normals, in world units.
    - `radius`: radius of the disk of taps (PCF) or of the box (VSM), in texels; under a point light, in half texels at
        a face's centre. Without effect for `BasicShadowMap`.
    - `intensity`: intensity of the shadow, from 0 to 1.
    - `blur_samples`: taps of the box along each axis (VSM).
    - `side`: `side` of the meshes' materials, `"front"`, `"back"` or `"double"`: one value for all, or one for each.
        Back sides negate `normal_bias`.
    - `shadow_side`: `shadowSide` of the meshes' materials: the faces that cast. By default, or if `None` for one of the
      meshes, `side` decides: with `"front"` back faces cast, with `"back"` front faces, and with `"double"` both. A
      closed mesh then has no acne, and a single ground plane casts nothing. With VSM, the faces that `side` names cast.
    - `reversed_depth`: whether the renderer has `reversedDepthBuffer`. Surfaces beyond far are then in shadow.
    - `resolution`, `subpixels`, `compare`: see `AbstractEngineShadows`.

    The radius has a derivative if taps are bilinear: in PCF, and in the second pass of VSM. The first pass of VSM reads
    single texels.

    With a map from the engine (`from_map`), the blurred map of VSM equals the engine's to the bit, for Chromium without
    graphics hardware. Depths of this package's map differ from the engine's depths by up to 1.2e-6. Under VSM with a
    radius of about 1 or less and no bias, all surfaces are compared with themselves, so the last bits of depth matter.
    95.7 to 100 % of the pixels then equal the engine's.

    !!! Example

        ```python
        engine = shadow.ThreeJs(bias=-0.001, radius=2.0, resolution=(64, 64))
        engine.visibility(engine.prepare(scene), surface).shape  # (32, 32)
        ```
    """

    settings: ClassVar = Settings

    bias: AsScalar = eqx.field(converter=as_number, default=Settings.bias)
    normal_bias: AsScalar = eqx.field(converter=as_number, default=Settings.normal_bias)
    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)
    intensity: AsScalar = eqx.field(converter=as_number, default=Settings.intensity)
    compare: AbstractCompare = HardCompare()
    shadow_type: ShadowType = eqx.field(static=True, default=Settings.shadow_type)
    blur_samples: int = eqx.field(static=True, default=Settings.blur_samples)
    side: Sides = eqx.field(static=True, converter=as_tuple, default=Settings.side)
    shadow_side: ShadowSides | None = eqx.field(static=True, converter=as_tuple, default=Settings.shadow_side)
    reversed_depth: bool = eqx.field(static=True, default=Settings.reversed_depth)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=maps.ShadowMap.resolution)
    subpixels: int = eqx.field(static=True, default=Settings.subpixels)

    directional_light = staticmethod(three_directional_light)
    spot_light = staticmethod(three_spot_light)
    point_light = staticmethod(three_point_light)

    def prepare(self, scene: Scene, surface: Surface | None = None) -> EngineMap:
        """The map of the scene's only light. It does not depend on `surface`.

        **Raises** `ValueError` for an area light, for a point light with `VSMShadowMap` (which the engine does not
        draw) or with a map that is not square, or if there is not one side for all meshes or one for each.
        """
        if self.shadow_type == "VSMShadowMap" and isinstance(scene.light, PointLight):
            raise ValueError(
                "the light is a point light, for which three.js draws no VSMShadowMap; expected BasicShadowMap or "
                "PCFShadowMap: change shadow_type"
            )
        offset = _offsets(each_of(self.side, scene.meshes, "side"))
        return self.drawn(scene, engine_light(scene.light, THREE_NUDGE), self.casting_sides(scene), offset)

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        is_variance = self.shadow_type == "VSMShadowMap"
        side = each_of(self.side, scene.meshes, "side")
        default: tuple[Side, ...] = side if is_variance else tuple(OTHER_SIDE[one] for one in side)
        given: tuple[Side | None, ...] = each_of(self.shadow_side, scene.meshes, "shadow_side")
        casting: list[Side] = [other if one is None else one for one, other in zip(given, default, strict=True)]
        receives = scene.receives or (True,) * len(side)
        casts = scene.casts or (True,) * len(side)
        if is_variance:
            # The engine also draws receivers.
            casts = tuple(map(max, casts, receives))
        return tuple(one if does else None for one, does in zip(casting, casts, strict=True))

    def from_map(self, stored: Any, scene: Scene) -> EngineMap:
        """The result of `prepare`, with the engine's depth texture instead of this package's. With VSM, it is the
        texture before the blur. For the arguments and errors see `AbstractEngineShadows.from_map`.
        """
        light = engine_light(scene.light, THREE_NUDGE)
        depth = self.checked_map(stored, light, is_depth=True)
        offset = _offsets(each_of(self.side, scene.meshes, "side"))
        return self.with_depth(1 - depth if self.reversed_depth else depth, scene, light, offset)

    def plain(self, frame: LightFrame, distance: float) -> PlainBias:
        offset = float(self.normal_bias) / frame.texel
        shift = -float(self.bias) / frame.slope(distance)
        return PlainBias(shift, 2, offset, 0, OFFSET_PROFILES["three.js"], self._radius(frame))

    def _radius(self, frame: LightFrame) -> float:
        radius = float(self.radius)
        match self.shadow_type:
            case "BasicShadowMap":
                return 0.0
            case "VSMShadowMap":
                return radius * _BOX
        # Under a point light, a unit is half a texel at the centre of a face.
        return radius / 2 if frame.kind == "point" else radius

    def as_wide(self, radius: float, frame: LightFrame) -> "ThreeJs":
        if radius == 0:
            return dataclasses.replace(self, shadow_type="BasicShadowMap")
        return dataclasses.replace(self, radius=2 * radius if frame.kind == "point" else radius)

    def biased(self, frame: LightFrame, shift: float, offset: float, distance: float) -> "ThreeJs":
        values = {"bias": 0.0 - shift * frame.slope(distance), "normal_bias": offset}
        return dataclasses.replace(self, **values)

    def code(self, given: EngineLight, distances: tuple[float, float], origin: Origin = WORLD) -> list[str]:
        return three_js_code(self, given, distances, origin)

    def visibility(self, state: EngineMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        Points outside of the light's frustum are lit. Faces away from the light are compared like all other faces.
        """
        return _visibility(self, state, surface)


def _offsets(side: Sequence[Side]) -> list[float]:
    """The factor of each mesh's normal bias."""
    return [-1.0 if one == "back" else 1.0 for one in side]


@eqx.filter_jit
def _visibility(settings: ThreeJs, state: EngineMap, surface: Surface) -> Visibility:
    factor, receives = state.of_pixels(surface)
    position = surface.position + settings.normal_bias * factor * surface.interpolated_normal
    of = _in_cube if isinstance(state.light, PointLight) else _in_window
    lit = of(settings, state, position)
    return jnp.where(receives, in_unit_range(1 + (lit - 1) * settings.intensity), 1)


def _in_window(settings: ThreeJs, state: EngineMap, position: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    place = Place.of(position, state.light.view(), state.resolution)
    z = place.z + settings.bias
    inside = place.in_window & ((z >= 0) if settings.reversed_depth else (z <= 1))
    compared = lambda stored: settings.compare(stored, z, place.depth_per_texel)
    u, v = (jnp.where(inside, at, 0.5) for at in (place.u, place.v))
    if settings.shadow_type == "BasicShadowMap":
        lit = compared(nearest(state.depth, u, v))
    elif settings.shadow_type == "VSMShadowMap":
        # The stored depth is rounded to half floats.
        as_stored = (lambda depth: 1 - depth) if settings.reversed_depth else (lambda depth: depth)
        moments = blurred(as_stored(state.depth), settings.radius, settings.blur_samples)
        mean, deviation = at_receivers(moments, u, v)
        mean = as_stored(mean)
        lit = jnp.maximum(compared(mean), chebyshev(mean, deviation, z))
    else:
        height, width = state.resolution
        tap = lambda x, y: bilinear(
            state.depth, u + settings.radius / width * x, v + settings.radius / height * y, compared
        )
        lit = _mean_over_disk(tap, z.shape)
    return jnp.where(inside, lit, 1)


def _mean_over_disk(tap: Any, shape: tuple[int, ...]) -> Float[Array, "h w"]:
    """The mean of `tap(x, y)` over Vogel's disk, rotated at each pixel by noise."""
    turn = 2 * jnp.pi * interleaved_gradient_noise(shape, 0.5)

    def add(total: Array, k: Array) -> tuple[Array, None]:
        angle, distance = _GOLDEN_ANGLE * k + turn, jnp.sqrt((k + 0.5) / _TAPS)
        return total + tap(distance * jnp.cos(angle), distance * jnp.sin(angle)), None

    return lax.scan(add, jnp.zeros(shape), jnp.arange(_TAPS, dtype=jnp.float32))[0] / _TAPS


def _in_cube(settings: ThreeJs, state: EngineMap, position: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    light = state.light
    assert isinstance(light, PointLight)
    near, far, bias = light.near, light.far, settings.bias
    towards = position - light.position
    _, _, _, along = place_in_cube(towards)
    inside = (along >= near) & (along <= far)
    size = state.depth.shape[-1]
    at = jnp.maximum(along, near)
    # A texel is 2 v / N wide at the distance v along the face's axis, and z' = f n / ((f - n) v²).
    per_texel = 2 * near * far / ((far - near) * at * size)
    if settings.shadow_type == "BasicShadowMap":
        z = far * (at - near) / (at * (far - near)) + bias
        lit = settings.compare(nearest_in_cube(state.depth, towards), z, per_texel)
        return jnp.where(inside, lit, 1)
    distance = safe_norm(towards)
    unit = towards / jnp.where(distance > 0, distance, 1)[..., None]
    is_x = jnp.abs(unit[..., :1]) > jnp.abs(unit[..., 2:])
    tangent = jnp.cross(unit, jnp.where(is_x, jnp.array([0.0, 1.0, 0.0]), jnp.array([1.0, 0.0, 0.0])))
    tangent = tangent / safe_norm(tangent)[..., None]
    bitangent = jnp.cross(unit, tangent)
    bordered = with_borders(state.depth)

    def tap(x: Array, y: Array) -> Array:
        direction = unit + settings.radius / size * (tangent * x[..., None] + bitangent * y[..., None])
        axis = jnp.max(jnp.abs(direction), axis=-1)
        z = far / (far - near) + bias - near * far / ((far - near) * distance * axis)
        return bilinear_in_cube(bordered, direction, lambda stored: settings.compare(stored, z, per_texel))

    return jnp.where(inside, _mean_over_disk(tap, along.shape), 1)
