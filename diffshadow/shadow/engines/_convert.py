"""One bias in the units of several engines.

The formulas of three.js r187, Babylon.js 9.34, and Bevy 0.19 under directional and spot lights are checked against
pictures from these engines. The formulas of Godot 4, Filament and Unity, and of Bevy's point light, come from their
sources and documentation. They are not verified against the engines.
"""

import math
from typing import NamedTuple

from ..._types import Resolution
from ...geometry import AbstractLight, PointLight
from ...settings.scene import LightKind
from ..biases import OffsetProfile
from ._axes import engine_light
from ._cameras import EngineCameras
from ._light import NO_NUDGE


class EngineSetting(NamedTuple):
    """A setting of an engine.

    - `engine`, `setting`: their names, such as `"three.js"` and `"light.shadow.bias"`.
    - `value`: the value in the engine's unit, or `None` if the engine has no counterpart; `note`: further conditions of
      the value.
    - `is_verified`: whether the formula is checked against the engine's own pictures.
    """

    engine: str
    setting: str
    value: float | None
    note: str
    is_verified: bool


class _Common(NamedTuple):
    """The common inputs of the formulas: the shift b and a texel's width t in world units, the normal offset m in
    texels, near n, far f, the range D = f - n, and the distance d along the light's axis.

    - `power`, `offset_power`: powers of the distance with which b and m t grow; `None` under a directional light, where
      nothing varies with distance.
    - `softness`: Godot's and Unity's factor on the set value.
    """

    b: float
    t: float
    m: float
    n: float
    f: float
    d: float
    power: int | None
    offset_power: int | None
    softness: float

    @property
    def depth(self) -> float:
        return self.f - self.n

    @property
    def slope(self) -> float:
        """Window depth per world unit at the distance d of a perspective: f n / (D d²)."""
        return self.f * self.n / (self.depth * self.d**2)

    def shift(self, note: str, power: int) -> str:
        """`note` for a setting whose shift grows with `power` of the distance."""
        return note if self.power in (None, power) or self.b == 0 else f"{note}; {_AT}"

    def offset(self, note: str, power: int) -> str:
        """`note` for a setting whose normal offset grows with `power` of the distance."""
        return note if self.offset_power in (None, power) or self.m == 0 else f"{note}; {_AT}"


class PlainBias(NamedTuple):
    """A bias without an engine's unit.

    - `shift`: shift towards the light, in world units; `power`: the power of the distance with which it grows.
    - `offset`: shift along normals, in texels; `offset_power`: the power of the distance with which its length grows;
      `profile`: its growth with the angle to the light.
    - `radius`: radius of a disk of taps that is as wide as the filter, in texels; `None` for a filter without a width.
    """

    shift: float
    power: int
    offset: float
    offset_power: int
    profile: OffsetProfile
    radius: float | None


class LightFrame(NamedTuple):
    """A light's camera, at the distance d along its axis.

    - `kind`: `"directional"`, `"spot"` or `"point"`.
    - `texel`: the width of a texel there; `near`, `far`: distances of the camera's planes. World units.
    """

    kind: LightKind
    texel: float
    near: float
    far: float

    def slope(self, distance: float) -> float:
        """Window depth per world unit at the `distance` along the axis."""
        depth = self.far - self.near
        return 1 / depth if self.kind == "directional" else self.far * self.near / (depth * distance**2)


def light_frame(light: AbstractLight, resolution: Resolution, distance: float) -> LightFrame:
    """The camera of an engine's light with a map of `resolution`. `distance` is as for `engine_settings`.

    **Raises** the errors of `engine_settings`.
    """
    light = engine_light(light, NO_NUDGE)
    if not light.is_directional and not distance > 0:
        raise ValueError(f"the distance is {distance}; expected world units in front of the light")
    if isinstance(light, PointLight):
        return LightFrame("point", 2 * distance / min(resolution), float(light.near), float(light.far))
    view = light.first if isinstance(light, EngineCameras) else light.view()
    at_unit = math.sqrt(4 / float(view.eye_to_clip[0, 0] * view.eye_to_clip[1, 1]) / math.prod(resolution))
    texel = at_unit * (distance if view.is_perspective else 1)
    kind = "spot" if view.is_perspective else "directional"
    return LightFrame(kind, texel, float(view.near), float(view.far))


