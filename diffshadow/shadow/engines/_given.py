"""Lights from the numbers in engines."""

import math
from collections.abc import Sequence

import numpy as np

from ..._types import HostArray, Resolution, Vec3
from ...geometry import DirectionalLight, PointLight, SpotLight
from ...settings import scene
from ...settings.engines import Bevy
from ...settings.maps import ShadowMap
from ...settings.scene import ShadowCamera
from ._axes import is_vertical, upright_axes

Point = Sequence[float] | HostArray | Vec3
"""x, y and z, world units."""

THREE_NUDGE = 1e-4
"""The number that three.js adds to the z of the axis towards a vertical light."""
BABYLON_NUDGE = -1e-13
"""The number that Babylon.js adds to it."""


def three_directional_light(
    position: Point,
    target: Point = (0.0, 0.0, 0.0),
    *,
    left: float = ShadowCamera.left,
    right: float = ShadowCamera.right,
    top: float = ShadowCamera.top,
    bottom: float = ShadowCamera.bottom,
    near: float = ShadowCamera.near,
    far: float = ShadowCamera.far,
    angular_radius: float = scene.DirectionalLight.angular_radius,
) -> DirectionalLight:
    """three.js' `DirectionalLight`, with its `shadow.camera`; defaults are the engine's.

    **Arguments:**

    - `position`, `target`: `light.position` and `light.target.position`, (3,), world units.
    - `left`, `right`, `top`, `bottom`, `near`, `far`: the sides of `light.shadow.camera`, world units from the
        position.
    - `angular_radius`: angular radius of the light's disk, in degrees, for references; the engine has none.

    **Raises** the errors of `DirectionalLight`.
    """
    window = (left, right, top, bottom)
    return _parallel(position, np.subtract(target, position), window, (near, far), angular_radius, THREE_NUDGE)


def three_spot_light(
    position: Point,
    target: Point = (0.0, 0.0, 0.0),
    *,
    angle: float = math.pi / 3,
    penumbra: float = 0.0,
    near: float = ShadowCamera.near,
    far: float = ShadowCamera.far,
    distance: float = 0.0,
    focus: float = 1.0,
    aspect: float = scene.SpotLight.aspect,
    resolution: Resolution = ShadowMap.resolution,
    radius: float = scene.SpotLight.radius,
) -> SpotLight:
    """three.js' `SpotLight`, with its `shadow`; defaults are the engine's.

    **Arguments:**

    - `position`, `target`: `light.position` and `light.target.position`, (3,), world units.
    - `angle`: `light.angle`: the angle from the cone's axis to its side, in radians.
    - `penumbra`: `light.penumbra`, from 0 to 1: the fraction of the angle over which shading falls off.
    - `near`, `far`: distances of the planes of `light.shadow.camera`; `distance`: `light.distance`, which replaces far
        unless it is 0.
    - `focus`, `aspect`: focus and aspect of `light.shadow`.
    - `resolution`: resolution of the map, (height, width). The aspect of the window is the map's, times `aspect`.
    - `radius`: radius of the light's disk, in world units, for references; the engine has none.

    **Raises** the errors of `SpotLight`.
    """
    height, width = resolution
    direction, half_angle = np.subtract(target, position), math.degrees(angle * focus)
    inner, aspect = min(math.degrees(angle * (1 - penumbra)), half_angle), aspect * width / height
    return SpotLight(position, direction, half_angle, near, distance or far, radius, inner, aspect=aspect)


def three_point_light(
    position: Point,
    *,
    near: float = ShadowCamera.near,
    far: float = ShadowCamera.far,
    distance: float = 0.0,
    radius: float = scene.PointLight.radius,
) -> PointLight:
    """three.js' `PointLight`, with its `shadow.camera`; defaults are the engine's.

    **Arguments:**

    - `position`: `light.position`, (3,), world units.
    - `near`, `far`: distances of the planes of `light.shadow.camera`; `distance`: `light.distance`, which replaces far
        unless it is 0.
    - `radius`: radius of the light's sphere, in world units, for references; the engine has none.

    **Raises** the errors of `PointLight`.
    """
    return PointLight(position, near, distance or far, radius)


