"""The camera and the lights of a `trimesh.Scene`."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .._arithmetic import as_float
from .._types import HostArray
from ._camera import PinholeCamera
from .lights import AbstractLight, DirectionalLight, PointLight, SpotLight


def camera_of(scene: Any) -> PinholeCamera | None:
    """The camera of `scene`; `None` if the scene has no camera of its own (trimesh makes one on demand)."""
    if not getattr(scene, "has_camera", False):
        return None
    camera, pose = scene.camera, np.asarray(scene.camera_transform, np.float64)
    width, height = (int(pixels) for pixels in camera.resolution)
    return PinholeCamera(
        eye=pose[:3, 3],
        target=pose[:3, 3] - pose[:3, 2],
        up=pose[:3, 1],
        fov_y=float(camera.fov[1]),
        near=float(camera.z_near),
        far=float(camera.z_far),
        resolution=(height, width),
    )


def lights_of(scene: Any, points: Float[Array, "n 3"]) -> tuple[AbstractLight, ...]:
    """The lights of `scene`, with shadow maps fitted to `points`; `None` if the scene has no lights of its own.

    **Raises** `ValueError` for a light that is not a directional, point or spot light.
    """
    # `scene.lights` would create lights.
    lights = getattr(scene, "_lights", None) or ()
    return tuple(_light(light, np.asarray(scene.graph[light.name][0], np.float64), points) for light in lights)


def _light(light: Any, pose: Float[HostArray, "4 4"], points: Float[Array, "n 3"]) -> AbstractLight:
    place, direction = as_float(pose[:3, 3]), as_float(-pose[:3, 2])
    match type(light).__name__:
        case "DirectionalLight":
            return DirectionalLight.around(direction, points)
        case "PointLight":
            return PointLight.around(place, points)
        case "SpotLight":
            outer, inner = (np.rad2deg(angle) for angle in (light.outerConeAngle, light.innerConeAngle))
            return SpotLight.around(
                place, points, target=place + direction, outer_angle=float(outer), inner_angle=float(inner)
            )
    raise ValueError(
        f"the scene's light {light.name!r} is a {type(light).__name__}; expected a DirectionalLight, PointLight or "
        "SpotLight: give lights"
    )
