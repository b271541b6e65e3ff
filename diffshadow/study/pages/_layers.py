"""Colours over an image, for the layers of a map that its pixels are looked up in."""

import numpy as np
from jaxtyping import Float, Int
from matplotlib.colors import to_rgb

from ... import shadow
from ..._types import HostArray
from .. import style

# The part of the image's own brightness that stays.
_KEPT = 0.35


def colours_of(numbers: Int[HostArray, "*n"]) -> Float[HostArray, "*n 3"]:
    """The colour of each of these numbers, in sRGB from 0 to 1."""
    return np.array([to_rgb(colour) for colour in style.CYCLE])[numbers % len(style.CYCLE)]


def tinted(image: Float[HostArray, "h w 3"], layers: shadow.LayerFigure) -> Float[HostArray, "h w 3"]:
    """`image` in the colours of `layers`."""
    tint = colours_of(np.asarray(layers.colour))
    if layers.other is not None and layers.weight is not None:
        share = np.asarray(layers.weight)[..., None]
        tint = share * tint + (1 - share) * colours_of(np.asarray(layers.other))
    if layers.brightness is not None:
        tint = tint * np.asarray(layers.brightness)[..., None]
    return np.where(np.asarray(layers.shown)[..., None], image * (_KEPT + (1 - _KEPT) * tint), image)
