"""Figures of a layout."""

from collections.abc import Mapping
from typing import NamedTuple

from jaxtyping import Array, Float, Int

from ..._types import Mask


class MapFigure(NamedTuple):
    """The names of a map's layers in a figure.

    - `title`: title of the figure.
    - `layers`: the content of each layer, for layers that are shown side by side; `None` if the layers are combined
      into one image.
    - `used`: the number of layers that show anything; empty layers come last.
    """

    title: str
    layers: tuple[str, ...] | None
    used: int


class LayerFigure(NamedTuple):
    """The layers that an image is looked up in, as colours over the image.

    - `name`: name of the figure's file, a word.
    - `title`, `subtitle`: the text above the figure.
    - `labels`: the meaning of each colour in the legend, by its number.
    - `colour`: (h, w), the number of the colour at each pixel.
    - `other`, `weight`: (h, w), a second colour, and the weight of the first colour in the mean of both; `None` if
      there is only one colour.
    - `brightness`: (h, w), a factor of the colour; `None` for a factor of 1.
    - `shown`: (h, w), which pixels are coloured.
    """

    name: str
    title: str
    subtitle: str
    labels: Mapping[int, str]
    colour: Int[Array, "h w"]
    other: Int[Array, "h w"] | None
    weight: Float[Array, "h w"] | None
    brightness: Float[Array, "h w"] | None
    shown: Mask