def engine_settings(
    light: AbstractLight,
    resolution: Resolution,
    bias: float,
    normal_offset: float,
    distance: float,
    *,
    profile: OffsetProfile | None = None,
    power: int = 0,
    offset_power: int = 1,
    softness: float = 1.0,
) -> list[EngineSetting]:
    """A constant bias and a normal offset as the settings of engines, for an engine's light with the same map.

    **Arguments:**

    - `resolution`: (height, width) of the map, in texels.
    - `bias`: the bias towards the light, in world units.
    - `normal_offset`: in texels.
    - `distance`: a distance along the light's axis, in world units. Settings that vary with the distance are given for
        this distance. Ignored for a directional light.
    - `profile`: profile of the normal offset. Engines with another profile are left out, unless the offset is 0. `None`
        ignores the difference between profiles.
    - `power`: the power of the distance with which the bias grows: 0 for world units, 1 for texels, 2 for window depth.
        Notes say which settings grow in another way. `offset_power`: the same for the normal offset.
    - `softness`: the engine's factor on the set value. For Godot's directional lights it is `shadow_blur` times the
        quality's radius (1 for hard shadows). For Unity it is 1 for hard shadows, and 1.5, 2.5 or 3.5 for soft shadows
        of low, medium or high quality.

    **Raises** `ValueError` for a distance that is not positive, and the errors of `engine_light`.
    """
    kind, texel, near, far = light_frame(light, resolution, distance)
    powers = (None, None) if kind == "directional" else (power, offset_power)
    common = _Common(bias, texel, normal_offset, near, far, distance, *powers, softness)
    of = {"directional": _directional, "spot": _spot, "point": _point}[kind]
    found = [*_three(common, kind), *_babylon(common, kind), *of(common)]
    if profile is None or normal_offset == 0:
        return found
    # Unity does not move receivers along normals under point lights. Godot's offset is known only for the sun.
    lacking = {"directional": set(), "spot": {"Godot 4"}, "point": {"Godot 4", "Unity URP"}}[kind]
    return [each for each in found if OFFSET_PROFILES[each.engine] == profile and each.engine not in lacking]


_AT = "holds at this distance only"
_DEPTH = "window depth"
# Depth from -1 to 1, in which Babylon.js moves the casters of PCF.
_TWICE = "twice window depth"
_WORLD = "world units"
OFFSET_PROFILES: dict[str, OffsetProfile] = {
    "three.js": "constant",
    "Babylon.js": "sine",
    "Godot 4": "across",
    "Bevy": "constant",
    "Filament": "sine",
    "Unity URP": "one_minus_cosine",
}
"""The growth of each engine's normal offset with the angle to the light."""


def _three(c: _Common, kind: str) -> list[EngineSetting]:
    value = 0.0 - c.b / c.depth if kind == "directional" else -c.b * c.slope
    return [
        EngineSetting("three.js", "light.shadow.bias", value, c.shift(_DEPTH, 2), True),
        EngineSetting("three.js", "light.shadow.normalBias", c.m * c.t, c.offset(_WORLD, 0), True),
    ]


def _babylon(c: _Common, kind: str) -> list[EngineSetting]:
    linear = c.b / (c.n + c.f) if kind == "point" else c.b / c.depth
    # In a parallel view, window depth is a fraction of the depth range.
    unit = _DEPTH if kind == "directional" else "parts of the depth range"
    pcf = {"directional": 2 * c.b / c.depth, "spot": 2 * c.b * c.slope, "point": linear}[kind]
    note = c.shift("PCF becomes POISSON", 0) if kind == "point" else c.shift(_TWICE, 2)
    of = lambda setting, value, note: EngineSetting("Babylon.js", f"generator.{setting}", value, note, True)
    return [
        of("bias (NONE, POISSON, ESM)", linear, c.shift(unit, 0)),
        of("bias (PCF)", pcf, note),
        of("normalBias", c.m * c.t, c.offset("world units, of casters, times sin θ", 0)),
    ]


def _directional(c: _Common) -> list[EngineSetting]:
    godot = f"for shadow_blur × quality radius {c.softness:.4g}" if c.softness != 1 else "for hard shadows and blur 1"
    return [
        _read("Godot 4", "shadow_bias", 100 * c.b / c.depth / c.softness, godot),
        _read("Godot 4", "shadow_normal_bias", c.m, "times 1 - cos θ, across the light only"),
        *_bevy(c),
        _read("Filament", "constantBias", c.b, _WORLD),
        _read("Filament", "normalBias", 2 * c.m, "times sin θ"),
        *_unity(c, c.m),
    ]


def _spot(c: _Common) -> list[EngineSetting]:
    return [
        _read("Godot 4", "shadow_bias", 2.5 * c.b / c.d, c.shift("roughly", 1)),
        *_bevy(c),
        _read("Filament", "constantBias", c.b, c.shift(_WORLD, 0)),
        _read("Filament", "normalBias", c.m, c.offset("grows with distance", 1)),
        *_unity(c, c.m),
    ]


def _point(c: _Common) -> list[EngineSetting]:
    return [_read("Godot 4", "shadow_bias", c.b, c.shift(_WORLD, 0)), *_bevy(c, is_verified=False), *_unity(c, 0.0)]


def _bevy(c: _Common, is_verified: bool = True) -> list[EngineSetting]:
    of = lambda setting, value, note: EngineSetting("Bevy", setting, value, note, is_verified)
    return [
        of("shadow_depth_bias", c.b, c.shift(_WORLD, 0)),
        of("shadow_normal_bias", c.m / math.sqrt(2), c.offset("texels of the diagonal", 1)),
    ]


def _unity(c: _Common, normal: float) -> list[EngineSetting]:
    soft = "; for hard shadows, larger for soft shadows" if c.softness == 1 else ""
    bias, normal = c.b / c.t / c.softness, normal / c.softness
    return [
        _read("Unity URP", "shadowBias (depth)", bias, c.shift(f"texels{soft}", 0)),
        _read("Unity URP", "shadowNormalBias", normal, c.offset(f"texels, times 1 - cos θ{soft}", 0)),
    ]


def _read(engine: str, setting: str, value: float, note: str) -> EngineSetting:
    return EngineSetting(engine, setting, value, note, False)
