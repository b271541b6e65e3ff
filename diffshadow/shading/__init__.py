"""Shading: from visibility to the image of a lit scene."""

from ._abstract import AbstractShading
from ._modulated import ModulatedShadow
from ._phong import Attenuation, Phong

__all__ = [
    "AbstractShading",
    "Attenuation",
    "ModulatedShadow",
    "Phong",
]


def __dir__() -> list[str]:
    return __all__
