"""The shadows of Babylon.js (9.34, `ShadowGenerator` on WebGL2)."""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_float, as_number, concrete, dot, in_unit_range, normalize, safe_norm
from ..._checks import as_tuple
from ..._types import AsScalar, Resolution, Scalar, Visibility
from ...geometry import WORLD, AbstractLight, Mesh, Origin, PointLight, Scene
from ...raster import Surface
from ...settings import maps
from ...settings.engines import BabylonFilter, BabylonQuality, Side
from ...settings.engines import BabylonJs as Settings
from .._compare import AbstractCompare, HardCompare
from .._technique import of_casters
from ._abstract import AbstractEngineShadows, Place
from ._axes import engine_light
from ._babylon_filters import exponentially, falloff, random_turn
from ._babylon_maps import (
    box_blurred,
    depth_of_metric,
    exponential,
    kernel_blurred,
    metric_in_cube,
    metric_in_window,
)
from ._babylon_taps import POISSON, POISSON_32, POISSON_64, POISSON_CUBE, POISSON_RADIUS
from ._code import babylon_js_code
from ._convert import OFFSET_PROFILES, LightFrame, PlainBias
from ._engine_map import EngineMap, each_of
from ._given import BABYLON_NUDGE, babylon_directional_light, babylon_point_light, babylon_spot_light
from ._light import EngineLight
from ._taps import Compared, TentSize, castano_radius, mean_of, same, tent
from ._textures import as_half, bilinear, bilinear_in_cube, nearest, nearest_in_cube, place_in_cube, with_borders

TENTS: dict[BabylonQuality, TentSize] = {"LOW": 1, "MEDIUM": 3, "HIGH": 5}
"""The size of the filter `PCF`, in texels."""
# The size of contact hardening's penumbra, in texels.
_MIN_PENUMBRA = 10.0


