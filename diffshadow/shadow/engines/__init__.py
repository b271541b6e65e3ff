"""Shadows as in real-time engines, with the engines' own names, units and defaults."""

from ...settings.engines import EngineName
from ._abstract import AbstractEngineShadows as AbstractEngineShadows
from ._babylon import BabylonJs as BabylonJs
from ._bevy import Bevy as Bevy
from ._code import engine_code as engine_code
from ._convert import OFFSET_PROFILES as OFFSET_PROFILES
from ._convert import EngineSetting as EngineSetting
from ._convert import LightFrame as LightFrame
from ._convert import PlainBias as PlainBias
from ._convert import engine_settings as engine_settings
from ._convert import light_frame as light_frame
from ._engine_map import EngineMap as EngineMap
from ._godot import GodotCompatibility as GodotCompatibility
from ._light import EngineLight as EngineLight
from ._playcanvas import PlayCanvas as PlayCanvas
from ._radius import GODOT_QUALITIES as GODOT_QUALITIES
from ._radius import radius_settings as radius_settings
from ._taps import castano_radius as castano_radius
from ._three import ThreeJs as ThreeJs

ENGINE_TECHNIQUES: dict[EngineName, type[AbstractEngineShadows]] = {
    each.settings.type: each for each in (ThreeJs, BabylonJs, PlayCanvas, Bevy, GodotCompatibility)
}
"""The engines whose shadows this package draws, by the types of their sections."""
