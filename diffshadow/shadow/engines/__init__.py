"""Shadows as real-time engines draw them, in the engines' own names, units and defaults."""

from ._babylon import BabylonFilter as BabylonFilter
from ._babylon import BabylonJs as BabylonJs
from ._babylon import BabylonQuality as BabylonQuality
from ._engine_map import EngineMap as EngineMap
from ._three import ThreeJs as ThreeJs
