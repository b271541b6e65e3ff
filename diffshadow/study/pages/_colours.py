"""Colours over images: the layers of a map, differences, and marks for false shadow and false light.

Images are floats in [0, 1] with row 0 at the bottom. Colours are in sRGB.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from ... import shadow
from ..._types import HostArray
from .. import style

Image = Float[HostArray, "h w"]
Colours = Float[HostArray, "h w 3"]
Pixels = Bool[HostArray, "h w"]
# The fraction of the image's brightness that remains under the colours of layers.
_KEPT = 0.35
# The limits of the colour scale, as differences of visibility.
_LIMIT = 0.5
# A reference counts as lit or dark within this tolerance, as in `metrics`.
_NEARLY = 1e-6
# The brightness of an image under marks.
_GREY = 0.75


def colours_of(numbers: Int[HostArray, "*n"]) -> Float[HostArray, "*n 3"]:
    """A colour for each of these numbers."""
    return np.array([to_rgb(colour) for colour in style.CYCLE])[numbers % len(style.CYCLE)]


def tinted(image: Colours, layers: shadow.LayerFigure) -> Colours:
    """`image`, tinted with a colour for each of the `layers`."""
    tint = colours_of(np.asarray(layers.colour))
    if layers.other is not None and layers.weight is not None:
        share = np.asarray(layers.weight)[..., None]
        tint = share * tint + (1 - share) * colours_of(np.asarray(layers.other))
    if layers.brightness is not None:
        tint = tint * np.asarray(layers.brightness)[..., None]
    return np.where(np.asarray(layers.shown)[..., None], image * (_KEPT + (1 - _KEPT) * tint), image)


def on_surface(image: Image | Colours, mask: Pixels) -> Colours:
    """`image` where there is a surface, and a fixed colour elsewhere."""
    image = image if image.ndim > 2 else image[..., None]
    return np.where(mask[..., None], image, to_rgb(style.NO_SURFACE))


def difference_colours(difference: Image, mask: Pixels) -> Colours:
    """Differences from the reference at the pixels that count. Orange is too dark, and purple is too light."""
    return on_surface(colormaps[style.DIFFERENCE]((difference / _LIMIT + 1) / 2)[..., :3], mask)


def marked(image: Colours, difference: Image, truth: Image, mask: Pixels) -> Colours:
    """`image` in grey. False shadow is vermilion and false light is blue; stronger colours mark larger errors."""
    found = np.repeat(_GREY * image.mean(axis=-1, keepdims=True), 3, axis=-1)
    for there, wrong, colour in (
        (truth >= 1 - _NEARLY, -difference, style.VERMILION),
        (truth <= _NEARLY, difference, style.BLUE),
    ):
        share = np.where(mask & there, np.clip(wrong, 0, 1), 0)[..., None]
        found = (1 - share) * found + share * np.array(to_rgb(colour))
    return found
