"""The width of a scene's casters in texels, which the default bias depends on."""

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ... import geometry
from ..._types import HostArray
from ...settings.scene import UP
from ..sections._config import Config
from ..sections._scene import PointLightConfig
from ._find import box_of, corners_of, frame_light

Boxes = Float[HostArray, "m 2 3"]

# A mesh that is thinner than this fraction of its length, such as a ground, is ignored. The length of its shadow
# depends on its height above the receiver.
_FLAT = 1e-3
# The minimum distance of a point in front of a light, in world units.
_NEAR = 1e-6


def texels_across(config: Config) -> Float[HostArray, " n"]:
    """The width of each caster in texels of a single map: the middle side of its bounding box, at its centre. If there
    are several lights, the light with the largest texels counts.

    Meshes without a thickness are left out. The result is empty if a mesh cannot be made, because building the mesh
    reports this.
    """
    try:
        boxes = np.stack([box_of(mesh) for mesh in config.scene.meshes])
        first = corners_of(config.scene.meshes[0])
    except (ValueError, OSError):
        return np.zeros(0)
    casts = np.array([mesh.casts for mesh in config.scene.meshes])
    sides = np.sort(boxes[:, 1] - boxes[:, 0], axis=1)
    counted = casts & (sides[:, 0] > _FLAT * sides[:, 2])
    if not counted.any():
        return np.zeros(0)
    middles, texels = boxes[counted].mean(axis=1), math.sqrt(math.prod(config.shadow_map.resolution))
    widths = [
        _width(light, frame_light(light, first), boxes, casts, middles) for light in config.scene.each_light.values()
    ]
    tiny = np.finfo(np.float32).tiny
    found = [texels * sides[counted, 1] / np.maximum(width, tiny) for width in widths]
    return min(found, key=lambda each: float(np.median(each)))


def _width(
    light: Any,
    placed: geometry.FrameLight,
    boxes: Boxes,
    casts: Bool[HostArray, " m"],
    middles: Float[HostArray, "n 3"],
) -> Float[HostArray, " n"]:
    """The width of a light's map at each position, in world units: the side of a square with the same area."""
    corners = _corners(boxes)
    if placed.position is None:
        if light.shadow_camera is not None:
            of = light.shadow_camera
            return np.full(len(middles), math.sqrt((of.right - of.left) * (of.top - of.bottom)))
        assert placed.direction is not None
        framed = corners if light.frame == "scene" or not casts.any() else _corners(boxes[casts])
        across = framed @ _plane(placed.direction).T
        return np.full(len(middles), math.sqrt(np.prod(np.ptp(across, axis=0))))
    away = middles - placed.position
    if isinstance(light, PointLightConfig):
        return 2 * (1 + light.guard) * np.abs(away).max(axis=1)
    whole = corners.reshape(-1, 3)
    target = (whole.min(axis=0) + whole.max(axis=0)) / 2 if light.target is None else np.asarray(light.target)
    axis = target - placed.position
    axis /= max(np.linalg.norm(axis), np.finfo(float).tiny)
    if light.outer_angle is not None:
        tangent = math.tan(math.radians(light.outer_angle))
    else:
        seen = whole - placed.position
        along = seen @ axis
        tangent = float((np.linalg.norm(seen - np.outer(along, axis), axis=1) / np.maximum(along, _NEAR)).max())
    return 2 * tangent * math.sqrt(getattr(light, "aspect", 1.0)) * np.maximum(away @ axis, 0)


def _corners(boxes: Boxes) -> Float[HostArray, "c 3"]:
    """The eight corners of each box."""
    return np.concatenate([boxes[:, list(which), range(3)] for which in np.ndindex(2, 2, 2)])


def _plane(direction: Float[HostArray, "3"]) -> Float[HostArray, "2 3"]:
    """The axes of a sun's map, for a map with `+y` up."""
    axis = direction / np.linalg.norm(direction)
    side = np.cross(UP, axis)
    side = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(side) < _FLAT else side / np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side)])
