"""The shadows of Godot (4.6, Compatibility renderer)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_number, dot, in_unit_range, normalize, safe_norm
from ..._checks import as_tuple
from ..._types import AsScalar, HostArray, Resolution, Scalar, Visibility
from ...geometry import WORLD, AbstractLight, DirectionalLight, MatrixLight, Origin, PointLight, Scene, SpotLight
from ...raster import Surface
from ...settings import maps
from ...settings.engines import GodotCompatibility as Settings
from ...settings.engines import GodotMode, GodotQuality, Side, Sides
from .._compare import AbstractCompare, HardCompare
from .._technique import of_casters
from ._abstract import AbstractEngineShadows
from ._axes import refused_light, upright_axes
from ._cameras import (
    CameraOfLight,
    EngineCameras,
    cone_projection,
    frustum_corners,
    in_quarters,
    in_single,
    inverse_pose,
    of_quarters,
    parallel_projection,
    quarter_of,
    reversed_depth,
    sphere_from_mean,
    viewport,
)
from ._code import about, number, place
from ._convert import LightFrame, PlainBias
from ._engine_map import Casters, Corners, EngineMap, distance_map_of, each_of, reversed_map_of
from ._given import fitted_directional_light, godot_omni_light, godot_spot_light
from ._light import EngineLight, plain
from ._taps import mean_of
from ._textures import bilinear, bilinear_in_cube, place_in_cube, with_borders

_CROSS = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
# The first taps. If they agree, the engine takes no others.
_FIRST = [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2)]
_DIAMOND = [*_FIRST, *_CROSS[1:], (1, 1), (-1, 1), (1, -1), (-1, -1)]
# From this many taps on, the mean of the first ones is used if they agree.
_SAME = 2e-7
_TAPS: dict[GodotQuality, list[tuple[int, int]]] = {
    "HARD": _CROSS[:1],
    "SOFT_VERY_LOW": _CROSS[:1],
    "SOFT_LOW": _CROSS,
    "SOFT_MEDIUM": _CROSS,
    "SOFT_HIGH": _DIAMOND,
    "SOFT_ULTRA": _DIAMOND,
}
# The ends of the four splits, as shares of the depths.
_SPLITS = (0.1, 0.2, 0.5, 1.0)
# Fractions of the depth range, and of a spot light's range, per unit of `shadow_bias`.
_PARTS, _SPOT_PARTS = 0.01, 0.1
# Normal offset of positional lights, per unit of the distance and divided by the size of their part of the atlas.
_POSITIONAL = 10.0
# Near plane of spot lights, world units.
_NEAR = 0.025
# Each split has a quarter, at these corners.
_PLACES = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))
_MOST_BIAS, _MOST_NORMAL = 10.0, 4.0


class GodotCompatibility(AbstractEngineShadows):
    """The shadows of Godot 4.6 in its Compatibility renderer. Forward+ and Mobile draw different shadows. Fields have
    the engine's names in `Light3D`, `DirectionalLight3D` and the project's settings. A directional light has the
    engine's cameras, which are fitted to the view of the scene's camera up to `directional_shadow_max_distance`. Only
    the direction of the light matters.

    - `soft_filter_quality`: one bilinear compare, or the mean of 5 or 13 compares. Under a point light, it is always
      one compare.
    - `shadow_bias`: moves casters' vertices away from the light, along the rays from the light's camera. Under a
        directional light, the unit is a hundredth of the depth range over the distance; under a spot light, a tenth of
        the light's range over the distance; under a point light, world units. It changes the map, so it has no
        derivative under directional and spot lights.
    - `shadow_normal_bias`: the shift of receivers along their normals, at each vertex. Under a directional light, it is
      in texels, and smaller on faces away from the light. Otherwise `10 / size` of the distance times 1 - |cos θ|,
      where size is the size of the light's part of the atlas.
    - `directional_shadow_mode`: one camera, or four splits.
    - `directional_shadow_max_distance`, `directional_shadow_pancake_size`: the shadow distance, and the depth of the
      space for casters in front of the camera's view, in world units.
    - `directional_shadow_fade_start`: the fraction of the shadow distance where shadows begin to fade out.
    - `side`: the faces that the meshes' materials keep, which therefore cast; one value for all meshes, or one for
        each.
    - `resolution`, `subpixels`, `compare`: see `AbstractEngineShadows`. Maps are square. Under a point light it is the
        resolution of a cube's face, half as wide as the light's part of the atlas.

    The offset of vertices is interpolated over their triangles, so large and small triangles have different offsets.

    **Raises** `ValueError` for a map that is not square.
    """

    settings: ClassVar = Settings

    shadow_bias: AsScalar = eqx.field(converter=as_number, default=Settings.shadow_bias)
    shadow_normal_bias: AsScalar = eqx.field(converter=as_number, default=Settings.shadow_normal_bias)
    compare: AbstractCompare = HardCompare()
    soft_filter_quality: GodotQuality = eqx.field(static=True, default=Settings.soft_filter_quality)
    directional_shadow_mode: GodotMode = eqx.field(static=True, default=Settings.directional_shadow_mode)
    directional_shadow_max_distance: float = eqx.field(static=True, default=Settings.directional_shadow_max_distance)
    directional_shadow_pancake_size: float = eqx.field(static=True, default=Settings.directional_shadow_pancake_size)
    directional_shadow_fade_start: float = eqx.field(static=True, default=Settings.directional_shadow_fade_start)
    side: Sides = eqx.field(static=True, converter=as_tuple, default=Settings.side)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=maps.ShadowMap.resolution)
    subpixels: int = eqx.field(static=True, default=Settings.subpixels)

    directional_light = staticmethod(fitted_directional_light)
    spot_light = staticmethod(godot_spot_light)
    omni_light = staticmethod(godot_omni_light)

    def lays_out(self, name: str) -> bool:
        return name == "shadow_bias"

    def prepare(self, scene: Scene, surface: Surface | None = None) -> EngineMap:
        """The map of the scene's only light. It does not depend on `surface`.

        **Raises** `ValueError` for an area light, or if `side` does not have one value or one for each mesh.
        """
        light, casters = self.cameras_of(scene), self.casters(scene)
        if isinstance(light, PointLight):
            return self._state(distance_map_of(casters, light, self.resolution, self.subpixels), scene, light)
        clip = _pushed(light, casters, self.shadow_bias)
        size = quarter_of(self.resolution, light.count)
        depth = reversed_map_of(casters, clip, size, self.subpixels, light.is_directional)
        return self._state(depth, scene, light)

    def from_map(self, stored: Any, scene: Scene) -> EngineMap:
        """The result of `prepare`, with the engine's map instead of this package's.

        `stored` is the depth texture, with the splits arranged as in the engine. For the arguments and errors see
        `AbstractEngineShadows.from_map`.
        """
        light = self.cameras_of(scene)
        depth = self.checked_map(stored, light, is_depth=True)
        if isinstance(light, PointLight):
            drawn = 1 - depth - self.shadow_bias / light.far
            return self._state(jnp.where(depth > 0, drawn, 1), scene, light)
        return self._state(of_quarters(depth, light.count, _PLACES), scene, light)

    def _state(self, depth: Float[Array, "*l h w"], scene: Scene, light: AbstractLight) -> EngineMap:
        state = self.with_depth(depth, scene, light, [1.0] * len(scene.meshes))
        unit = "distance" if isinstance(light, PointLight) else "reversed"
        return dataclasses.replace(state, unit=unit, corners=Corners.of(scene.mesh))

    @property
    def _count(self) -> int:
        return 4 if self.directional_shadow_mode == "SHADOW_PARALLEL_4_SPLITS" else 1

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        return of_casters(each_of(self.side, scene.meshes, "side"), scene)

    def cameras_of(self, scene: Scene) -> EngineCameras | PointLight:
        """The light of `scene` with the engine's cameras.

        **Raises** `ValueError` as `prepare` does.
        """
        light = scene.light
        match light:
            case PointLight():
                return light
            case DirectionalLight():
                return self._fitted(scene, light)
            case SpotLight():
                far, tangent = plain([light.far])[0], math.tan(math.radians(plain([light.outer_angle])[0]))
                near = min(_NEAR, far)
                view = inverse_pose(upright_axes(plain(light.direction), 0.0), plain(light.position))
                return EngineCameras.of([_camera(view, cone_projection(tangent, near, far), near, far)], True)
            case MatrixLight():
                one = camera_of(light)
                if light.is_perspective:
                    return EngineCameras.of([one], True)
                return EngineCameras.of([one], False, scene.camera, [self._end(scene)])
        raise refused_light(light, self.settings.kinds)

    def _end(self, scene: Scene) -> float:
        return min(float(scene.camera.far), self.directional_shadow_max_distance)

    def _fitted(self, scene: Scene, light: DirectionalLight) -> EngineCameras:
        """A directional light's cameras: squares around bounding spheres of the camera's view, in steps of two
        texels."""
        axes = upright_axes(plain(light.direction), 0.0)
        near, end = float(scene.camera.near), self._end(scene)
        shares = _SPLITS if self._count == 4 else (1.0,)
        ends = [near + share * (end - near) for share in shares]
        size, cameras = quarter_of(self.resolution, self._count)[0], []
        for index, (begin, depth) in enumerate(zip([near, *ends], ends, strict=False)):
            centre, radius = sphere_from_mean(frustum_corners(scene.camera, begin, depth))
            radius *= size / (size - 2)
            step = 4 * radius / size
            at = axes @ centre
            at[:2] = np.floor(at[:2] / step + 0.5) * step
            at[2] += radius + self.directional_shadow_pancake_size
            far = 2 * radius + self.directional_shadow_pancake_size
            part = viewport(0.0, 0.0, 1.0) if self._count == 1 else viewport(*_PLACES[index], 0.5)
            projection = parallel_projection(radius, 0.0, far)
            cameras.append(_camera(inverse_pose(axes, at @ axes), projection, 0.0, far, part))
        return EngineCameras.of(cameras, False, scene.camera, ends)

    def _from_camera(self, frame: LightFrame, distance: float) -> float:
        """The distance of receivers at `distance` from the light's camera. A directional light's camera is behind the
        scene."""
        is_sun = frame.kind == "directional"
        return (frame.far + self.directional_shadow_pancake_size) / 2 if is_sun else distance

    def _shift(self, frame: LightFrame, distance: float) -> float:
        """World units per unit of `shadow_bias`."""
        if frame.kind == "point":
            return 1.0
        push = _PARTS * (frame.far - frame.near) if frame.kind == "directional" else _SPOT_PARTS * frame.far
        return push / self._from_camera(frame, distance)

    def _offset(self, frame: LightFrame, distance: float) -> float:
        """World units per unit of `shadow_normal_bias`, without the profile."""
        if frame.kind == "directional":
            return frame.texel
        return _POSITIONAL / (self.resolution[0] * (2 if frame.kind == "point" else 1)) * distance

    def plain(self, frame: LightFrame, distance: float) -> PlainBias:
        taps = np.array(_TAPS["HARD" if frame.kind == "point" else self.soft_filter_quality])
        radius = 2 * math.sqrt((taps[:, 0] ** 2).mean())
        shift = float(self.shadow_bias) * self._shift(frame, distance)
        offset = float(self.shadow_normal_bias) * self._offset(frame, distance) / frame.texel
        # Under a directional light, 1 - cos θ belongs to the side away from the light.
        profile = "constant" if frame.kind == "directional" else "one_minus_cosine"
        return PlainBias(shift, 0 if frame.kind == "point" else -1, offset, 1, profile, radius)

    def bounds(self, lights: Sequence[tuple[LightFrame, float]]) -> dict[str, tuple[float, float, float]]:
        return {
            "shadow_bias": (Settings.shadow_bias, 0.0, _MOST_BIAS),
            "shadow_normal_bias": (1.0, 0.0, _MOST_NORMAL),
        }

    def biased(self, frame: LightFrame, shift: float, offset: float, distance: float) -> "GodotCompatibility":
        bias, normal = shift / self._shift(frame, distance), offset / self._offset(frame, distance)
        return dataclasses.replace(self, shadow_bias=bias, shadow_normal_bias=normal)

    def code(self, given: EngineLight, distances: tuple[float, float], origin: Origin = WORLD) -> list[str]:
        is_sun, size = given.type == "directional", self.resolution[0]
        of = "directional" if is_sun else "positional"
        lines = [f"# Godot 4.6, Compatibility renderer; for {given.type} lights."]
        if is_sun:
            way = ", ".join(map(number, given.direction or ()))
            lines += [f"light.look_at_from_position(Vector3.ZERO, Vector3({way}))"]
        else:
            lines += [f"light.position = Vector3({place(given.position, origin)})"]
            if given.type == "spot":
                lines += [f"light.look_at(Vector3({place(given.target or (), origin)}))"]
        values: dict[str, str] = {"shadow_enabled": "true"}
        values["shadow_bias"] = number(float(self.shadow_bias))
        values["shadow_normal_bias"] = number(float(self.shadow_normal_bias))
        if is_sun:
            values["directional_shadow_mode"] = f"DirectionalLight3D.{self.directional_shadow_mode}"
            for name in ("max_distance", "pancake_size", "fade_start"):
                values[f"directional_shadow_{name}"] = number(getattr(self, f"directional_shadow_{name}"))
        else:
            values["omni_range" if given.type == "point" else "spot_range"] = number(given.far)
        if given.angle is not None:
            values["spot_angle"] = number(math.degrees(given.angle))
        lines += [f"light.{name} = {value}" for name, value in values.items()]
        quality = f"RenderingServer.SHADOW_QUALITY_{self.soft_filter_quality}"
        lines += [f"RenderingServer.{of}_soft_shadow_filter_set_quality({quality})"]
        if is_sun:
            lines += [f"RenderingServer.directional_shadow_atlas_set_size({size}, false)"]
        else:
            part = size * (2 if given.type == "point" else 1)
            lines += [f"get_viewport().positional_shadow_atlas_size = {2 * part}"]
            lines += ["get_viewport().positional_shadow_atlas_quad_0 = Viewport.SHADOW_ATLAS_QUADRANT_SUBDIV_1"]
        culls = {"front": "back", "back": "front", "double": "disabled"}
        sides = self.side if isinstance(self.side, tuple) else (self.side,)
        lines += [f"# cull mode of each material: {', '.join(culls[side] for side in sides)}"]
        if not is_sun:
            near, far = (about(at) for at in distances)
            lines += [f"# Its light was fitted for receivers from {near} to {far} away."]
        return lines

    def visibility(self, state: EngineMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        Points beyond a directional light's shadows, or a positional light's range, are lit. Other points outside of the
        map are compared with the map's border. Faces away from the light are compared like all other faces.
        """
        return _visibility(self, state, surface)


