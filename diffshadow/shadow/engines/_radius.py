"""One radius of a filter in the settings of several engines.

The taps of three.js r187 and Babylon.js 9.34 are checked against pictures from these engines. The settings of Godot 4,
Bevy, Filament and Unity come from their sources and documentation. They are not verified against the engines.
"""

from typing import NamedTuple

from ...geometry import AbstractLight, PointLight
from ._axes import engine_light
from ._babylon_taps import POISSON_RADIUS
from ._convert import EngineSetting
from ._light import NO_NUDGE


class GodotQuality(NamedTuple):
    """A quality of Godot's soft shadows: the taps of its disk, and its radius in texels at shadow_blur 1."""

    taps: int
    radius: float


GODOT_QUALITIES = {
    "SOFT_LOW": GodotQuality(4, 2.0),
    "SOFT_MEDIUM": GodotQuality(8, 2.0),
    "SOFT_HIGH": GodotQuality(16, 3.0),
    "SOFT_ULTRA": GodotQuality(32, 4.0),
}
"""`RenderingServer.SHADOW_QUALITY_…`."""
# Texels of a disk per unit of shadow_blur at the default quality, Soft Low.
_SOFT_LOW = GODOT_QUALITIES["SOFT_LOW"].radius
_SIZES = "its kernels have fixed sizes"


def radius_settings(light: AbstractLight, radius: float) -> list[EngineSetting]:
    """The radius of a filter as the settings of engines, for an engine's light with the same map.

    Kernels of different shapes count as equally wide if they have the same standard deviation.

    **Arguments:**

    - `radius`: radius of a disk of taps, in texels.

    **Returns** a setting for each engine. Its value is `None` if the engine has no counterpart.

    **Raises** `ValueError` for a light that no engine has.
    """
    light = engine_light(light, NO_NUDGE)
    is_point = isinstance(light, PointLight)
    # Under a point light, a unit is half a texel at the centre of a face.
    three, poisson = (2 * radius, radius) if is_point else (radius, radius / POISSON_RADIUS)
    godot = "for the filter quality Soft Low, and a light without size"
    if light.is_directional and radius > 0:
        godot += f"; divide shadow_bias by {_SOFT_LOW:g} × shadow_blur"
    units = "half texels at the centre of a face" if is_point else "texels"
    found = [
        EngineSetting("three.js", "light.shadow.radius", three, f"{units}, for PCFShadowMap", True),
        EngineSetting("Babylon.js", "generator.blurScale", poisson, "for POISSON, and PCF under point lights", True),
        EngineSetting("Godot 4", "shadow_blur", radius / _SOFT_LOW, f"roughly; {godot}" if is_point else godot, False),
    ]
    fixed = {
        "Bevy": ("ShadowFilteringMethod", _SIZES),
        "Filament": ("shadowType", "PCF has a fixed size"),
        "Unity URP": ("softShadowQuality", _SIZES),
    }
    if not is_point:
        found.insert(2, EngineSetting("Babylon.js", "generator.filteringQuality (PCF)", None, _none(_SIZES), True))
    return found + [EngineSetting(name, key, None, _none(why), False) for name, (key, why) in fixed.items()]


def _none(why: str) -> str:
    return f"no counterpart: {why}"