def babylon_directional_light(
    position: Point,
    direction: Point,
    *,
    ortho_left: float,
    ortho_right: float,
    ortho_top: float,
    ortho_bottom: float,
    shadow_min_z: float,
    shadow_max_z: float,
    shadow_ortho_scale: float = 0.1,
    angular_radius: float = scene.DirectionalLight.angular_radius,
) -> DirectionalLight:
    """Babylon.js' `DirectionalLight` whose `autoUpdateExtends` is false.

    Its camera is left-handed, so its left is this library's right.

    **Arguments:**

    - `position`, `direction`: `light.position` and `light.direction`, (3,), world units.
    - `ortho_left` to `ortho_bottom`: `light.orthoLeft` and the others, world units.
    - `shadow_min_z`, `shadow_max_z`: near and far, world units from the position.
    - `shadow_ortho_scale`: `light.shadowOrthoScale`: the margin of the window on each side, as a fraction of its width
      and of its height.
    - `angular_radius`: angular radius of the light's disk, in degrees, for references; the engine has none.

    **Raises** the errors of `DirectionalLight`.
    """
    across, upwards = ((ortho_right - ortho_left) * shadow_ortho_scale, (ortho_top - ortho_bottom) * shadow_ortho_scale)
    window = (-ortho_right - across, -ortho_left + across, ortho_top + upwards, ortho_bottom - upwards)
    return _parallel(position, direction, window, (shadow_min_z, shadow_max_z), angular_radius, BABYLON_NUDGE)


def babylon_spot_light(
    position: Point,
    direction: Point,
    *,
    angle: float,
    shadow_min_z: float,
    shadow_max_z: float,
    shadow_angle_scale: float = 1.0,
    radius: float = scene.SpotLight.radius,
) -> SpotLight:
    """Babylon.js' `SpotLight`.

    **Arguments:**

    - `position`, `direction`: `light.position` and `light.direction`, (3,), world units.
    - `angle`: `light.angle`: the full cone, in radians.
    - `shadow_min_z`, `shadow_max_z`: near and far, world units. Without them, the engine takes the camera's near and
        far.
    - `shadow_angle_scale`: `light.shadowAngleScale`.
    - `radius`: radius of the light's disk, in world units, for references; the engine has none.

    **Raises** the errors of `SpotLight`.
    """
    half_angle = math.degrees(angle * shadow_angle_scale / 2)
    return SpotLight(position, direction, half_angle, shadow_min_z, shadow_max_z, radius)


def babylon_point_light(
    position: Point, *, shadow_min_z: float, shadow_max_z: float, radius: float = scene.PointLight.radius
) -> PointLight:
    """Babylon.js' `PointLight`.

    **Arguments:**

    - `position`: `light.position`, (3,), world units.
    - `shadow_min_z`, `shadow_max_z`: near and far, world units. Without them, the engine takes the camera's near and
        far.
    - `radius`: radius of the light's sphere, in world units, for references; the engine has none.

    **Raises** the errors of `PointLight`.
    """
    return PointLight(position, shadow_min_z, shadow_max_z, radius)


def _parallel(
    position: Point,
    direction: Point,
    window: tuple[float, float, float, float],
    ends: tuple[float, float],
    angular_radius: float,
    nudge: float,
) -> DirectionalLight:
    """The light of a parallel camera at `position`, with its left, right, top and bottom, and its near and far."""
    left, right, top, bottom = window
    # The light rejects a zero direction.
    is_given = np.isfinite(direction).all() and np.any(direction)
    axes = upright_axes(direction, nudge) if is_given else np.eye(3)
    center = np.asarray(position, np.float64) + (left + right) / 2 * axes[0] + (top + bottom) / 2 * axes[1]
    up = axes[1] if is_given and is_vertical(direction) else (0.0, 1.0, 0.0)
    return DirectionalLight(direction, center, (right - left, top - bottom), *ends, angular_radius, up)


# --- PlayCanvas, Bevy and Godot ---


