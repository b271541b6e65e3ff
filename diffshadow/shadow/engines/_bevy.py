"""The shadows of Bevy (0.19, wgpu)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_number, normalize
from ..._checks import as_tuple
from ..._types import AsScalar, HostArray, Resolution, Visibility
from ...geometry import WORLD, DirectionalLight, MatrixLight, Origin, Scene, SpotLight
from ...raster import Surface
from ...settings import maps
from ...settings.engines import Bevy as Settings
from ...settings.engines import BevyFilter, Side, Sides
from .._compare import AbstractCompare, HardCompare
from .._technique import of_casters
from ._abstract import AbstractEngineShadows
from ._axes import refused_light, upright_axes
from ._cameras import (
    CameraOfLight,
    EngineCameras,
    cone_projection,
    frustum_corners,
    in_order,
    in_single,
    inverse_pose,
    parallel_projection,
    reversed_depth,
)
from ._code import about, number, place
from ._convert import LightFrame, PlainBias
from ._engine_map import EngineMap, each_of, reversed_map_of
from ._given import bevy_spot_light, fitted_directional_light
from ._light import EngineLight, plain
from ._taps import TentSize, castano_radius, tent

_SIZES: dict[BevyFilter, TentSize] = {"Hardware2x2": 1, "Gaussian": 5}
# The engine uses the diagonal of a texel.
_DIAGONAL = math.sqrt(2)
# The start of a fit, and its bounds, in texels and in units of `shadow_normal_bias`.
_START, _MOST, _MOST_NORMAL = 1.0, 32.0, 4.0
# A distance far beyond any scene, because the far plane of spot lights is at infinity.
_INFINITY = 1e6


class Bevy(AbstractEngineShadows):
    """The shadows of Bevy 0.19 under directional and spot lights.

    Fields have the engine's names in `DirectionalLight`, `SpotLight`, `ShadowFilteringMethod` and
    `CascadeShadowConfigBuilder`. A directional light has the engine's cameras, which are fitted to the view of the
    scene's camera up to `maximum_distance`. Only the direction of the light matters.

    - `shadow_filtering_method`: the camera's filter: a tent over 5 texels, or one bilinear compare. `Temporal`, whose
        noise changes with time, is not drawn.
    - `shadow_depth_bias`: the shift of receivers towards the light, in world units.
    - `shadow_normal_bias`: the shift of receivers along their normals, in diagonals of a texel. Under a spot light, the
      texel is at the receiver's distance.
    - `num_cascades`, `minimum_distance`, `maximum_distance`, `first_cascade_far_bound`, `overlap_proportion`: settings
        of a directional light's cascades; distances in world units.
    - `shadow_map_near_z`: the near plane of a spot light, world units.
    - `side`: the faces that the meshes' materials keep (`cull_mode`), which therefore cast; one value for all meshes,
        or one for each.
    - `resolution`, `subpixels`, `compare`: see `AbstractEngineShadows`. Maps are square, and their side is a power of
        two.

    **Raises** `ValueError` for another map.
    """

    settings: ClassVar = Settings
    has_layers: ClassVar = True

    shadow_depth_bias: AsScalar = eqx.field(converter=as_number, default=Settings.shadow_depth_bias)
    shadow_normal_bias: AsScalar = eqx.field(converter=as_number, default=Settings.shadow_normal_bias)
    compare: AbstractCompare = HardCompare()
    shadow_filtering_method: BevyFilter = eqx.field(static=True, default=Settings.shadow_filtering_method)
    num_cascades: int = eqx.field(static=True, default=Settings.num_cascades)
    minimum_distance: float = eqx.field(static=True, default=Settings.minimum_distance)
    maximum_distance: float = eqx.field(static=True, default=Settings.maximum_distance)
    first_cascade_far_bound: float = eqx.field(static=True, default=Settings.first_cascade_far_bound)
    overlap_proportion: float = eqx.field(static=True, default=Settings.overlap_proportion)
    shadow_map_near_z: float = eqx.field(static=True, default=Settings.shadow_map_near_z)
    side: Sides = eqx.field(static=True, converter=as_tuple, default=Settings.side)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=maps.ShadowMap.resolution)
    subpixels: int = eqx.field(static=True, default=Settings.subpixels)

    directional_light = staticmethod(fitted_directional_light)
    spot_light = staticmethod(bevy_spot_light)

    def _check_rules(self):
        super()._check_rules()
        size = self.resolution[0]
        if size & (size - 1):
            raise ValueError(
                f"Bevy.resolution is {self.resolution}; expected a power of two, because the engine rounds other "
                f"sizes up: {1 << size.bit_length()}"
            )

    def prepare(self, scene: Scene, surface: Surface | None = None) -> EngineMap:
        """The map of the scene's only light. It does not depend on `surface`.

        **Raises** `ValueError` for a point or an area light, or if `side` does not have one value or one for each mesh.
        """
        light, casters = self.cameras_of(scene), self.casters(scene)
        # A directional light's casters before its near plane are flattened onto it.
        depth = reversed_map_of(
            casters, light.clip(casters.vertices), self.resolution, self.subpixels, light.is_directional
        )
        return self._state(depth, scene, light)

    def from_map(self, stored: Any, scene: Scene) -> EngineMap:
        """The result of `prepare`, with the engine's map instead of this package's.

        `stored` is the depth texture with its rows flipped, so that the bottom row comes first; for cascades (k, n, n),
        its layers. For the arguments and errors see `AbstractEngineShadows.from_map`.
        """
        light = self.cameras_of(scene)
        return self._state(self.checked_map(stored, light, is_depth=True), scene, light)

    def _state(self, depth: Float[Array, "*l h w"], scene: Scene, light: EngineCameras) -> EngineMap:
        state = self.with_depth(depth, scene, light, [1.0] * len(scene.meshes))
        return dataclasses.replace(state, unit="reversed")

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        return of_casters(each_of(self.side, scene.meshes, "side"), scene)

    def cameras_of(self, scene: Scene) -> EngineCameras:
        """The light of `scene` with the engine's cameras.

        **Raises** `ValueError` as `prepare` does.
        """
        light = scene.light
        match light:
            case DirectionalLight():
                return self._fitted(scene, light)
            case SpotLight():
                near, tangent = self.shadow_map_near_z, math.tan(math.radians(plain([light.outer_angle])[0]))
                view = inverse_pose(_axes_about(plain(light.direction)), plain(light.position))
                return EngineCameras.of(
                    [_camera(view, cone_projection(tangent, near, math.inf), near, _INFINITY)], True
                )
            case MatrixLight():
                one = camera_of(light)
                if light.is_perspective:
                    return EngineCameras.of([one], True)
                return EngineCameras.of([one], False, scene.camera, [self.maximum_distance])
        raise refused_light(light, self.settings.kinds)

    def _fitted(self, scene: Scene, light: DirectionalLight) -> EngineCameras:
        """A directional light's cameras: squares as wide as the longest diagonal of the camera's view, in whole world
        units, at whole texels."""
        axes = upright_axes(plain(light.direction), 0.0)
        ends = self._bounds()
        if not self.minimum_distance < ends[0] <= ends[-1]:
            raise ValueError(
                f"the first cascade is from {self.minimum_distance:g} to {ends[0]:g}, and the last ends at "
                f"{ends[-1]:g}; expected minimum_distance < first_cascade_far_bound <= maximum_distance: change one"
            )
        begins = [self.minimum_distance, *((1 - self.overlap_proportion) * end for end in ends)]
        cameras = []
        for begin, end in zip(begins, ends, strict=False):
            corners = frustum_corners(scene.camera, begin, end)
            longest = max(np.linalg.norm(corners[0] - corners[6]), np.linalg.norm(corners[4] - corners[6]))
            width = math.ceil(float(longest))
            texel = width / self.resolution[0]
            across = corners @ axes.T
            least, most = across.min(axis=0), across.max(axis=0)
            centre = np.floor((least + most) / 2 / texel) * texel
            eye, far = np.array([centre[0], centre[1], most[2]]) @ axes, float(most[2] - least[2])
            projection = parallel_projection(width / 2, 0.0, far)
            cameras.append(_camera(inverse_pose(axes, eye), projection, 0.0, far))
        return EngineCameras.of(cameras, False, scene.camera, ends)

    def _bounds(self) -> list[float]:
        """The end of each cascade."""
        if self.num_cascades == 1:
            return [self.maximum_distance]
        first, count = self.first_cascade_far_bound, self.num_cascades
        base = (self.maximum_distance / first) ** (1 / (count - 1))
        return [first * base**k for k in range(count)]

    def plain(self, frame: LightFrame, distance: float) -> PlainBias:
        radius = castano_radius(_SIZES[self.shadow_filtering_method])
        offset = float(self.shadow_normal_bias) * _DIAGONAL
        return PlainBias(float(self.shadow_depth_bias), 0, offset, 1, "constant", radius)

    def bounds(self, lights: Sequence[tuple[LightFrame, float]]) -> dict[str, tuple[float, float, float]]:
        texel = max(frame.texel for frame, _ in lights)
        return {
            "shadow_depth_bias": (_START * texel, 0.0, _MOST * texel),
            "shadow_normal_bias": (Settings.shadow_normal_bias, 0.0, _MOST_NORMAL),
        }

    def biased(self, frame: LightFrame, shift: float, offset: float, distance: float) -> "Bevy":
        normal = offset / frame.texel / _DIAGONAL
        return dataclasses.replace(self, shadow_depth_bias=shift, shadow_normal_bias=normal)

    def code(self, given: EngineLight, distances: tuple[float, float], origin: Origin = WORLD) -> list[str]:
        is_spot = given.type == "spot"
        normal = float(self.shadow_normal_bias)
        kind = "SpotLight" if is_spot else "DirectionalLight"
        at = f"Transform::from_xyz({_floats(place(given.position, origin))})" if is_spot else "Transform::default()"
        turned = (
            f"looking_at(Vec3::new({_floats(place(given.target or (), origin))}), Vec3::Y)"
            if is_spot
            else f"looking_to(Vec3::new({', '.join(map(_float, given.direction or ()))}), Vec3::Y)"
        )
        fields = {
            "shadow_maps_enabled": "true",
            "shadow_depth_bias": _float(float(self.shadow_depth_bias)),
            "shadow_normal_bias": _float(normal),
        }
        if is_spot and given.angle is not None:
            fields |= {"outer_angle": _float(given.angle), "range": _float(given.far)}
            fields |= {"shadow_map_near_z": _float(self.shadow_map_near_z)}
        values = ", ".join(f"{name}: {value}" for name, value in fields.items())
        parts = [f"{kind} {{ {values}, ..default() }}", f"{at}.{turned}"]
        if not is_spot:
            names = (
                *("num_cascades", "minimum_distance", "maximum_distance"),
                *("first_cascade_far_bound", "overlap_proportion"),
            )
            settings = {name: getattr(self, name) for name in names}
            written = ", ".join(f"{name}: {_written(value)}" for name, value in settings.items())
            parts.insert(1, f"CascadeShadowConfigBuilder {{ {written} }}.build()")
        culls = {"front": "Some(Face::Back)", "back": "Some(Face::Front)", "double": "None"}
        sides = self.side if isinstance(self.side, tuple) else (self.side,)
        return [
            "// Bevy 0.19.",
            f"// shadow_depth_bias: {about(float(self.shadow_depth_bias))} world units towards the light;",
            f"// shadow_normal_bias: {about(normal * _DIAGONAL)} texels along the normal.",
            f"commands.insert_resource(DirectionalLightShadowMap {{ size: {self.resolution[0]} }});",
            f"commands.entity(camera).insert(ShadowFilteringMethod::{self.shadow_filtering_method});",
            "commands.spawn((",
            *(f"    {part}," for part in parts),
            "));",
            f"// cull_mode of each material: {', '.join(culls[side] for side in sides)}",
        ]

    def visibility(self, state: EngineMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        Points outside of a directional light's cascade, or beyond the last cascade, are lit. Under a spot light, points
        outside of the map are compared with the map's border. Faces away from the light are compared like all other
        faces.
        """
        return _visibility(self, state, surface)


