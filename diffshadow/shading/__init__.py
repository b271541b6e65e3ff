"""Shading: from visibility to the image of a lit scene."""

from ._phong import Attenuation as Attenuation
from ._phong import Phong as Phong