def fitted_directional_light(
    direction: Point, *, angular_radius: float = scene.DirectionalLight.angular_radius
) -> DirectionalLight:
    """A directional light of an engine that fits its cameras to the view camera.

    **Arguments:**

    - `direction`: the direction in which the light shines, (3,).
    - `angular_radius`: angular radius of the light's disk, in degrees, for references; the engine has none.

    **Raises** the errors of `DirectionalLight`.
    """
    # Any frustum will do. A light in front of it keeps the direction's digits in code.
    return DirectionalLight(direction, (0.0, 0.0, 0.0), (1.0, 1.0), 1.0, 2.0, angular_radius)


def playcanvas_spot_light(
    position: Point,
    direction: Point,
    *,
    range: float = 10.0,
    outer_cone_angle: float = 45.0,
    inner_cone_angle: float = 40.0,
    radius: float = scene.SpotLight.radius,
) -> SpotLight:
    """PlayCanvas' spot light; defaults are the engine's.

    **Arguments:**

    - `position`, `direction`: position of the light's entity, and the direction in which it shines, (3,), world units.
    - `range`: `light.range`, world units; near is a thousandth of it.
    - `outer_cone_angle`, `inner_cone_angle`: angles from the axis, in degrees.
    - `radius`: radius of the light's disk, in world units, for references; the engine has none.

    **Raises** the errors of `SpotLight`.
    """
    return SpotLight(position, direction, outer_cone_angle, range / 1000, range, radius, inner_cone_angle)


def playcanvas_omni_light(
    position: Point, *, range: float = 10.0, radius: float = scene.PointLight.radius
) -> PointLight:
    """PlayCanvas' omni light; the default is the engine's.

    **Arguments:**

    - `position`: position of the light's entity, (3,), world units.
    - `range`: `light.range`, world units; near is a thousandth of it.
    - `radius`: radius of the light's sphere, in world units, for references; the engine has none.

    **Raises** the errors of `PointLight`.
    """
    return PointLight(position, range / 1000, range, radius)


def bevy_spot_light(
    position: Point,
    direction: Point,
    *,
    range: float = 20.0,
    outer_angle: float = math.pi / 4,
    inner_angle: float = 0.0,
    shadow_map_near_z: float = Bevy.shadow_map_near_z,
    radius: float = scene.SpotLight.radius,
) -> SpotLight:
    """Bevy's spot light; defaults are the engine's.

    **Arguments:**

    - `position`, `direction`: position of its transform, and the direction in which it shines, (3,), world units.
    - `range`, `shadow_map_near_z`: distances in world units; the map's far plane is at infinity.
    - `outer_angle`, `inner_angle`: angles from the axis, in radians.
    - `radius`: radius of the light's disk, in world units, for references; without soft shadows the engine has none.

    **Raises** the errors of `SpotLight`.
    """
    outer, inner = math.degrees(outer_angle), math.degrees(inner_angle)
    return SpotLight(position, direction, outer, shadow_map_near_z, range, radius, inner)


def godot_spot_light(
    position: Point,
    direction: Point,
    *,
    spot_range: float = 5.0,
    spot_angle: float = 45.0,
    radius: float = scene.SpotLight.radius,
) -> SpotLight:
    """Godot's spot light; defaults are the engine's.

    **Arguments:**

    - `position`, `direction`: position of its node, and the direction in which it shines, (3,), world units.
    - `spot_range`: world units. `spot_angle`: from the axis, degrees.
    - `radius`: radius of the light's disk, in world units, for references; the Compatibility renderer has none.

    **Raises** the errors of `SpotLight`.
    """
    return SpotLight(position, direction, spot_angle, min(0.025, spot_range / 2), spot_range, radius)


def godot_omni_light(
    position: Point, *, omni_range: float = 5.0, radius: float = scene.PointLight.radius
) -> PointLight:
    """Godot's omni light; the default is the engine's.

    **Arguments:**

    - `position`: position of its node, (3,), world units.
    - `omni_range`: world units.
    - `radius`: radius of the light's sphere, in world units, for references; the Compatibility renderer has none.

    **Raises** the errors of `PointLight`.
    """
    return PointLight(position, omni_range / 1000, omni_range, radius)
