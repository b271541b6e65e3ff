"""Builds the scene of a configuration: its meshes, its camera and its lights."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ... import geometry, shadow
from ..._arithmetic import as_float
from ..._types import HostArray, Vec3
from ...settings import scene
from ...settings.techniques import Mapped
from .._errors import ConfigError, KeyPath, Location, Mistake, dotted
from ..framing._meshes import Placed, Triple, place_mesh
from ..sections._config import Config
from ..sections._scene import (
    DirectionalLightConfig,
    OrthographicCameraConfig,
    PinholeCameraConfig,
    PointLightConfig,
    RectangleLightConfig,
    ShadowCamera,
    SpotLightConfig,
)

# 120 bytes per triangle, with normals, colours and indices.
_MAX_TRIANGLES = 1 << 25
# Margin around the scene along the view axis, as a fraction of its depth.
_MARGIN = 0.01
# Minimum near distance of a perspective view, as a fraction of far: a nearer plane would waste depth precision.
_MIN_NEAR = 1e-3


class Surroundings(NamedTuple):
    """The surroundings of cameras and lights: all points (n, 3), the casters' points (m, 3), and the first mesh's
    centre and radius. All are relative to `origin`, a point of the world."""

    points: Float[HostArray, "n 3"]
    casters: Float[HostArray, "m 3"]
    middle: Float[HostArray, "3"]
    radius: float
    origin: geometry.Origin

    def place(self, point: Triple) -> Float[HostArray, "3"]:
        """A `point` of the world, in double precision."""
        return np.asarray(point, np.float64) - np.asarray(self.origin)

    def around(self, azimuth: float, elevation: float, distance: float) -> Vec3:
        """The point at `distance` radii from the centre, in the direction given by angles in degrees."""
        return geometry.orbit_eye(as_float(self.middle), distance * self.radius, azimuth, elevation)


def surroundings_of(
    whole: geometry.Mesh, casters: geometry.Mesh, first: geometry.Mesh, origin: geometry.Origin = geometry.WORLD
) -> Surroundings:
    used = lambda mesh: np.asarray(mesh.vertices)[np.unique(mesh.faces)]
    corners = used(first)
    middle = np.asarray(first.bounds).mean(axis=0)
    radius = float(np.linalg.norm(corners - middle, axis=-1).max())
    return Surroundings(used(whole), used(casters), middle, radius, origin)


class BuiltMeshes(NamedTuple):
    """The meshes of a configuration, and the surroundings of its camera and its lights."""

    meshes: list[geometry.Mesh]
    surroundings: Surroundings

    def scene(
        self, config: Config, camera: geometry.AbstractCamera, lights: Sequence[geometry.AbstractLight]
    ) -> geometry.Scene:
        """The scene of `config` with this `camera` and these `lights`."""
        casts = tuple(mesh.casts for mesh in config.scene.meshes)
        receives = tuple(mesh.receives for mesh in config.scene.meshes)
        return geometry.Scene(self.meshes, camera, lights, casts, receives, self.surroundings.origin)


@contextmanager
def blame(config: Config, path: KeyPath, origin: geometry.Origin = geometry.WORLD) -> Iterator[None]:
    """Reports errors raised inside as mistakes of the key at `path`. Coordinates in their texts are relative to
    `origin`."""
    try:
        yield
    except ConfigError:
        raise
    except geometry.OptionError as error:
        raise ConfigError([Mistake(*at(config, (*path, "options", error.option)), error.what)]) from error
    except (ValueError, OSError) as error:
        where = "" if origin == geometry.WORLD else f" (coordinates are relative to the scene's origin, {[*origin]})"
        raise ConfigError([Mistake(*at(config, path), f"{error}{where}")]) from error


def at(config: Config, path: KeyPath) -> tuple[Location, str]:
    """The name of the key at `path`, and the place where it was written."""
    return config.origin.place(path), dotted(path)


def build_scene(config: Config, built: BuiltMeshes | None = None) -> geometry.Scene:
    """The scene of `config`: its meshes, its camera and its lights, all relative to the scene's origin.

    **Arguments:** `built`: the result of `build_meshes`, if it is already known.

    Warns with `io.MeshWarning` about contents of mesh files other than triangles.

    **Raises** `ConfigError` with the key of each mesh, camera or light that cannot be made, and of each open caster if
    only back faces cast.

    !!! Example

        ```python
        settings = config.parse_config("scene: {meshes: [{path: builtin:torus}], camera: {resolution: [32, 32]}}")
        config.build_scene(settings).camera.resolution  # (32, 32)
        ```
    """
    built = build_meshes(config) if built is None else built
    return built.scene(config, build_camera(config, built), build_lights(config, built))


def build_meshes(config: Config) -> BuiltMeshes:
    """The meshes of `config`, and the surroundings for its camera and its lights.

    **Raises** `ConfigError` as `build_scene` does.
    """
    placed = _meshes_of(config)
    origin = geometry.origin_of(np.concatenate([mesh.bounds for mesh in placed]))
    meshes = [mesh.counted_from(origin) for mesh in placed]
    _check_closed(config, meshes)
    casts = [mesh.casts for mesh in config.scene.meshes]
    casters = geometry.merge([mesh for mesh, does in zip(meshes, casts, strict=True) if does])
    return BuiltMeshes(meshes, surroundings_of(geometry.merge(meshes), casters, meshes[0], origin))


def build_camera(config: Config, built: BuiltMeshes) -> geometry.AbstractCamera:
    """The camera of `config`.

    **Raises** `ConfigError` if it cannot be made.
    """
    with blame(config, ("scene", "camera"), built.surroundings.origin):
        return camera_on(config.scene.camera, built.surroundings)


def build_lights(config: Config, built: BuiltMeshes) -> list[geometry.AbstractLight]:
    """The lights of `config`.

    **Raises** `ConfigError` if one cannot be made.
    """
    lights = []
    for key, light in config.scene.each_light.items():
        with blame(config, ("scene", *key), built.surroundings.origin):
            lights.append(light_on(light, built.surroundings))
    return lights


def _meshes_of(config: Config) -> list[Placed]:
    """The scene's meshes, in the world.

    **Raises** `ConfigError` with a mistake for each mesh that cannot be made.
    """
    meshes, mistakes, triangles = [], [], 0
    for i, section in enumerate(config.scene.meshes):
        try:
            with blame(config, ("scene", "meshes", i)):
                mesh = place_mesh(section)
                triangles += mesh.faces.shape[0]
                if triangles > _MAX_TRIANGLES:
                    raise ValueError(
                        f"brings the scene to {triangles:,} triangles; expected at most {_MAX_TRIANGLES:,}, which "
                        "take 4 GB; simplify it, or leave meshes out"
                    )
                meshes.append(mesh)
        except ConfigError as error:
            mistakes += error.mistakes
            if triangles > _MAX_TRIANGLES:
                break
    if mistakes:
        raise ConfigError(mistakes)
    return meshes


def _check_closed(config: Config, meshes: list[geometry.Mesh]) -> None:
    """**Raises** `ConfigError` for every open mesh that casts, if only back faces cast."""
    if not isinstance(config.technique, Mapped) or config.shadow_map.cull != "front":
        return
    what = (
        "is an open mesh that casts shadows, while shadow_map.cull is front; expected closed meshes, because only "
        "back faces cast: set casts: false if it only receives, or shadow_map.cull to none"
    )
    mistakes = [
        Mistake(*at(config, ("scene", "meshes", i)), what)
        for i, (mesh, section) in enumerate(zip(meshes, config.scene.meshes, strict=True))
        if section.casts and not geometry.Edges.of(mesh).is_closed
    ]
    if mistakes:
        raise ConfigError(mistakes)


def camera_on(config: scene.Camera, surroundings: Surroundings) -> geometry.AbstractCamera:
    assert isinstance(config, PinholeCameraConfig | OrthographicCameraConfig)
    single = lambda point: np.asarray(point, np.float32)
    target = single(surroundings.middle if config.target is None else surroundings.place(config.target))
    if config.eye is not None:
        eye = single(surroundings.place(config.eye))
    else:
        assert config.orbit is not None
        eye = single(surroundings.around(config.orbit.azimuth, config.orbit.elevation, config.orbit.distance))
    if bool((eye == target).all()):
        raise ValueError(f"the camera's eye and target are both {eye.tolist()}; expected two points: move one of them")
    up = single(config.up)
    # The extent of the scene across the view and along it. The function that makes the camera's view is already
    # compiled.
    rows = np.asarray(geometry.look_at(eye, target - eye, up), np.float64)[:3, :3]
    across, upwards, backward = ((surroundings.points - eye) @ rows.T).T
    near, far = _depth_range(-backward, perspective=isinstance(config, PinholeCameraConfig))
    near = near if config.near is None else config.near
    far = far if config.far is None else config.far
    if isinstance(config, PinholeCameraConfig):
        return geometry.PinholeCamera(
            eye, target, up, fov_y=as_float(config.fov_y), near=near, far=far, resolution=config.resolution
        )
    rows, columns = config.resolution
    needed = 2 * max(np.abs(upwards).max(), np.abs(across).max() * rows / columns) * (1 + _MARGIN)
    height = float(needed) if config.height is None else config.height
    return geometry.OrthographicCamera(eye, target, up, height=height, near=near, far=far, resolution=config.resolution)


def _depth_range(depth: Float[HostArray, " n"], *, perspective: bool) -> tuple[float, float]:
    """Near and far that tightly bound the points at `depth` (n,) along the view axis; all in world units.

    **Raises** `ValueError` if `perspective` and all points are behind the eye.
    """
    low, high = float(depth.min()), float(depth.max())
    if perspective and high <= 0:
        raise ValueError(
            f"the whole scene is behind the camera (its depth is {low:.4g} to {high:.4g} world units); "
            "expected a part of it in front: change the camera's eye or target"
        )
    # A scene seen edge-on also needs a depth range.
    margin = max(_MARGIN * (high - low), _MIN_NEAR * max(abs(low), abs(high)))
    near, far = low - margin, high + margin
    return (max(near, _MIN_NEAR * far) if perspective else near), far


def light_on(config: scene.Light, surroundings: Surroundings) -> geometry.AbstractLight:
    """The light of `config` in its surroundings.

    **Raises** `ValueError` if it cannot be placed there.
    """
    if isinstance(config, DirectionalLightConfig):
        return _directional(config, surroundings)
    assert isinstance(config, PointLightConfig | SpotLightConfig | RectangleLightConfig)
    points = as_float(surroundings.points)
    if config.position is not None:
        position = as_float(surroundings.place(config.position))
    else:
        assert config.orbit is not None
        position = surroundings.around(config.orbit.azimuth, config.orbit.elevation, config.orbit.distance)
    match config:
        case PointLightConfig():
            tight = geometry.PointLight.around(position, points, radius=config.radius, guard=config.guard)
        case SpotLightConfig():
            tight = geometry.SpotLight.around(
                position,
                points,
                target=_target(config, surroundings),
                outer_angle=config.outer_angle,
                radius=config.radius,
                inner_angle=config.inner_angle,
                aspect=config.aspect,
            )
        case RectangleLightConfig():
            tight = geometry.RectangleLight.around(
                position,
                points,
                as_float(config.size),
                target=_target(config, surroundings),
                outer_angle=config.outer_angle,
                up=as_float(config.up),
            )
    near = tight.near if config.near is None else config.near
    far = tight.far if config.far is None else config.far
    # The constructor checks near and far.
    return type(tight)(**{**vars(tight), "near": near, "far": far})


def _directional(config: DirectionalLightConfig, surroundings: Surroundings) -> geometry.DirectionalLight:
    if config.direction is not None:
        direction = as_float(config.direction)
    else:
        assert config.azimuth is not None
        assert config.elevation is not None
        centre = as_float(np.zeros(3, np.float32))
        direction = as_float(-np.asarray(geometry.orbit_eye(centre, 1.0, config.azimuth, config.elevation)))
    if config.shadow_camera is not None:
        return _seen_by(config.shadow_camera, direction, config.angular_radius, surroundings)
    points, around = as_float(surroundings.points), geometry.DirectionalLight.around
    if config.frame == "scene":
        return around(direction, points, config.angular_radius)
    return around(direction, as_float(surroundings.casters), config.angular_radius, receivers=points)


def _seen_by(
    camera: ShadowCamera, direction: Vec3, angular_radius: float, surroundings: Surroundings
) -> geometry.DirectionalLight:
    """The light along `direction` with a map that `camera` draws.

    **Raises** `ValueError` if the camera sees nothing of the scene.
    """
    position = surroundings.place(camera.position)
    light = shadow.ThreeJs.directional_light(
        position,
        position + np.asarray(direction),
        **camera.model_dump(exclude={"position"}),
        angular_radius=angular_radius,
    )
    rows = np.asarray(light.view().world_to_eye, np.float64)[:3, :3]
    low = np.array([camera.left, camera.bottom, -camera.far])
    high = np.array([camera.right, camera.top, -camera.near])
    seen = (surroundings.points - position) @ rows.T
    least, most = seen.min(axis=0), seen.max(axis=0)
    for sides, k, sign in (("left and right", 0, 1), ("bottom and top", 1, 1), ("near and far", 2, -1)):
        if least[k] > high[k] or most[k] < low[k]:
            given, scene = sorted((sign * low[k], sign * high[k])), sorted((sign * least[k], sign * most[k]))
            raise ValueError(
                f"shadow_camera sees nothing of the scene: its {sides} are {given[0]:.4g} and {given[1]:.4g}, and "
                f"the scene extends from {scene[0]:.4g} to {scene[1]:.4g}, measured from its position; expected an "
                "overlap: "
                "change them, or the position"
            )
    return light


def _target(config: SpotLightConfig | RectangleLightConfig, surroundings: Surroundings) -> Vec3 | None:
    return None if config.target is None else as_float(surroundings.place(config.target))
