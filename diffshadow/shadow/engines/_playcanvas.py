"""The shadows of PlayCanvas (2.23, WebGL2, without clustered lighting)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_number, dot, in_unit_range, normalize, safe_norm
from ..._checks import as_tuple
from ..._types import AsScalar, HostArray, Resolution, Visibility
from ...geometry import (
    WORLD,
    AbstractLight,
    DirectionalLight,
    MatrixLight,
    Mesh,
    Origin,
    PointLight,
    Scene,
    SpotLight,
)
from ...raster import Surface
from ...settings import maps
from ...settings.engines import PlayCanvas as Settings
from ...settings.engines import PlayCanvasShadow, Side, Sides
from .._compare import AbstractCompare, HardCompare
from .._technique import of_casters
from ._abstract import AbstractEngineShadows
from ._axes import refused_light, upright_axes
from ._cameras import (
    QUARTERS,
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
    sphere_from_mean,
    split_depths,
    viewport,
)
from ._code import about, number, place
from ._convert import LightFrame, PlainBias
from ._engine_map import EngineMap, distance_map_of, each_of, sloped_map_of
from ._given import fitted_directional_light, playcanvas_omni_light, playcanvas_spot_light
from ._light import EngineLight, plain
from ._taps import TentSize, castano_radius, mean_of, tent
from ._textures import bilinear_in_cube, place_in_cube, rounded, with_borders

_WHOLE = viewport(0.0, 0.0, 1.0)
_SIZES: dict[PlayCanvasShadow, TentSize] = {"PCF1_32F": 1, "PCF3_32F": 3, "PCF5_32F": 5}
# The bias of a directional light's receivers, in window depth.
_HIDDEN_BIAS = 1e-4
# Slopes of the polygon offset, and fractions of the range, per unit of `shadow_bias`.
_SLOPES, _PARTS = 10.0, 0.01
# The maximum of a point light's map, and the near plane of point and spot lights as a fraction of their range.
_FARTHEST, _NEAR = 0.99999, 1e-3
# A light that is weaker than this fraction casts no shadow.
_FAINT = 1e-5
# The minimum difference between the cosines of a cone's angles.
_NO_RIM = 1e-7
# The bound of the normal offset in a fit.
_MOST_TEXELS = 4.0
_TETRAHEDRON = np.array([(1, 1, 1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1)], np.float32)
# The camera of a directional light: its near plane, and the space in front of the nearest caster.
_FIRST, _ROOM = 0.01, 0.1
# The camera's distance behind the scene before its depth range is known, in world units.
_AWAY = 1e6


class PlayCanvas(AbstractEngineShadows):
    """The shadows of PlayCanvas 2.23 on WebGL2 with `scene.clusteredLightingEnabled = false`. Fields have the engine's
    names in `LightComponent`. A directional light has the engine's cameras, which are fitted to the view of the scene's
    camera up to `shadow_distance`. Only the direction of the light matters.

    - `shadow_type`: the filter: one bilinear compare, or a tent over 3 or 5 texels. Under a point light, both tents are
        four compares.
    - `shadow_bias`: from 0 to 1. Under directional and spot lights, casters are drawn with a polygon offset whose
        factor is ten times this number. Under a point light, receivers move by this number times a hundredth of the
        light's range.
    - `normal_offset_bias`: the shift of receivers along their normals, in world units. Under a point light, it is
      multiplied by the distance to the light and by 1 - cos θ.
    - `shadow_intensity`: intensity of the shadow, from 0 to 1.
    - `shadow_distance`: depth up to which a directional light casts shadows, world units.
    - `num_cascades`, `cascade_distribution`: the number of a directional light's cascades, which share the map, and the
      logarithmic share of their spacing. The engine's `cascadeBlend`, whose noise depends on the device, is 0.
    - `side`: the faces that the meshes' materials keep (`material.cull`), which therefore cast; one value for all
        meshes, or one for each.
    - `resolution`, `subpixels`, `compare`: see `AbstractEngineShadows`. Maps are square.

    The polygon offset has a derivative through the slopes of the casters that the map was drawn with. If the bias
    changes the nearest caster, this shows only after the map is drawn again. Under a directional light, receivers also
    move towards the light by 1e-4 of the depth range. The engine fits this range to the bounding boxes of the casters.

    **Raises** `ValueError` for a map that is not square.
    """

    settings: ClassVar = Settings

    shadow_bias: AsScalar = eqx.field(converter=as_number, default=Settings.shadow_bias)
    normal_offset_bias: AsScalar = eqx.field(converter=as_number, default=Settings.normal_offset_bias)
    shadow_intensity: AsScalar = eqx.field(converter=as_number, default=Settings.shadow_intensity)
    compare: AbstractCompare = HardCompare()
    shadow_type: PlayCanvasShadow = eqx.field(static=True, default=Settings.shadow_type)
    shadow_distance: float = eqx.field(static=True, default=Settings.shadow_distance)
    num_cascades: int = eqx.field(static=True, default=Settings.num_cascades)
    cascade_distribution: float = eqx.field(static=True, default=Settings.cascade_distribution)
    side: Sides = eqx.field(static=True, converter=as_tuple, default=Settings.side)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=maps.ShadowMap.resolution)
    subpixels: int = eqx.field(static=True, default=Settings.subpixels)

    directional_light = staticmethod(fitted_directional_light)
    spot_light = staticmethod(playcanvas_spot_light)
    omni_light = staticmethod(playcanvas_omni_light)

    def prepare(self, scene: Scene, surface: Surface | None = None) -> EngineMap:
        """The map of the scene's only light. It does not depend on `surface`.

        **Raises** `ValueError` for an area light, for cascades of a light that is not a `DirectionalLight`, or if
        `side` does not have one value or one for each mesh.
        """
        light = self.cameras_of(scene)
        casters = self.casters(scene)
        if isinstance(light, PointLight):
            depth = distance_map_of(casters, light, self.resolution, self.subpixels)
            return self._state(jnp.where(depth < 1, jnp.minimum(depth, _FARTHEST), 1), scene, light)
        factor = _SLOPES * self.shadow_bias
        size = quarter_of(self.resolution, light.count)
        drawn = sloped_map_of(casters, light.clip(casters.vertices), size, self.subpixels, factor, factor)
        return dataclasses.replace(self._state(drawn.depth, scene, light), slope=drawn.slope, drawn_with=factor)

    def from_map(self, stored: Any, scene: Scene) -> EngineMap:
        """The result of `prepare`, with the engine's map instead of this package's.

        `stored` is the depth texture; for a point light, its first channel. Cascades are arranged in it as in the
        engine. For the arguments and errors see `AbstractEngineShadows.from_map`.
        """
        light = self.cameras_of(scene)
        depth = self.checked_map(stored, light, is_depth=True)
        if isinstance(light, PointLight):
            return self._state(depth, scene, light)
        layers = of_quarters(depth, light.count, QUARTERS)
        return dataclasses.replace(self.prepare(scene), depth=layers)

    def _state(self, depth: Float[Array, "*l h w"], scene: Scene, light: AbstractLight) -> EngineMap:
        state = self.with_depth(depth, scene, light, [1.0] * len(scene.meshes))
        return dataclasses.replace(state, unit="distance" if isinstance(light, PointLight) else "window")

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        return of_casters(each_of(self.side, scene.meshes, "side"), scene)

    def cameras_of(self, scene: Scene) -> EngineCameras | PointLight:
        """The light of `scene` with the engine's cameras.

        **Raises** `ValueError` as `prepare` does.
        """
        light = scene.light
        match light:
            case PointLight():
                return PointLight(light.position, _NEAR * light.far, light.far)
            case DirectionalLight():
                return self._fitted(scene, light)
            case SpotLight():
                axes, far = _axes_of(light.direction), plain([light.far])[0]
                near, tangent = _NEAR * far, float(np.tan(np.deg2rad(plain([light.outer_angle])[0])))
                view, projection = (
                    inverse_pose(_as_kept(axes), plain(light.position)),
                    cone_projection(tangent, near, far),
                )
                angle = light.inner_angle
                inner = None if angle is None else jnp.cos(jnp.deg2rad(angle))
                return dataclasses.replace(
                    EngineCameras.of([_camera(view, projection, near, far)], True), inner_cosine=inner
                )
            case MatrixLight():
                is_spot = light.is_perspective
                ends = None if is_spot else [self._end(scene)]
                return EngineCameras.of([camera_of(light)], is_spot, None if is_spot else scene.camera, ends)
        raise refused_light(light, self.settings.kinds)

    def _end(self, scene: Scene) -> float:
        return min(float(scene.camera.far), self.shadow_distance)

    def _fitted(self, scene: Scene, light: DirectionalLight) -> EngineCameras:
        """A directional light's cameras: squares around bounding spheres of the camera's view, in steps of two texels.
        Their depth is that of the casters' boxes inside."""
        axes = _axes_of(light.direction)
        near, end = float(scene.camera.near), self._end(scene)
        ends = split_depths(near, end, self.num_cascades, self.cascade_distribution)
        sides = self.casting_sides(scene)
        boxes = [_Box.about(mesh) for mesh, side in zip(scene.meshes, sides, strict=True) if side is not None]
        cameras = []
        for index, (begin, depth) in enumerate(zip([near, *ends], ends, strict=False)):
            centre, radius = sphere_from_mean(frustum_corners(scene.camera, begin, depth))
            steps = self.resolution[0] / 4 / radius
            at = axes @ centre
            at[:2] = np.ceil(at[:2] * steps) / steps
            eye, far = _behind(at @ axes, axes, [box for box in boxes if box.meets(axes, at, radius)])
            place = _WHOLE if self.num_cascades == 1 else viewport(*QUARTERS[index], 0.5)
            view, projection = inverse_pose(_as_kept(axes), eye), parallel_projection(radius, _FIRST, far)
            cameras.append(_camera(view, projection, _FIRST, far, place))
        return EngineCameras.of(cameras, False, scene.camera, ends)

    def plain(self, frame: LightFrame, distance: float) -> PlainBias:
        """The bias without the polygon offset, which no other engine can set."""
        radius = castano_radius(_SIZES[self.shadow_type])
        offset = float(self.normal_offset_bias)
        if frame.kind == "point":
            shift = _PARTS * float(self.shadow_bias) * frame.far
            return PlainBias(shift, 0, offset * distance / frame.texel, 1, "one_minus_cosine", radius)
        shift = _HIDDEN_BIAS * (frame.far - frame.near) if frame.kind == "directional" else 0.0
        return PlainBias(shift, 0, offset / frame.texel, 0, "constant", radius)

    def bounds(self, lights: Sequence[tuple[LightFrame, float]]) -> dict[str, tuple[float, float, float]]:
        offset = max(frame.texel / (at if frame.kind == "point" else 1) for frame, at in lights)
        return {
            "shadow_bias": (Settings.shadow_bias, 0.0, 1.0),
            "normal_offset_bias": (0.0, 0.0, min(_MOST_TEXELS * offset, 1.0)),
        }

    def biased(self, frame: LightFrame, shift: float, offset: float, distance: float) -> "PlayCanvas":
        if frame.kind == "point":
            values = {"shadow_bias": shift / frame.far / _PARTS, "normal_offset_bias": offset / distance}
            return dataclasses.replace(self, **{name: min(value, 1.0) for name, value in values.items()})
        if shift:
            raise ValueError("PlayCanvas has no constant bias under directional and spot lights; expected none")
        return dataclasses.replace(self, shadow_bias=0.0, normal_offset_bias=min(offset, 1.0))

    def code(self, given: EngineLight, distances: tuple[float, float], origin: Origin = WORLD) -> list[str]:
        is_point, bias = given.type == "point", float(self.shadow_bias)
        amount = (
            f"{about(_PARTS * bias * given.far)} world units towards the light"
            if is_point
            else f"casters move away by {about(_SLOPES * bias)} of their depth's steps from texel to texel"
        )
        lines = ["app.scene.clusteredLightingEnabled = false;  // with it, spot and omni lights share another map"]
        if given.type != "directional":
            lines += [f"entity.setPosition({place(given.position, origin)});"]
        if given.target is not None:
            target = given.target if given.type == "spot" else given.direction
            way = ", ".join(map(number, target or ()))
            # Added to its position, which does not matter.
            moved = f"entity.getPosition().clone().add(new pc.Vec3({way}))"
            towards = moved if given.type == "directional" else place(target or (), origin)
            lines += [f"entity.lookAt({towards});", "entity.rotateLocal(90, 0, 0);  // it shines along its -y"]
        values: dict[str, str] = {"castShadows": "true", "shadowType": f"pc.SHADOW_{self.shadow_type}"}
        values["shadowResolution"] = str(self.resolution[0])
        if given.type == "directional":
            values |= {"shadowDistance": number(self.shadow_distance), "numCascades": str(self.num_cascades)}
            if self.num_cascades > 1:
                values["cascadeDistribution"] = number(self.cascade_distribution)
        else:
            values["range"] = number(given.far)
        if given.angle is not None:
            values["outerConeAngle"] = f"{number(math.degrees(given.angle))};  // degrees"
        values["shadowBias"] = f"{number(bias)};  // {amount}"
        unit = "parts of the distance, times 1 - cos θ" if is_point else "world units"
        values["normalOffsetBias"] = f"{number(float(self.normal_offset_bias))};  // {unit}"
        if float(self.shadow_intensity) != 1:
            values["shadowIntensity"] = number(float(self.shadow_intensity))
        lines += [f"entity.light.{name} = {text}{'' if ';' in text else ';'}" for name, text in values.items()]
        culls = {"front": "BACK", "back": "FRONT", "double": "NONE"}
        if isinstance(self.side, tuple):
            lines += [f"// material.cull of each mesh: {', '.join(f'pc.CULLFACE_{culls[one]}' for one in self.side)}"]
        else:
            lines += [f"material.cull = pc.CULLFACE_{culls[self.side]};"]
        others = "shadowDistance and view camera" if given.type == "directional" else "range"
        return [
            "// PlayCanvas 2.23, WebGL2.",
            f"// Valid for this map size, {others}: fit it again for others.",
            *lines,
        ]

    def visibility(self, state: EngineMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        Points beyond the light's range, cone or `shadow_distance` are lit. Other points outside of the map are compared
        with the map's border. Faces away from the light are compared like all other faces.
        """
        return _visibility(self, state, surface)


def camera_of(light: MatrixLight) -> CameraOfLight:
    """The camera of a light given by its matrices."""
    given, matrices = light.view(), (light.world_to_eye, light.eye_to_clip)
    pose, projection = (np.asarray(each) for each in matrices)
    return _camera(pose, projection, float(given.near), float(given.far))


def _camera(
    view: HostArray, projection: HostArray, near: float, far: float, place: HostArray | None = None
) -> CameraOfLight:
    to_clip = in_single(projection, view)
    to_window = in_single(_WHOLE if place is None else place, to_clip)
    return CameraOfLight(view, projection, near, far, to_clip, to_window)


def _axes_of(direction: Any) -> Float[HostArray, "3 3"]:
    """The right, up and back directions of the node of a light's camera. The camera's view stores them again.

    `lookAt` and `rotateLocal(90, 0, 0)` have rotated the light, which shines along its -y.
    """
    right, up, back = _as_kept(upright_axes(plain(direction), 0.0))
    right, back, down = _as_kept(np.stack([right, back, -up]))
    return np.stack([right, -down, back])


def _as_kept(axes: Float[HostArray, "3 3"]) -> Float[HostArray, "3 3"]:
    """Axes with the engine's rounding: single precision, then a quaternion, whose rounding affects the last bits."""
    (a, b, c), (d, e, f), (g, h, i) = (row / np.linalg.norm(row) for row in axes.astype(np.float32).astype(np.float64))
    if i < 0:
        parts = (1 + a - e - i, b + d, g + c, f - h) if a > e else (b + d, 1 - a + e - i, f + h, g - c)
    else:
        parts = (g + c, f + h, 1 - a - e + i, b - d) if a < -e else (f - h, g - c, b - d, 1 + a + e + i)
    x, y, z, w = np.array(parts) / np.linalg.norm(parts)
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
            (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
            (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
        ]
    )


class _Box(NamedTuple):
    """The bounding box of a mesh along the world's axes: its minimum and maximum coordinates."""

    low: Float[HostArray, "3"]
    high: Float[HostArray, "3"]

    @classmethod
    def about(cls, mesh: Mesh) -> "_Box":
        vertices = np.asarray(mesh.vertices, np.float64)
        return cls(vertices.min(axis=0), vertices.max(axis=0))

    def meets(self, axes: Float[HostArray, "3 3"], centre: Float[HostArray, "3"], radius: float) -> bool:
        """Whether it overlaps the square window around `centre`, in the light's `axes`."""
        middle, half = (self.high + self.low) / 2 @ axes.T, (self.high - self.low) / 2 @ np.abs(axes).T
        return bool((np.abs(middle - centre)[:2] < half[:2] + radius).all())


def _behind(
    centre: Float[HostArray, "3"], axes: Float[HostArray, "3 3"], boxes: Sequence[_Box]
) -> tuple[HostArray, float]:
    """The position of a directional light's camera that sees one box around all `boxes`, and its far plane.

    The engine measures from far behind the scene, in single precision. The resulting rounding is part of its depth
    range.
    """
    eye = centre + _AWAY * axes[2]
    if not boxes:
        return eye, 2 * _AWAY
    ends = np.stack([np.min([box.low for box in boxes], axis=0), np.max([box.high for box in boxes], axis=0)])
    corners = np.stack(np.meshgrid(*ends.T.tolist()), axis=-1).reshape(8, 3)
    depths = corners @ (view := inverse_pose(axes, eye)).astype(np.float64)[2, :3] + float(view[2, 3])
    return eye + (depths.max() + _ROOM) * axes[2], float(depths.max() - depths.min() + 2 * _ROOM)


@eqx.filter_jit
def _visibility(settings: PlayCanvas, state: EngineMap, surface: Surface) -> Visibility:
    _, receives = state.of_pixels(surface)
    of = _in_cube if isinstance(state.light, PointLight) else _in_window
    lit = of(settings, state, surface)
    return jnp.where(receives, in_unit_range(1 + (lit - 1) * settings.shadow_intensity), 1)


def _in_window(settings: PlayCanvas, state: EngineMap, surface: Surface) -> Float[Array, "h w"]:
    light = state.light
    assert isinstance(light, EngineCameras)
    layer = light.layer(surface.position)
    offset = rounded(settings.normal_offset_bias * normalize(surface.interpolated_normal))
    position = surface.position + offset
    view = light.view().facing(layer)
    distance = view.distance(position)
    per_texel = view.texel_size(distance, state.resolution) * view.depth_slope(distance)
    at = light.window(position, layer)
    if light.is_perspective:
        ahead = at[..., 3] > 0
        u, v, z = (jnp.where(ahead, at[..., k] / jnp.where(ahead, at[..., 3], 1), 0) for k in range(3))
        is_shone_on = _in_cone(light, surface.position)
    else:
        u, v, z = at[..., 0], at[..., 1], jnp.clip(at[..., 2], 0, 1) - _HIDDEN_BIAS
        is_shone_on = light.is_shadowed(surface.position)
    compared = settings.compared(z, per_texel, is_strict=True)
    depth = in_quarters(state.sloped(_SLOPES * settings.shadow_bias), QUARTERS, 1.0)
    return jnp.where(is_shone_on, tent(depth, u, v, compared, _SIZES[settings.shadow_type]), 1)


def _in_cone(light: EngineCameras, points: Float[Array, "h w 3"]) -> Array:
    """Whether a spot light shines on `points` with more than a faint fraction of its strength."""
    view = light.view()
    distance = safe_norm(points - light.position)
    outer = 1 / jnp.sqrt(1 + 1 / view.eye_to_clip[1, 1] ** 2)
    inner = outer if light.inner_cosine is None else light.inner_cosine
    from_edge = view.distance(points) / jnp.where(distance > 0, distance, 1) - outer
    share = jnp.clip(from_edge / jnp.maximum(inner - outer, _NO_RIM), 0, 1)
    return share * share * (3 - 2 * share) * jnp.maximum(1 - distance / view.far, 0) >= _FAINT


def _in_cube(settings: PlayCanvas, state: EngineMap, surface: Surface) -> Float[Array, "h w"]:
    light = state.light
    assert isinstance(light, PointLight)
    normal = normalize(surface.interpolated_normal)
    towards = surface.position - light.position
    distance = safe_norm(towards)
    away = in_unit_range(1 + dot(normal, normalize(towards)))
    moved = towards + normal * (settings.normal_offset_bias * away * distance)[..., None]
    reached = safe_norm(moved)
    z = reached / light.far - _PARTS * settings.shadow_bias
    size = state.depth.shape[-1]
    _, _, _, along = place_in_cube(moved)
    compared = settings.compared(z, 2 * along / size / light.far, is_strict=True)
    bordered = with_borders(state.depth)
    if settings.shadow_type == "PCF1_32F":
        lit = bilinear_in_cube(bordered, moved, compared)
    else:
        unit = moved / jnp.where(reached > 0, reached, 1)[..., None]
        lit = mean_of(lambda tap: bilinear_in_cube(bordered, unit + tap / size, compared), _TETRAHEDRON, z.shape)
    return jnp.where(distance < light.far * (1 - _FAINT), lit, 1)