def camera_of(light: MatrixLight) -> CameraOfLight:
    """The camera of a light given by its matrices."""
    given, matrices = light.view(), (light.world_to_eye, light.eye_to_clip)
    pose, projection = (np.asarray(each) for each in matrices)
    return _camera(pose, projection, float(given.near), float(given.far))


def _camera(
    view: HostArray, projection: HostArray, near: float, far: float, part: HostArray | None = None
) -> CameraOfLight:
    to_clip = in_single(reversed_depth(projection), view)
    # Depth is already from 0 to 1.
    place = viewport(0.0, 0.0, 1.0) if part is None else np.array(part)
    place[2] = (0, 0, 1, 0)
    return CameraOfLight(view, projection, near, far, to_clip, in_single(place, to_clip))


@eqx.filter_jit
def _pushed(light: EngineCameras, casters: Casters, bias: Scalar) -> Float[Array, "*k v 4"]:
    """Clip coordinates of casters that are pushed away from the light's camera along their rays."""
    far, span = light.far, light.far - light.near
    push = bias * (_SPOT_PARTS * far if light.is_perspective else _PARTS * span)
    clips = []
    for k in range(light.count):
        eye = -jnp.sum(light.world_to_eye[k, :3, :3] * light.world_to_eye[k, :3, 3:], axis=0)
        ray = casters.vertices - eye
        squared = jnp.maximum(dot(ray, ray), jnp.finfo(ray.dtype).tiny)[:, None]
        clips.append(light.clip(casters.vertices + ray * (push[k] / squared), k))
    return clips[0] if light.count == 1 else jnp.stack(clips)


