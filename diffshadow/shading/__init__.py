"""Shading: from visibility to the image of a lit scene."""

from ._abstract import AbstractShading as AbstractShading
from ._modulated import ModulatedShadow as ModulatedShadow
from ._phong import Attenuation as Attenuation
from ._phong import Phong as Phong
