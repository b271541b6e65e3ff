"""Adds a camera, a light and a ground to scenes without them."""

import math

import numpy as np
from jaxtyping import Float

from ... import geometry, io
from ..._types import HostArray
from ...settings.scene import UP, PinholeCamera
from ._settings import check_casters

# Near plane of an added camera, as a fraction of the distance to its target.
_NEAR = 0.01
# All layers of three.js.
_LAYERS = (1 << 32) - 1


def completed(scene: io.SceneFile, camera: str | None, light: str | None, remarks: list[str]) -> io.SceneFile:
    """`scene` with a camera and a light, if it has none and none is named. A remark names the added parts.

    A scene without camera or light also gets a ground if it has none, because its shadow would fall on nothing.

    **Raises** `ValueError` if it has no mesh that casts shadows.
    """
    wanted = geometry.Wanted(
        camera=not scene.cameras and camera is None, light=not scene.lights and light is None, ground=True
    )
    if not (wanted.camera or wanted.light):
        return scene
    check_casters(scene, scene.meshes)
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in scene.meshes])
    found = geometry.arrange(corners, _given(scene), wanted)
    if wanted.light:
        added, said = _light(found, corners)
        remarks.append(f"the file has no light: {said} is added")
        scene = scene._replace(lights=[added])
    if wanted.camera:
        assert found.camera is not None
        fov = geometry.ROOM_FOV if found.is_room else PinholeCamera.fov_y
        forward, distance = _unit(found.camera.target - found.camera.eye)
        eye = tuple(found.camera.eye.tolist())
        view = io.SceneCamera(
            "found", eye, tuple(forward.tolist()), UP, _NEAR * distance, None, fov_y=fov, aspect=1.0, layers=_LAYERS
        )
        where = "in the room" if found.is_room else "that sees the casters and their shadows"
        shown = ", ".join(f"{each:.4g}" for each in eye)
        remarks.append(f"the file has no camera: one {where} is added, at [{shown}]")
        scene = scene._replace(cameras=[view])
    if found.plane is not None:
        middle, side = found.plane
        remarks.append(f"the file has no ground: a square of {side:.4g} world units is added")
        scene = scene._replace(meshes=[*scene.meshes, _square(middle, side)])
    return scene


def _given(scene: io.SceneFile) -> geometry.Given:
    casts = np.repeat([mesh.casts for mesh in scene.meshes], [len(mesh.faces) for mesh in scene.meshes])
    light = view = None
    if scene.lights:
        first = next((each for each in scene.lights if each.casts), scene.lights[0])
        if first.type == "directional":
            light = geometry.FrameLight(np.asarray(first.direction, float))
        else:
            light = geometry.FrameLight(None, np.asarray(first.position, float))
    if scene.cameras:
        eye = np.asarray(scene.cameras[0].eye, float)
        view = eye, eye + np.asarray(scene.cameras[0].forward, float)
    half = math.tan(math.radians(PinholeCamera.fov_y) / 2)
    return geometry.Given(light, view, geometry.Lens((half, half)), casts, np.asarray(UP, float))


def _light(found: geometry.Arranged, corners: Float[HostArray, "f 3 3"]) -> tuple[io.SceneLight, str]:
    if found.lamp is not None:
        position = tuple(found.lamp[0].tolist())
        return io.SceneLight("found", "point", position, None, layers=_LAYERS), "a point light under the ceiling"
    assert found.sun is not None
    assert found.direction is not None
    azimuth, elevation = found.sun
    size = float(np.linalg.norm(np.ptp(corners, axis=(0, 1))))
    middle = (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2
    # Behind every object that it lights.
    position = tuple((middle - size * found.direction).tolist())
    light = io.SceneLight("found", "directional", position, tuple(found.direction.tolist()), layers=_LAYERS)
    return light, f"a sun at azimuth {azimuth:g} and elevation {elevation:g} degrees"


def _square(middle: Float[HostArray, "3"], side: float) -> io.SceneMesh:
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * side / 2
    up = np.tile(np.array([UP]), (4, 1))
    return io.SceneMesh("ground", middle + corners, np.array([[0, 1, 2], [0, 2, 3]]), up, layers=_LAYERS)


def _unit(vector: Float[HostArray, "3"]) -> tuple[Float[HostArray, "3"], float]:
    length = float(np.linalg.norm(vector))
    return vector / length, length