@eqx.filter_jit
def _visibility(settings: GodotCompatibility, state: EngineMap, surface: Surface) -> Visibility:
    _, receives = state.of_pixels(surface)
    of = _in_cube if isinstance(state.light, PointLight) else _in_window
    return jnp.where(receives, in_unit_range(of(settings, state, surface)), 1)


def _moved(settings: GodotCompatibility, state: EngineMap, surface: Surface) -> Float[Array, "h w 3"]:
    """Receivers with the normal offset, which is computed separately at each vertex of their triangles."""
    light, size = state.light, settings.resolution[0]
    corners = state.corners
    assert corners is not None
    towards = light.towards(corners.positions)
    cosine = dot(corners.normals, normalize(towards))
    if light.is_directional:
        assert isinstance(light, EngineCameras)
        length, texels = 1 - jnp.maximum(-cosine, 0), 2 / (light.eye_to_clip[:, 0, 0] * state.resolution[0])
        layer = light.layer(surface.position)
        factor = texels[0] if layer is None else texels[layer][..., None]
    else:
        length = (1 - jnp.abs(cosine)) * safe_norm(towards)
        factor = _POSITIONAL / (size * (2 if isinstance(light, PointLight) else 1))
    offset = corners.interpolated(corners.normals * length[..., None], surface)
    return surface.position + offset * (settings.shadow_normal_bias * factor)