def _float(value: float) -> str:
    return _floats(number(value))


def _floats(numbers: str) -> str:
    """Numbers separated by commas, as Rust's floats. Whole numbers have a point."""
    return ", ".join(text if any(each in text for each in ".e") else f"{text}.0" for text in numbers.split(", "))


def _written(value: float | int) -> str:
    return str(value) if isinstance(value, int) else _float(value)


def camera_of(light: MatrixLight) -> CameraOfLight:
    """The camera of a light given by its matrices."""
    given, matrices = light.view(), (light.world_to_eye, light.eye_to_clip)
    pose, projection = (np.asarray(each) for each in matrices)
    return _camera(pose, projection, float(given.near), float(given.far))


def _camera(view: HostArray, projection: HostArray, near: float, far: float) -> CameraOfLight:
    to_clip = in_single(reversed_depth(projection), view)
    return CameraOfLight(view, projection, near, far, to_clip, to_clip)


def _axes_about(direction: Any) -> Float[HostArray, "3 3"]:
    """The right, up and back directions of a spot light whose up direction is not +y (Duff et al. 2017)."""
    x, y, z = back = -np.asarray(direction, np.float64) / np.linalg.norm(direction)
    sign = 1.0 if z >= 0 else -1.0
    a = -1 / (sign + z)
    b = x * y * a
    return np.array([(1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y), back])


