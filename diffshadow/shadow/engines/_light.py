"""Lights and their shadow cameras in engines."""

import math
from typing import Any, NamedTuple

import numpy as np

from ..._types import HostArray, Resolution
from ...geometry import AbstractLight, DirectionalLight, MatrixLight, PointLight, SpotLight
from ._axes import engine_light

# The near plane of a directional light's camera, if it would otherwise be behind the light.
_NEAR = 1.0
NO_NUDGE = 1e-13
"""An offset too small to move a light's target, to which the engine adds its own."""
_EPSILON = float(np.finfo(np.float32).eps)
# Within these lengths, the vector from a light to its target is the unchanged direction.
_SHORTEST, _LONGEST = 0.01, 1e4
_MAX_DIGITS = 9


class EngineLight(NamedTuple):
    """A light and its shadow camera in three.js' form. Other engines' settings follow from these.

    - `type`: `"directional"`, `"spot"` or `"point"`.
    - `position`, `target`: world coordinates; a point light has no target.
    - `near`, `far`: distances of the shadow camera's planes, in world units.
    - `window`: left, right, top and bottom of a directional light's camera, in world units.
    - `angle`: half angle of a spot light's cone, in radians from its axis; `aspect`: the aspect of `light.shadow`.
    """

    type: str
    position: list[float]
    near: float
    far: float
    target: list[float] | None = None
    window: dict[str, float] | None = None
    angle: float | None = None
    aspect: float | None = None

    @property
    def direction(self) -> list[float] | None:
        """From the position to the target; `None` for a point light."""
        if self.target is None:
            return None
        reach = float(np.abs([self.position, self.target]).max())
        return plain(np.subtract(self.target, self.position), _EPSILON / 2 * reach)

    @classmethod
    def of(cls, light: AbstractLight, resolution: Resolution) -> "EngineLight":
        """The settings for `light` with a map of `resolution`, in the coordinates of `light`.

        Numbers from the user are not changed. Other numbers have the precision of float32. **Raises** `ValueError` for
        an off-centre perspective camera, and the errors of `engine_light`.
        """
        if isinstance(light, DirectionalLight):
            return _directional(light)
        if isinstance(light, SpotLight):
            return _spot(light, resolution)
        light = engine_light(light, NO_NUDGE)
        if isinstance(light, PointLight):
            near, far = plain([light.near, light.far])
            return cls("point", plain(light.position), near, far)
        assert isinstance(light, MatrixLight)
        return _of_matrices(light, resolution)


def _directional(light: DirectionalLight) -> EngineLight:
    direction = np.asarray(light.direction, np.float64)
    near, far = float(light.near), float(light.far)
    back = _back(near)
    position = np.asarray(light.center, np.float64) - back * direction / np.linalg.norm(direction)
    error = _EPSILON * float(np.abs([*position, back]).max()) if back else 0.0
    width, height = np.asarray(light.extent, np.float64) / 2
    window = _window(plain([-width, width, height, -height]))
    near, far = plain([near + back, far + back])
    return EngineLight("directional", plain(position, error), near, far, _target(position, direction), window)


def _spot(light: SpotLight, resolution: Resolution) -> EngineLight:
    height, width = resolution
    position, direction = (np.asarray(vector, np.float64) for vector in (light.position, light.direction))
    aspect, near, far = plain([float(light.aspect) * height / width, light.near, light.far])
    angle = math.radians(float(light.outer_angle))
    return EngineLight("spot", plain(position), near, far, _target(position, direction), None, angle, aspect)


def _of_matrices(light: MatrixLight, resolution: Resolution) -> EngineLight:
    """The settings that remain in the rounded matrices of a light."""
    view = light.view()
    pose, projection = (np.asarray(matrix, np.float64) for matrix in (light.world_to_eye, light.eye_to_clip))
    eye, forward = -pose[:3, :3].T @ pose[:3, 3], -pose[2, :3]
    near, far = float(view.near), float(view.far)
    at = plain(eye, 2 * _EPSILON * float(np.linalg.norm(eye)))
    if light.is_perspective:
        if projection[:2, 2].any():
            raise ValueError("the light's window is off its axis; expected a centred window, as a spot light has")
        height, width = resolution
        (aspect,) = plain([projection[1, 1] / projection[0, 0] * height / width], 4 * _EPSILON)
        # At the far plane, depth is nearly 1, so few of its digits remain.
        (near,), (far,) = plain([near], 4 * _EPSILON * near), plain([far], 4 * _EPSILON * far * far / near)
        angle = math.atan(1 / projection[1, 1])
        return EngineLight("spot", at, near, far, _target(eye, forward), None, angle, aspect)
    middle, half = -projection[:2, 3] / np.diag(projection)[:2], 1 / np.diag(projection)[:2]
    (left, bottom), (right, top) = middle - half, middle + half
    back = _back(near)
    sides = plain([left, right, top, bottom], 4 * _EPSILON * float(np.abs([middle, half]).max()))
    near, far = plain([near + back, far + back], 4 * _EPSILON * max(abs(near), abs(far)))
    eye = eye - back * forward
    at = plain(eye, 2 * _EPSILON * float(np.linalg.norm([*eye, back])))
    return EngineLight("directional", at, near, far, _target(eye, forward), _window(sides))


def _back(near: float) -> float:
    """The distance by which a directional light moves back. Engines place it in front of its camera's view."""
    return _NEAR - near if near <= 0 else 0.0


def _window(sides: list[float]) -> dict[str, float]:
    return dict(zip(("left", "right", "top", "bottom"), sides, strict=True))


def _target(position: HostArray, direction: HostArray) -> list[float]:
    """The target of a light at `position`."""
    length = float(np.linalg.norm(direction))
    towards = direction if _SHORTEST <= length <= _LONGEST else direction / length
    return plain(position + towards, _EPSILON * float(np.abs([position, towards]).max()))


def plain(values: Any, error: float = 0.0) -> list[float]:
    """Each of `values` with the fewest digits that read back as the same number in single precision, or as a number
    within `error`."""
    return [_shortest(float(value), error) for value in values]


def _shortest(value: float, error: float) -> float:
    within = max(error, float(np.spacing(np.float32(abs(value)))) / 2)
    if abs(value) <= error or not math.isfinite(within):
        return 0.0 if abs(value) <= error else value
    written = (float(f"{value:.{digits}g}") for digits in range(1, _MAX_DIGITS))
    return next((number for number in written if abs(number - value) <= within), value)