class BabylonJs(AbstractEngineShadows):
    """The shadows of Babylon.js 9.34, as its `ShadowGenerator` draws them on WebGL2.

    Fields are named after the generator's. The metric is linear in depth: (d - n) / (f - n) at the distance d along the
    axis of a directional or spot light, (r + n) / (f + n) at the distance r of a point light. Near n and far f are the
    engine's `light.shadowMinZ` and `light.shadowMaxZ`.

    - `bias`: added to the depth of casters when the map is drawn: positive values push casters away from the light. Its
      unit is the metric. For `PCF`, and in the compares of `PCSS`, it is depth from -1 to 1, which is half as much in
      window depth. For the blocker search of `PCSS`, both are added.
    - `normal_bias`: the shift of the casters' vertices against their normals, times the sine of the angle to the light,
      in world units. It changes the map, so it has no derivative. The engine does not move meshes without normals.
    - `darkness`: the visibility that a full shadow leaves, from 0 to 1.
    - `blur_scale`: the radius of `POISSONSAMPLING` in texels, or in half texels at a face's centre under a point light.
      For blurred maps, the ratio of the map's size to the blurred map's size, which has no derivative.
    - `depth_scale`: the steepness of exponential maps.
    - `frustum_edge_falloff`: the width of the border over which shadows fade out, as a fraction of the map's half
        width. The border is a circle, so the corners of the map are lit.
    - `contact_hardening_light_size_uv_ratio`: the radius of `PCSS` divided by the width of the map.
    - `filter`: the generator's `FILTER_` constant.
    - `quality`: the generator's `filteringQuality`, for `PCF` and `PCSS`.
    - `blur_kernel`, `blur_box_offset`, `use_kernel_blur`: the blur of exponential maps: the width of the Gaussian in
      texels, the extent of the box to each side in texels, and whether the Gaussian is used.
    - `force_back_faces_only`: whether back faces cast. The engine culls back faces for meshes with its own, clockwise
        winding. For other meshes, such as those of its glTF loader, the setting has no effect: leave it out for these.
    - `back_face_culling`: whether the meshes' materials cull back faces: one value for all meshes, or one for each.
        Without it both sides cast.
    - `float_maps`: `usefullFloatFirst`: whether maps store floats. By default, maps have half floats. Their steps are
        2^-11 for metrics of at least 1/2, ten times the default bias.
    - `resolution`, `subpixels`, `compare`: see `AbstractEngineShadows`. Maps are square.

    Under a point light the engine draws `PCF` and `PCSS` as `POISSONSAMPLING`, and exponential maps without their blur.

    The map stores depths without the bias, which is added later. The bias therefore has a derivative and needs no new
    map. In `PCF` and `PCSS`, the bias also moves casters across the near and far planes, which clip them. The map keeps
    the casters that were visible with its own bias.

    Rounding to half floats has the derivative of the unrounded value. The radius of `POISSONSAMPLING` has a derivative
    through its bilinear taps. In the blocker search of `PCSS`, a soft compare weighs blockers. A total weight of less
    than 1 counts as no blocker.

    The rotation of `PCSS` depends on the device's sine function. Pixels differ between devices, but means agree.

    **Raises** `ValueError` for a map that is not square.
    """

    settings: ClassVar = Settings

    bias: AsScalar = eqx.field(converter=as_number, default=Settings.bias)
    normal_bias: AsScalar = eqx.field(converter=as_number, default=Settings.normal_bias)
    darkness: AsScalar = eqx.field(converter=as_number, default=Settings.darkness)
    blur_scale: AsScalar = eqx.field(converter=as_number, default=Settings.blur_scale)
    depth_scale: AsScalar = eqx.field(converter=as_number, default=Settings.depth_scale)
    frustum_edge_falloff: AsScalar = eqx.field(converter=as_number, default=Settings.frustum_edge_falloff)
    contact_hardening_light_size_uv_ratio: AsScalar = eqx.field(
        converter=as_number, default=Settings.contact_hardening_light_size_uv_ratio
    )
    compare: AbstractCompare = HardCompare()
    filter: BabylonFilter = eqx.field(static=True, default=Settings.filter)
    quality: BabylonQuality = eqx.field(static=True, default=Settings.quality)
    blur_kernel: int = eqx.field(static=True, default=Settings.blur_kernel)
    blur_box_offset: int = eqx.field(static=True, default=Settings.blur_box_offset)
    use_kernel_blur: bool = eqx.field(static=True, default=Settings.use_kernel_blur)
    force_back_faces_only: bool = eqx.field(static=True, default=Settings.force_back_faces_only)
    back_face_culling: bool | tuple[bool, ...] = eqx.field(
        static=True, converter=as_tuple, default=Settings.back_face_culling
    )
    float_maps: bool = eqx.field(static=True, default=Settings.float_maps)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=maps.ShadowMap.resolution)
    subpixels: int = eqx.field(static=True, default=Settings.subpixels)

    directional_light = staticmethod(babylon_directional_light)
    spot_light = staticmethod(babylon_spot_light)
    point_light = staticmethod(babylon_point_light)

    def lays_out(self, name: str) -> bool:
        return name == "normal_bias" or (name == "blur_scale" and self.filter.startswith("BLUR"))

    def prepare(self, scene: Scene, surface: Surface | None = None) -> EngineMap:
        """The map of the scene's only light. Its depths do not include the bias. It does not depend on `surface`.

        A light is drawn like Babylon.js' light at the same position. Babylon.js' light has the frustum of this light,
        and its up direction is +y. The engine's cameras are left-handed, so its map is the mirror image of this light's
        view. Texels run from right to left, and `orthoLeft` and `orthoRight` are the values of this light, swapped and
        with opposite signs. `angle` of a spot light is its full cone in radians. In cube maps, the world's y axis is
        flipped.

        **Raises** `ValueError` for an area light, or if `back_face_culling` does not have one value or one for each
        mesh.
        """
        light = engine_light(scene.light, BABYLON_NUDGE)
        sides = self.casting_sides(scene)
        meshes = [shrunk(mesh, light, self.normal_bias) for mesh in scene.meshes]
        moved = dataclasses.replace(scene, meshes=meshes)
        push = self.bias if self.filter in ("PCF", "PCSS") and not isinstance(light, PointLight) else 0.0
        return self._blurring(self.drawn(moved, light, sides, [0.0] * len(meshes), is_mirrored=True, push=push))

    def from_map(self, stored: Any, scene: Scene) -> EngineMap:
        """The result of `prepare`, with the engine's map instead of this package's.

        `stored` is the depth texture for `PCF` and `PCSS` under directional and spot lights, and otherwise the colour:
        the metric with the bias, or its exponential, before any blur. It is mirrored, as in the engine. For the
        arguments and errors see `AbstractEngineShadows.from_map`.
        """
        light = engine_light(scene.light, BABYLON_NUDGE)
        is_depth = self.filter in ("PCF", "PCSS") and not isinstance(light, PointLight)
        texels = self.checked_map(stored, light, is_depth=is_depth)
        if is_depth:
            depth = jnp.where(texels < 1, texels - self.bias / 2, 1)
        else:
            is_exponential = self.filter in ("EXPONENTIALSHADOWMAP", "BLUREXPONENTIALSHADOWMAP")
            is_drawn = texels > 0 if is_exponential else texels != 1
            metric = -jnp.log(jnp.where(is_drawn, texels, 1)) / self.depth_scale if is_exponential else texels
            depth = jnp.where(is_drawn, depth_of_metric(metric - self.bias, light), 1)
        return self._blurring(self.with_depth(depth, scene, light, [0.0] * len(scene.meshes)))

    def _blurring(self, state: EngineMap) -> EngineMap:
        """`state`, with the size of the blurred map if there is one."""
        if not self.filter.startswith("BLUR") or isinstance(state.light, PointLight):
            return state
        size = max(int(self.resolution[0] / float(self.blur_scale)), 1)
        return dataclasses.replace(state, blurred=(size, size))

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        shown: Side = "back" if self.force_back_faces_only else "front"
        culling = each_of(self.back_face_culling, scene.meshes, "back_face_culling")
        return of_casters([shown if is_culled else "double" for is_culled in culling], scene)

    def plain(self, frame: LightFrame, distance: float) -> PlainBias:
        offset = float(self.normal_bias) / frame.texel
        is_point = frame.kind == "point"
        bias = float(self.bias)
        if self.filter in ("PCF", "PCSS") and not is_point:
            shift, power = bias / 2 / frame.slope(distance), 2
        else:
            # Linear in the distance.
            shift, power = bias * (frame.near + frame.far if is_point else frame.far - frame.near), 0
        return PlainBias(shift, power, offset, 0, OFFSET_PROFILES["Babylon.js"], self._radius(frame))

    def _radius(self, frame: LightFrame) -> float | None:
        kind = self.filter
        if frame.kind == "point" and kind in ("PCF", "PCSS"):
            kind = "POISSONSAMPLING"
        match kind:
            case "NONE":
                return 0.0
            case "POISSONSAMPLING":
                return float(self.blur_scale) * (1.0 if frame.kind == "point" else POISSON_RADIUS)
            case "PCF":
                return castano_radius(TENTS[self.quality])
        return None

    def biased(self, frame: LightFrame, shift: float, offset: float, distance: float) -> "BabylonJs":
        is_point = frame.kind == "point"
        if self.filter in ("PCF", "PCSS") and not is_point:
            bias = 2 * shift * frame.slope(distance)
        else:
            bias = shift / (frame.near + frame.far if is_point else frame.far - frame.near)
        return dataclasses.replace(self, bias=bias, normal_bias=offset)

    def code(self, given: EngineLight, distances: tuple[float, float], origin: Origin = WORLD) -> list[str]:
        return babylon_js_code(self, given, distances, origin)

    def visibility(self, state: EngineMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        Points to the side of the light's frustum are lit. With `PCF` and `PCSS`, points in front of the near plane or
        beyond the far plane are also lit. With other filters, points beyond the far plane stay in shadow. Faces away
        from the light are compared like all other faces.
        """
        return _visibility(self, state, surface)


def shrunk(mesh: Mesh, light: AbstractLight, normal_bias: Scalar) -> Mesh:
    """`mesh` with vertices moved against their normals by `normal_bias` times the sine of the angle to `light`."""
    if concrete(normal_bias) == 0:
        return mesh
    # A vertex with several normals moves to several positions.
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    normals = mesh.corner_normals.reshape(-1, 3)
    cosine = dot(normals, normalize(light.towards(vertices)))
    sine = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0))
    moved = vertices - normals * (normal_bias * sine)[:, None]
    faces = jnp.arange(len(vertices)).reshape(-1, 3)
    return Mesh(moved, faces, mesh.corner_normals, mesh.albedo, mesh.corner_colours, mesh.textures)


@eqx.filter_jit
def _visibility(settings: BabylonJs, state: EngineMap, surface: Surface) -> Visibility:
    _, receives = state.of_pixels(surface)
    of = _in_cube if isinstance(state.light, PointLight) else _in_window
    # With a bias far from 0, the formula of `PCSS` exceeds the lit range.
    return jnp.where(receives, in_unit_range(of(settings, state, surface.position)), 1)


class Receivers(NamedTuple):
    """Receivers in a map: their window coordinates, their metric, and a texel's width in window depth and in metric."""

    u: Float[Array, "h w"]
    v: Float[Array, "h w"]
    z: Float[Array, "h w"]
    metric: Float[Array, "h w"]
    depth_per_texel: Float[Array, "h w"]
    metric_per_texel: Float[Array, "h w"]


def _in_window(settings: BabylonJs, state: EngineMap, position: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    view = state.light.view()
    place = Place.of(position, view, state.resolution, is_mirrored=True)
    distance, span = view.distance(position), view.far - view.near
    metric = (distance - view.near) / span if view.is_perspective else place.z
    per_texel = view.texel_size(jnp.maximum(distance, view.near), state.resolution) / span
    inside = place.in_window
    if settings.filter in ("PCF", "PCSS"):
        inside &= (metric >= 0) & (metric <= 1)
    else:
        metric = jnp.clip(metric, 0, 1)
    u, v = (jnp.where(inside, at, 0.5) for at in (place.u, place.v))
    at = Receivers(u, v, place.z, metric, place.depth_per_texel, per_texel)
    if settings.filter == "PCF":
        tented = tent(_pushed(settings, state.depth), u, v, _strictly(settings, at), TENTS[settings.quality])
        value = _darkened(settings, tented)
    elif settings.filter == "PCSS":
        value = _darkened(settings, _contact_hardening(settings, state, at, random_turn(view.clip(position))))
    else:
        value = _by_metric(settings, state, at)
    x, y = 2 * u - 1, 2 * v - 1
    return jnp.where(inside, value + (1 - value) * falloff(x * x + y * y, settings.frustum_edge_falloff), 1)


def _by_metric(settings: BabylonJs, state: EngineMap, at: Receivers) -> Float[Array, "h w"]:
    """Visibility by the filters that compare metrics."""
    u, v = at.u, at.v
    color = _color(settings, metric_in_window(state.depth, state.light.view()), state.depth < 1)
    compared = settings.compared(at.metric, at.metric_per_texel)
    if settings.filter == "NONE":
        return _darkened(settings, compared(nearest(color, u, v)))
    # In widths of the map.
    step = settings.blur_scale / state.resolution[1]
    if settings.filter == "POISSONSAMPLING":
        tap = lambda offset: compared(bilinear(color, u + offset[0] * step, v + offset[1] * step, same))
        return jnp.minimum(1, mean_of(tap, POISSON, u.shape) + settings.darkness)
    if state.blurred is not None and settings.use_kernel_blur:
        color = kernel_blurred(color, state.blurred, step, settings.blur_kernel, _stored(settings))
    elif state.blurred is not None:
        color = _stored(settings)(box_blurred(color, state.blurred, step, settings.blur_box_offset))
    return _exponentially(settings, bilinear(color, u, v, same), at.metric)


def _in_cube(settings: BabylonJs, state: EngineMap, position: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    light = state.light
    assert isinstance(light, PointLight)
    towards = position - light.position
    distance = safe_norm(towards)
    metric = jnp.clip((distance + light.near) / (light.near + light.far), 0, 1)
    # The map's y axis is reversed.
    unit = towards / jnp.where(distance > 0, distance, 1)[..., None] * jnp.array([1.0, -1.0, 1.0])
    size = state.depth.shape[-1]
    _, _, _, along = place_in_cube(towards)
    per_texel = 2 * jnp.maximum(along, light.near) / size / (light.near + light.far)
    compared = settings.compared(metric, per_texel)
    color = _color(settings, metric_in_cube(state.depth, light), state.depth < 1)
    if settings.filter == "NONE":
        return _darkened(settings, compared(nearest_in_cube(color, unit)))
    bordered = with_borders(color)
    if settings.filter in ("POISSONSAMPLING", "PCF", "PCSS"):
        radius = settings.blur_scale / size
        tap = lambda offset: compared(bilinear_in_cube(bordered, unit + offset * radius, same))
        return jnp.minimum(1, mean_of(tap, POISSON_CUBE, distance.shape) + settings.darkness)
    return _exponentially(settings, bilinear_in_cube(bordered, unit, same), metric)


# --- Contents of maps ---


def _color(settings: BabylonJs, metric: Array, is_drawn: Array) -> Array:
    """The map's colour: the stored metric with the bias, or its exponential."""
    biased = jnp.where(is_drawn, metric + settings.bias, 1)
    if settings.filter in ("EXPONENTIALSHADOWMAP", "BLUREXPONENTIALSHADOWMAP"):
        biased = exponential(biased, settings.depth_scale, is_drawn)
    return _stored(settings)(biased)


def _pushed(settings: BabylonJs, depth: Array) -> Array:
    """The map's window depth. Depths that the bias pushes beyond the far plane are clipped."""
    return jnp.where(depth < 1, jnp.minimum(depth + settings.bias / 2, 1), 1)


def _color_of_pushed(settings: BabylonJs, state: EngineMap) -> Array:
    """The colour next to a depth map: the metric of the depths that the bias has moved, plus the bias."""
    view = state.light.view()
    near, far = view.near, view.far
    metric = metric_in_window(state.depth, view)
    # The bias moves clip depth by itself times w, and the metric is clip depth over its range.
    share = (near + metric * (far - near)) / (near + far) if view.is_perspective else 0.5
    is_drawn = _pushed(settings, state.depth) < 1
    return _stored(settings)(jnp.where(is_drawn, metric + (1 + share) * settings.bias, 1))


def _stored(settings: BabylonJs) -> Callable[[Array], Array]:
    return same if settings.float_maps else as_half


# --- Filters ---


def _strictly(settings: BabylonJs, at: Receivers) -> Compared:
    """The texture unit's compare of window depths."""
    return settings.compared(at.z, at.depth_per_texel, is_strict=True)


def _contact_hardening(
    settings: BabylonJs, state: EngineMap, at: Receivers, turn: Float[Array, "h w"]
) -> Float[Array, "h w"]:
    """Percentage-closer soft shadows (Fernando 2005); the farther the blockers, the lighter.

    **Arguments:**

    - `turn`: the angle by which each receiver's taps are rotated.
    """
    u, v = at.u, at.v
    color, depth = _color_of_pushed(settings, state), _pushed(settings, state.depth)
    ratio = settings.contact_hardening_light_size_uv_ratio
    is_lit, compared = settings.compared(at.metric, at.metric_per_texel), _strictly(settings, at)

    def search(sums: tuple[Array, Array], offset: Array) -> tuple[tuple[Array, Array], None]:
        texel = nearest(color, u + offset[0] * ratio, v + offset[1] * ratio)
        blocks = 1 - is_lit(texel)
        return (sums[0] + blocks, sums[1] + blocks * texel), None

    searched = as_float(POISSON_32[: 32 if settings.quality == "HIGH" else 16])
    blockers, total = lax.scan(search, (jnp.zeros_like(u), jnp.zeros_like(u)), searched)[0]
    is_blocked = blockers >= 1
    behind = at.metric - total / jnp.where(is_blocked, blockers, 1)
    radius = (behind + _MIN_PENUMBRA / state.resolution[1]) * ratio
    cosine, sine = jnp.cos(turn) * radius, jnp.sin(turn) * radius

    def tap(offset: Array) -> Array:
        x, y = offset[0], offset[1]
        return bilinear(depth, u + x * cosine - y * sine, v + y * cosine + x * sine, compared)

    taps = {"LOW": POISSON_32[:16], "MEDIUM": POISSON_32, "HIGH": POISSON_64}[settings.quality]
    lit = mean_of(tap, taps, u.shape)
    return jnp.where(is_blocked, lit + (1 - lit) * behind, 1)


def _exponentially(settings: BabylonJs, texel: Array, metric: Array) -> Array:
    return exponentially(texel, metric, settings.depth_scale, settings.darkness, "CLOSE" in settings.filter)


def _darkened(settings: BabylonJs, lit: Array) -> Array:
    return lit + (1 - lit) * settings.darkness