@eqx.filter_jit
def _visibility(settings: Bevy, state: EngineMap, surface: Surface) -> Visibility:
    _, receives = state.of_pixels(surface)
    light = state.light
    assert isinstance(light, EngineCameras)
    normal = normalize(surface.interpolated_normal)
    of = _under_spot if light.is_perspective else _under_sun
    return jnp.where(receives, of(settings, state, light, surface.position, normal), 1)


def _under_sun(
    settings: Bevy, state: EngineMap, light: EngineCameras, points: Float[Array, "h w 3"], normal: Float[Array, "h w 3"]
) -> Float[Array, "h w"]:
    size = state.resolution[0]
    towards = settings.shadow_depth_bias * light.towards(points)

    def in_cascade(cascade: tuple[Array, Array, Array, Array]) -> Float[Array, "h w"]:
        depth, to_clip, scale, span = cascade
        texel = 2 / (scale * size)
        at = in_order(to_clip, points + (settings.shadow_normal_bias * _DIAGONAL) * texel * normal + towards)
        x, y, z = (at[..., k] for k in range(3))
        inside = (jnp.abs(x) <= 1) & (jnp.abs(y) <= 1) & (z >= 0) & (z <= 1)
        compared = settings.compared(-z, texel / span)
        u, v = (jnp.where(inside, each * 0.5 + 0.5, 0.5) for each in (x, y))
        return jnp.where(inside, tent(-depth, u, v, compared, _SIZES[settings.shadow_filtering_method]), 1)

    depths = state.depth if state.depth.ndim > 2 else state.depth[None]
    lit = lax.map(in_cascade, (depths, light.to_window, light.eye_to_clip[:, 0, 0], light.far - light.near))
    assert light.ends is not None
    depth, result = light.depth(points), lit[-1]
    for k in range(light.count - 2, -1, -1):
        begin = (1 - settings.overlap_proportion) * light.ends[k]
        share = jnp.clip((depth - begin) / (light.ends[k] - begin), 0, 1)
        result = jnp.where(depth < light.ends[k], lit[k] + (lit[k + 1] - lit[k]) * share, result)
    return jnp.where(depth < light.ends[-1], result, 1)


def _under_spot(
    settings: Bevy, state: EngineMap, light: EngineCameras, points: Float[Array, "h w 3"], normal: Float[Array, "h w 3"]
) -> Float[Array, "h w"]:
    view, size = light.view(), state.resolution[0]
    distance, towards = view.distance(points), light.towards(points)
    scale = view.eye_to_clip[0, 0]
    at_unit = 2 / (scale * size)
    offset = normal * (settings.shadow_normal_bias * _DIAGONAL * at_unit * distance)[..., None]
    moved = settings.shadow_depth_bias * normalize(towards) + offset - towards
    # Only its axes, because the light is at the origin.
    x, y, z = (jnp.sum(light.world_to_eye[0, k, :3] * moved, axis=-1) for k in range(3))
    ahead = z < 0
    along = jnp.where(ahead, -z, 1)
    depth = view.near / along
    u, v = (jnp.where(ahead, each * scale / along * 0.5 + 0.5, 0.5) for each in (x, y))
    compared = settings.compared(-depth, at_unit * view.near / along)
    lit = tent(-state.depth, u, v, compared, _SIZES[settings.shadow_filtering_method])
    return jnp.where(ahead, lit, 1)
