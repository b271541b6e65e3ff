"""Lights and their shadow cameras as engines have them."""

import math
from typing import Any, NamedTuple

import numpy as np

from ..._types import Resolution
from ...geometry import AbstractLight, MatrixLight, PointLight
from ._abstract import engine_light

# Where the near plane of a directional light's camera is put if it would begin behind the light.
_NEAR = 1.0
NO_NUDGE = 1e-13
"""Too little to move a light's target: the engine adds its own."""


class EngineLight(NamedTuple):
    """A light and its shadow camera, as three.js has them. Other engines' settings follow from these.

    - `type`: `"directional"`, `"spot"` or `"point"`.
    - `position`, `target`: world coordinates; a point light has no target.
    - `near`, `far`: of the shadow camera, world units.
    - `window`: left, right, top and bottom of a directional light's camera, world units.
    - `angle`, `aspect`: of a spot light's cone, in radians from its axis, and of `light.shadow`.
    """

    type: str
    position: list[float]
    near: float
    far: float
    target: list[float] | None = None
    window: dict[str, float] | None = None
    angle: float | None = None
    aspect: float | None = None

    @classmethod
    def of(cls, light: AbstractLight, resolution: Resolution) -> "EngineLight":
        """The settings for `light` with a map of `resolution`, in the coordinates of `light`.

        **Raises** `ValueError` for a perspective camera that is off its axis, and what `engine_light` raises.
        """
        # Before matrices, which round them.
        own, light = light.view(), engine_light(light, NO_NUDGE)
        if isinstance(light, PointLight):
            return cls("point", _numbers(light.position), float(light.near), float(light.far))
        assert isinstance(light, MatrixLight)
        view = light.view()
        pose, projection = (np.asarray(matrix, np.float64) for matrix in (view.world_to_eye, view.eye_to_clip))
        eye, forward = -pose[:3, :3].T @ pose[:3, 3], -pose[2, :3]
        near, far = float(own.near), float(own.far)
        if light.is_perspective:
            if projection[:2, 2].any():
                raise ValueError("the light's window is off its axis; expected one in the middle, as of a spot light")
            height, width = resolution
            aspect = projection[1, 1] / projection[0, 0] * height / width
            angle = math.atan(1 / projection[1, 1])
            return cls("spot", _numbers(eye), near, far, _numbers(eye + forward), None, angle, aspect)
        middle, half = -projection[:2, 3] / np.diag(projection)[:2], 1 / np.diag(projection)[:2]
        (left, bottom), (right, top) = middle - half, middle + half
        # Engines place a directional light, too: in front of what its camera sees.
        back = _NEAR - near if near <= 0 else 0.0
        position = eye - back * forward
        # On the axis, closest to the origin if that is ahead.
        target = position + max(1.0, float(-position @ forward)) * forward
        window = {"left": left, "right": right, "top": top, "bottom": bottom}
        window = {name: float(value) for name, value in window.items()}
        return cls("directional", _numbers(position), near + back, far + back, _numbers(target), window)


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in values]
