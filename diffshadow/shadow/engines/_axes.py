"""The axes of engines' cameras, whose up direction is +y."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._types import HostArray
from ...geometry import AbstractLight, DirectionalLight, MatrixLight, PointLight, SpotLight
from ...settings.scene import LightKind
from ._cameras import EngineCameras

# The sine of the angle to the y axis below which a direction counts as vertical.
_VERTICAL = 1e-9


def engine_light(light: AbstractLight, nudge: float) -> AbstractLight:
    """`light` with the axes of an engine's camera at the light's position. The camera's up direction is +y.

    **Arguments:**

    - `nudge`: the number that the engine adds to the z of the axis towards the light if the light is vertical.

    **Raises** `ValueError` for an area light.
    """
    if isinstance(light, PointLight | MatrixLight | EngineCameras):
        return light
    if not isinstance(light, DirectionalLight | SpotLight):
        raise refused_light(light)
    view, given = light.view(), light.center if isinstance(light, DirectionalLight) else light.position
    rows, upright = upright_axes(light.direction, nudge), np.eye(4)
    upright[:3, :3], upright[:3, 3] = rows, -rows @ np.asarray(given, np.float64)
    return MatrixLight(upright, view.eye_to_clip, view.is_perspective)


def refused_light(light: AbstractLight, kinds: Sequence[LightKind] = ("directional", "spot", "point")) -> ValueError:
    """The error message for a light that no engine has, or whose kind is not among an engine's `kinds`."""
    expected = f"{', '.join(kinds)} or matrix light"
    return ValueError(f"the light is a {type(light).__name__}; expected a {expected}, as in engines")


def upright_axes(direction: Any, nudge: float) -> Float[HostArray, "3 3"]:
    """The right, up and back directions of an engine's camera that looks along `direction` (3,), with +y as its up
    direction.

    `nudge` is as for `engine_light`.
    """
    backward = -np.asarray(direction, np.float64)
    backward /= np.linalg.norm(backward)
    if is_vertical(backward):
        backward[2] += nudge
    backward /= np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward])


def is_vertical(direction: Any) -> bool:
    """Whether `direction` (3,) is straight up or down, so that +y cannot be the camera's up direction."""
    x, y, z = np.asarray(direction, np.float64)
    return bool(np.hypot(x, z) < _VERTICAL * abs(y))
