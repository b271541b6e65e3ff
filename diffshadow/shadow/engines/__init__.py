"""Shadows as real-time engines draw them, in the engines' own names, units and defaults."""

from ._engine_map import EngineMap as EngineMap
from ._three import ThreeJs as ThreeJs
