"""Shading: from visibility to the image of a lit scene."""

from .._srgb import to_srgb
from ._abstract import AbstractShading
from ._colour import Colour
from ._modulated import ModulatedShadow
from ._phong import Attenuation, Phong

__all__ = [
    "AbstractShading",
    "Attenuation",
    "Colour",
    "ModulatedShadow",
    "Phong",
    "to_srgb",
]


def __dir__() -> list[str]:
    return __all__
