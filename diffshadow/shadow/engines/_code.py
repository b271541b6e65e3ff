"""Fitted settings as the code that one pastes into a program that uses the engine."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..._types import Resolution
from ...geometry import AbstractLight, MatrixLight, PointLight
from ._abstract import engine_light
from ._three import ThreeJs

# Where the near plane of a directional light's camera is put: the light itself is far away.
_NEAR = 1.0


class ThreeJsLight(NamedTuple):
    """A light and its shadow camera, as three.js has them.

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
    def of(cls, light: AbstractLight, resolution: Resolution) -> "ThreeJsLight":
        """three.js' settings for `light` with a map of `resolution`.

        **Raises** `ValueError` for a perspective camera that is off its axis, and what `engine_light` raises.
        """
        light = engine_light(light)
        if isinstance(light, PointLight):
            return cls("point", _numbers(light.position), float(light.near), float(light.far))
        assert isinstance(light, MatrixLight)
        view = light.view()
        pose, projection = (np.asarray(matrix, np.float64) for matrix in (view.world_to_eye, view.eye_to_clip))
        eye, forward = -pose[:3, :3].T @ pose[:3, 3], -pose[2, :3]
        near, far = float(view.near), float(view.far)
        if light.is_perspective:
            if projection[:2, 2].any():
                raise ValueError("the light's window is off its axis; expected one in the middle, as of a spot light")
            height, width = resolution
            aspect = projection[1, 1] / projection[0, 0] * height / width
            angle = math.atan(1 / projection[1, 1])
            return cls("spot", _numbers(eye), near, far, _numbers(eye + forward), None, angle, aspect)
        middle, half = -projection[:2, 3] / np.diag(projection)[:2], 1 / np.diag(projection)[:2]
        (left, bottom), (right, top) = middle - half, middle + half
        back = _NEAR - near
        position = eye - back * forward
        window = {"left": left, "right": right, "top": top, "bottom": bottom}
        window = {name: float(value) for name, value in window.items()}
        return cls("directional", _numbers(position), _NEAR, far + back, _numbers(eye), window)


def three_js_code(settings: ThreeJs, light: AbstractLight, distances: tuple[float, float]) -> str:
    """JavaScript that sets `settings` for `light`, with comments on where they hold.

    **Arguments:**

    - `distances`: of the nearest and the farthest receiver along the light's axis, world units.
    """
    given = ThreeJsLight.of(light, settings.resolution)
    height, width = settings.resolution
    bias, normal_bias = float(settings.bias), float(settings.normal_bias)
    lines = [
        "renderer.shadowMap.enabled = true;",
        f"renderer.shadowMap.type = THREE.{settings.shadow_type};",
        f"light.position.set({', '.join(map(_text, given.position))});",
    ]
    if given.target is not None:
        lines += [f"light.target.position.set({', '.join(map(_text, given.target))});"]
        lines += ["light.target.updateMatrixWorld();"]
    if given.angle is not None and given.aspect is not None:
        lines += [f"light.angle = {_text(given.angle)};  // radians"]
        lines += [] if abs(given.aspect - 1) < 1e-6 else [f"light.shadow.aspect = {_text(given.aspect)};"]
    camera: Mapping[str, float] = {**(given.window or {}), "near": given.near, "far": given.far}
    pairs = ", ".join(f"{name}: {_text(value)}" for name, value in camera.items())
    lines += [
        "light.castShadow = true;",
        f"light.shadow.mapSize.set({width}, {height});",
        f"Object.assign(light.shadow.camera, {{ {pairs} }});",
        "light.shadow.camera.updateProjectionMatrix();",
        f"light.shadow.bias = {_text(bias)};  // {_in_world(given, bias, distances)}",
        f"light.shadow.normalBias = {_text(normal_bias)};  // world units{_in_texels(given, normal_bias, width)}",
    ]
    if settings.shadow_type != "BasicShadowMap":
        lines += [f"light.shadow.radius = {_text(float(settings.radius))};  // texels of this map size"]
    if settings.shadow_type == "VSMShadowMap":
        lines += [f"light.shadow.blurSamples = {settings.blur_samples};"]
    if float(settings.intensity) != 1:
        lines += [f"light.shadow.intensity = {_text(float(settings.intensity))};"]
    sides = {"front": "FrontSide", "back": "BackSide", "double": "DoubleSide"}
    for name, side in (("side", settings.side), ("shadowSide", settings.shadow_side)):
        if isinstance(side, str):
            lines += [f"material.{name} = THREE.{sides[side]};"]
    return "\n".join([*_where_it_holds(given), *lines, ""])


def _where_it_holds(light: ThreeJsLight) -> list[str]:
    if light.type == "directional":
        scale = "bias is a part of far - near: with another range, multiply it by the old range over the new one"
    else:
        scale = "bias is window depth, which depends on near and far: with others, fit it again"
    return [
        "// three.js r187, WebGLRenderer.",
        f"// Holds for this map size, near and far. {scale[0].upper()}{scale[1:]}.",
        "// With another map size, normalBias goes with the size of a texel.",
    ]


def _in_world(light: ThreeJsLight, bias: float, distances: tuple[float, float]) -> str:
    """The shift towards the light that a bias amounts to."""
    depth = light.far - light.near
    if light.type == "directional":
        return f"{_text(-bias * depth)} world units towards the light"
    # z' = f n / ((f - n) d²)
    shifts = [-bias * depth * d * d / (light.far * light.near) for d in distances]
    near, far = (_text(distance) for distance in distances)
    return f"{_text(shifts[0])} world units at the distance {near}, {_text(shifts[1])} at {far}"


def _in_texels(light: ThreeJsLight, length: float, width: int) -> str:
    if light.window is None or length == 0:
        return ""
    return f", {_text(length / (light.window['right'] - light.window['left']) * width)} texels"


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in values]


def _text(value: float) -> str:
    """Seven significant digits, and never -0."""
    return f"{value + 0.0:.7g}" if value else "0"
