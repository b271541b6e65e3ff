"""One bias in the units of several engines.

The formulas of three.js r187 and Babylon.js 9.34 are checked against pictures that these engines drew. Those of Godot
4, Bevy, Filament and Unity are read from their sources and documentation, and not verified against the engines.
"""

import math
from typing import NamedTuple

from ..._types import Resolution
from ...geometry import AbstractLight, PointLight
from ._abstract import engine_light
from ._light import NO_NUDGE


class EngineSetting(NamedTuple):
    """A setting of an engine.

    - `engine`, `setting`: their names, such as `"three.js"` and `"light.shadow.bias"`.
    - `value`: in the engine's unit; `note`: what else it depends on.
    - `is_verified`: whether the formula is checked against the engine's own pictures.
    """

    engine: str
    setting: str
    value: float
    note: str
    is_verified: bool


class _Common(NamedTuple):
    """What the formulas share: the shift b and a texel's width t in world units, the normal offset m in texels, near n,
    far f, the range D = f - n, and the distance d along the light's axis."""

    b: float
    t: float
    m: float
    n: float
    f: float
    d: float

    @property
    def depth(self) -> float:
        return self.f - self.n

    @property
    def slope(self) -> float:
        """Window depth per world unit at the distance d of a perspective: f n / (D d²)."""
        return self.f * self.n / (self.depth * self.d**2)


def engine_settings(
    light: AbstractLight, resolution: Resolution, bias: float, normal_offset: float, distance: float
) -> list[EngineSetting]:
    """A constant bias and a normal offset as the settings of engines, for a light of theirs with the same map.

    **Arguments:**

    - `resolution`: (height, width) of the map, in texels.
    - `bias`: towards the light, in world units.
    - `normal_offset`: in texels.
    - `distance`: along the light's axis, in world units, at which settings hold that vary with it; ignored for a
        directional light.

    **Raises** `ValueError` for a distance that is not positive, and what `engine_light` raises.
    """
    light = engine_light(light, NO_NUDGE)
    if not light.is_directional and not distance > 0:
        raise ValueError(f"the distance is {distance}; expected world units in front of the light")
    if isinstance(light, PointLight):
        kind, texel = "point", 2 * distance / min(resolution)
        near, far = float(light.near), float(light.far)
    else:
        view = light.view()
        kind = "spot" if view.is_perspective else "directional"
        at_unit = math.sqrt(4 / float(view.eye_to_clip[0, 0] * view.eye_to_clip[1, 1]) / math.prod(resolution))
        texel = at_unit * (distance if view.is_perspective else 1)
        near, far = float(view.near), float(view.far)
    common = _Common(bias, texel, normal_offset, near, far, distance)
    of = {"directional": _directional, "spot": _spot, "point": _point}[kind]
    return [*_three(common, kind), *_babylon(common, kind), *of(common)]


_AT = "holds at this distance only"
_RANGE = "a part of far - near"


def _three(c: _Common, kind: str) -> list[EngineSetting]:
    bias, note = (0.0 - c.b / c.depth, _RANGE) if kind == "directional" else (-c.b * c.slope, _AT)
    return [
        EngineSetting("three.js", "light.shadow.bias", bias, note, True),
        EngineSetting("three.js", "light.shadow.normalBias", c.m * c.t, "world units", True),
    ]


def _babylon(c: _Common, kind: str) -> list[EngineSetting]:
    linear = c.b / (c.n + c.f) if kind == "point" else c.b / c.depth
    pcf = {"directional": 2 * c.b / c.depth, "spot": 2 * c.b * c.slope, "point": linear}[kind]
    note = {"directional": _RANGE, "spot": _AT, "point": "PCF becomes POISSON"}[kind]
    return [
        EngineSetting("Babylon.js", "generator.bias (NONE, POISSON, ESM)", linear, "a part of the range", True),
        EngineSetting("Babylon.js", "generator.bias (PCF)", pcf, note, True),
        EngineSetting("Babylon.js", "generator.normalBias", c.m * c.t, "world units, of casters, times sin θ", True),
    ]


def _directional(c: _Common) -> list[EngineSetting]:
    return [
        _read("Godot 4", "shadow_bias", 100 * c.b / c.depth, "for blur 1 and soft filter quality factor 1"),
        _read("Godot 4", "shadow_normal_bias", c.m, "shifts across the light only"),
        *_bevy(c),
        _read("Filament", "constantBias", c.b, "world units"),
        _read("Filament", "normalBias", 2 * c.m, "times sin θ"),
        *_unity(c, c.m),
    ]


def _spot(c: _Common) -> list[EngineSetting]:
    return [
        _read("Godot 4", "shadow_bias", 2.5 * c.b / c.d, f"roughly; {_AT}"),
        *_bevy(c),
        _read("Filament", "constantBias", c.b, "world units"),
        _read("Filament", "normalBias", c.m, "grows with distance"),
        *_unity(c, c.m),
    ]


def _point(c: _Common) -> list[EngineSetting]:
    return [_read("Godot 4", "shadow_bias", c.b, "world units"), *_bevy(c), *_unity(c, 0.0)]


def _bevy(c: _Common) -> list[EngineSetting]:
    return [
        _read("Bevy", "shadow_depth_bias", c.b, "world units"),
        _read("Bevy", "shadow_normal_bias", c.m / math.sqrt(2), "texels of the diagonal"),
    ]


def _unity(c: _Common, normal: float) -> list[EngineSetting]:
    note = "hard shadows; more for soft ones"
    return [
        _read("Unity URP", "shadowBias (depth)", c.b / c.t, f"texels; {note}"),
        _read("Unity URP", "shadowNormalBias", normal, f"texels, times 1 - cos θ; {note}"),
    ]


def _read(engine: str, setting: str, value: float, note: str) -> EngineSetting:
    return EngineSetting(engine, setting, value, note, False)