def _in_window(settings: GodotCompatibility, state: EngineMap, surface: Surface) -> Float[Array, "h w"]:
    light = state.light
    assert isinstance(light, EngineCameras)
    layer = light.layer(surface.position)
    position = _moved(settings, state, surface)
    at = light.window(position, layer)
    ahead = at[..., 3] > 0
    u, v, z = (jnp.where(ahead, at[..., k] / jnp.where(ahead, at[..., 3], 1), 0) for k in range(3))
    view = light.view().facing(layer)
    distance = jnp.maximum(view.distance(position), view.near)
    per_texel = view.texel_size(distance, state.resolution) * view.depth_slope(distance)
    compared = settings.compared(-z, per_texel, is_strict=True)
    stored = -in_quarters(state.depth, _PLACES, 0.0)
    height, width = stored.shape
    tap = lambda offset: bilinear(stored, u + offset[0] / width, v + offset[1] / height, compared)
    taps = _TAPS[settings.soft_filter_quality]
    lit = mean_of(tap, np.array(taps), u.shape)
    if taps is _DIAMOND:
        first = mean_of(tap, np.array(_FIRST), u.shape)
        lit = jnp.where(first <= _SAME, 0, jnp.where(first >= 1 - _SAME, 1, lit))
    if light.is_perspective:
        return jnp.where(ahead & (safe_norm(light.towards(surface.position)) < view.far), lit, 1)
    assert light.ends is not None
    depth, end = light.depth(surface.position), light.ends[-1]
    begin = settings.directional_shadow_fade_start * end
    share = jnp.clip((depth - begin) / jnp.maximum(end - begin, 1e-6 * end), 0, 1)
    faded = lit + (1 - lit) * share * share * (3 - 2 * share)
    return jnp.where(depth < end, faded, 1)


def _in_cube(settings: GodotCompatibility, state: EngineMap, surface: Surface) -> Float[Array, "h w"]:
    light = state.light
    assert isinstance(light, PointLight)
    towards = _moved(settings, state, surface) - light.position
    distance = safe_norm(towards)
    _, _, _, along = place_in_cube(towards)
    per_texel = 2 * along / state.depth.shape[-1] / light.far
    compared = settings.compared(distance / light.far, per_texel, is_strict=True)
    stored = jnp.where(state.is_drawn, state.depth + settings.shadow_bias / light.far, 1)
    lit = bilinear_in_cube(with_borders(stored), towards, compared)
    return jnp.where(safe_norm(surface.position - light.position) < light.far, lit, 1)
