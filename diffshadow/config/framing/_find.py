"""Finds the parts of a scene that a configuration leaves to the program."""

import math
import os
import pickle
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ... import geometry
from ..._types import HostArray
from ...settings import scene as settings
from ..sections._config import Config
from ..sections._scene import DirectionalLightConfig, MeshConfig
from ._auto import Asked
from ._meshes import place_mesh

# Digits of lengths, relative to the scene's size.
_DIGITS = 4
# The numbers of cached meshes, of cached boxes, and of cached scenes with found parts. Views and runs share them.
_MAX_KEPT, _MAX_BOXES, _MAX_ARRANGED = 4, 4096, 64
_kept: dict[str, Float[HostArray, "f 3 3"]] = {}
_boxes: dict[str, Float[HostArray, "2 3"]] = {}
_arranged: dict[bytes, geometry.Arranged] = {}


class Found(NamedTuple):
    """The section `scene` with the parts that were found, and a sentence without a full stop for each."""

    scene: dict[str, Any]
    notes: tuple[str, ...]


def find(config: Config, scene: Mapping[str, Any], asked: Asked) -> Found | None:
    """Finds the `asked` parts of `scene`. `None` if one of its meshes cannot be made, because building the mesh reports
    this.

    **Arguments:**

    - `config`: valid, with other values for these parts; `scene`: the section as given.
    """
    try:
        meshes = [corners_of(mesh) for mesh in config.scene.meshes]
    except (ValueError, OSError):
        return None
    corners = np.concatenate(meshes)
    casts = np.repeat([mesh.casts for mesh in config.scene.meshes], [len(each) for each in meshes])
    camera = config.scene.camera
    up = np.asarray(camera.up, float)
    # The first light represents all lights.
    first = next(iter(config.scene.each_light.values()))
    light = frame_light(first, meshes[0]) if asked.sun or not asked.light else None
    view = None if asked.camera else _given_camera(camera, meshes[0])
    given = geometry.Given(light, view, _lens(camera), casts, up)
    wanted = geometry.Wanted(asked.camera, asked.light and light is None, asked.ground)
    key = pickle.dumps(([_key_of(mesh) for mesh in config.scene.meshes], given, wanted))
    found = _remembered(_arranged, _MAX_ARRANGED, key, lambda: geometry.arrange(corners, given, wanted))
    return _written(scene, found, corners, up, asked)


def _written(
    scene: Mapping[str, Any], found: geometry.Arranged, corners: Float[HostArray, "f 3 3"], up: HostArray, asked: Asked
) -> Found:
    """The section `scene` with the found parts."""
    size = np.ptp(corners, axis=(0, 1))
    places = _DIGITS - math.floor(math.log10(max(float(np.linalg.norm(size)), np.finfo(np.float32).tiny)))
    number = lambda value: float(f"{round(float(value), places):.12g}") + 0.0
    point = lambda values: [number(value) for value in values]
    written = {key: value for key, value in scene.items() if key != "ground"}
    notes = []
    if found.camera is not None:
        camera: dict[str, Any] = {"eye": point(found.camera.eye), "target": point(found.camera.target)}
        given = {key: value for key, value in (scene.get("camera") or {}).items() if value is not None}
        if given.get("type") == "orthographic":
            camera["height"] = number(found.camera.height)
        elif found.is_room:
            camera["fov_y"] = geometry.ROOM_FOV
        written["camera"] = {**camera, **given}
        where = "from inside the room" if found.is_room else "with the casters and their shadows in the picture"
        notes.append(f"scene.camera was found, {where}: eye {camera['eye']}, target {camera['target']}")
    if asked.light:
        given = {key: value for key, value in scene["light"].items() if key != "type" and value is not None}
        written["light"], said = _light(found, given, point, number, up)
        notes.append(f"scene.light was found: {said}")
    if asked.ground:
        if found.plane is None:
            what = "it is a room" if found.is_room else "it has one"
            notes.append(f"scene.ground adds nothing to the scene, because {what}")
        else:
            middle, side = point(found.plane[0]), number(found.plane[1])
            plane: dict[str, Any] = {"path": "builtin:plane", "options": {"size": side}, "translate": middle}
            if up[1] != np.linalg.norm(up):
                plane["rotate"] = [*geometry.angles_of(geometry.turn_up(up).T)]
            written["meshes"] = [*scene["meshes"], plane]
            notes.append(f"scene.ground was found: a plane of {side:g} world units at {middle}")
    shown = " × ".join(f"{side:.3g}" for side in size)
    notes.append(f"the meshes are {shown} world units large; lengths and normal offsets are in these units")
    return Found(written, tuple(notes))


