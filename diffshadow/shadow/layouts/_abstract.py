"""The interface of layouts."""

import abc
from typing import NamedTuple

from jaxtyping import Array, Float, Int

from ..._checks import CheckedModule
from ..._types import Resolution
from ...geometry import AbstractCamera, AbstractLight
from ...raster import Surface
from .._shader import ShaderPart
from ._figures import LayerFigure, MapFigure


class Choice(NamedTuple):
    """The layers of a map that each point is looked up in.

    - `layer`: (h, w); `None` for a map without layers.
    - `other`, `weight`: (h, w), a second layer, and the weight of the first layer in the mean of both; `None` if there
      is only one layer.
    - `strength`: (h, w), the strength of shadows, from 1 to 0 at the end of the map; `None` if it is 1 everywhere.
    """

    layer: Int[Array, "h w"] | None
    other: Int[Array, "h w"] | None = None
    weight: Float[Array, "h w"] | None = None
    strength: Float[Array, "h w"] | None = None


class AbstractLayout(CheckedModule):
    """A layout decides which parts of the scene the layers of a shadow map show, and in which layers each receiver is
    looked up."""

    @abc.abstractmethod
    def light(
        self,
        light: AbstractLight,
        camera: AbstractCamera,
        resolution: Resolution,
        surface: Surface | None = None,
    ) -> AbstractLight:
        """`light` with the views of this layout: the light that the map is drawn from.

        **Arguments:**

        - `camera`: the camera of the image.
        - `resolution`: (height, width) of each layer, in texels, as `layer_resolution` returns it.
        - `surface`: the surface that the camera sees; required if `needs_surface`, and otherwise ignored.

        **Raises** `ValueError` if the layout does not suit the light or the camera.
        """

    @property
    def needs_surface(self) -> bool:
        """Whether `light` needs `surface`."""
        return False

    @property
    def differentiable(self) -> tuple[str, ...]:
        """Names of the numbers with respect to which visibility has a derivative.

        The other numbers lay out the map. The map's texels jump when these numbers change, so visibility has no useful
        derivative with respect to them.
        """
        return ()

    def check_reach(self, reach: float) -> None:
        """**Raises** `ValueError` if a technique that reads the map up to `reach` texels from a receiver would read
        beyond its layers."""

    def layer_resolution(self, resolution: Resolution) -> Resolution:
        """(height, width) of a layer in texels, for a map of `resolution`."""
        return resolution

    @abc.abstractmethod
    def choose(self, light: AbstractLight, points: Float[Array, "h w 3"]) -> Choice:
        """The layers in which `points` (h, w, 3), in world units, are looked up. `light` is the result of the method
        `light`."""

    def shader(self, light: AbstractLight) -> ShaderPart:
        """The function `shadow` of a shader, for maps of `light`, a result of the method `light`.

        **Raises** `ValueError` if it has no shader.
        """
        raise ValueError(
            f"the layout is {type(self).__name__}, whose pages have no shader; expected SingleMap, Cascades or "
            "PerspectiveWarp: the most similar is cascades selected by map"
        )

    def map_figure(self, light: AbstractLight) -> MapFigure | None:
        """The names of the layers of the map of `light` in figures; `None` if they need no names."""
        return None

    def layer_figure(self, light: AbstractLight, surface: Surface) -> LayerFigure | None:
        """A figure of the layers in which `surface` is looked up; `None` if there is nothing to show."""
        return None

    def remarks(self, light: AbstractLight) -> tuple[str, ...]:
        """Remarks on faults of the map of `light` that other settings would remove. They are sentences without their
        subject, the light."""
        return ()