def _light(
    found: geometry.Arranged, given: dict[str, Any], point: Any, number: Any, up: HostArray
) -> tuple[dict[str, Any], str]:
    """The section of a found light, and its name in remarks."""
    if found.lamp is not None:
        position, radius = point(found.lamp[0]), number(found.lamp[1])
        lamp = {"type": "point", "position": position, "radius": radius}
        given = {key: value for key, value in given.items() if key in settings.PointLight.__annotations__}
        return {**lamp, **given}, f"a lamp under the ceiling, at {position}"
    if found.sun is None or found.direction is None:
        # Some of its angles are given; the others have their defaults.
        return {"type": "directional", **given}, "a sun with the angles that are given"
    if up[1] == np.linalg.norm(up):
        azimuth, elevation = found.sun
        return {"type": "directional", "azimuth": azimuth, "elevation": elevation, **given}, (
            f"a sun at azimuth {azimuth:g} and elevation {elevation:g} degrees"
        )
    direction = [round(float(each), 6) + 0.0 for each in found.direction]
    return {"type": "directional", "direction": direction, **given}, f"a sun that shines along {direction}"


def _lens(camera: Any) -> geometry.Lens:
    rows, columns = camera.resolution
    half = math.tan(math.radians(getattr(camera, "fov_y", settings.PinholeCamera.fov_y)) / 2)
    return geometry.Lens((half * columns / rows, half), hasattr(camera, "fov_y"))


def frame_light(light: Any, first: Float[HostArray, "f 3 3"]) -> geometry.FrameLight:
    """The direction or the position of a light's section; `first` has the triangles of the scene's first mesh."""
    if isinstance(light, DirectionalLightConfig):
        if light.direction is not None:
            return geometry.FrameLight(np.asarray(light.direction, float))
        assert light.azimuth is not None
        assert light.elevation is not None
        return geometry.frame_sun(light.azimuth, light.elevation)
    if light.position is not None:
        return geometry.FrameLight(None, np.asarray(light.position, float))
    return geometry.FrameLight(None, _orbited(light.orbit, first))


def _given_camera(camera: Any, first: Float[HostArray, "f 3 3"]) -> tuple[HostArray, HostArray]:
    middle = _middle(first)
    eye = _orbited(camera.orbit, first) if camera.eye is None else np.asarray(camera.eye, float)
    return eye, middle if camera.target is None else np.asarray(camera.target, float)


def _middle(corners: Float[HostArray, "f 3 3"]) -> Float[HostArray, "3"]:
    return (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2


def _orbited(orbit: Any, first: Float[HostArray, "f 3 3"]) -> Float[HostArray, "3"]:
    middle = _middle(first)
    radius = float(np.linalg.norm(first - middle, axis=-1).max())
    direction = geometry.frame_sun(orbit.azimuth, orbit.elevation).direction
    assert direction is not None
    return middle - orbit.distance * radius * direction


def corners_of(section: MeshConfig) -> Float[HostArray, "f 3 3"]:
    """The triangles of a mesh in the world, in double precision. Warnings about its file come when the scene is
    built."""

    def make() -> Float[HostArray, "f 3 3"]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            placed = place_mesh(section)
        return placed.vertices[np.asarray(placed.faces)]

    return _remembered(_kept, _MAX_KEPT, _key_of(section), make)


def box_of(section: MeshConfig) -> Float[HostArray, "2 3"]:
    """The minimum and maximum coordinates of a mesh in the world."""

    def make() -> Float[HostArray, "2 3"]:
        corners = corners_of(section)
        return np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])

    return _remembered(_boxes, _MAX_BOXES, _key_of(section), make)


def _key_of(section: MeshConfig) -> str:
    """The key of a mesh's triangles."""
    key = section.model_dump_json()
    if section.builtin is None:
        state = os.stat(section.path)
        key += f"{state.st_mtime_ns} {state.st_size}"
    return key


def _remembered[K, V](kept: dict[K, V], most: int, key: K, make: Callable[[], V]) -> V:
    """The result of `make`, cached for later calls with this key. The oldest result is dropped first."""
    if key not in kept:
        made = make()
        while len(kept) >= most:
            del kept[next(iter(kept))]
        kept[key] = made
    return kept[key]
