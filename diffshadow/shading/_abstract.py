"""The interface of shading."""

import abc
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import CheckedModule
from .._types import VectorMap, Visibility
from .._words import counted
from ..geometry import AbstractCamera, AbstractLight
from ..raster import AntialiasedSurface, Surface

Lights = AbstractLight | Sequence[AbstractLight]
Visibilities = Float[Array, "*l h w"] | Sequence[Visibility]


class AbstractShading(CheckedModule):
    """Turns visibility into an image."""

    @abc.abstractmethod
    def __call__(self, surface: Surface, visibility: Visibilities, light: Lights, camera: AbstractCamera) -> VectorMap:
        """The image of `surface` lit by `light`, seen by `camera`.

        **Arguments:**

        - `light`: one light, or several in a sequence.
        - `visibility`: (h, w), visibility of the light, in [0, 1]. For several lights, one image for each, as (l, h, w)
          or in a sequence.

        **Returns:** (h, w, 3), linear, 0 or more; it may exceed 1. Differentiable with respect to all arguments,
        without NaN.

        **Raises** `ValueError` unless the numbers of visibilities and lights are equal.
        """

    def of_light(self, index: int) -> "AbstractShading":
        """The shading of the scene with only one of its lights, at `index`."""
        return self

    def antialiased(
        self, seen: AntialiasedSurface, visibility: Visibilities, light: Lights, camera: AbstractCamera
    ) -> Float[Array, "y x 3"]:
        """The image with the mean over each pixel along outlines and creases.

        **Arguments** are as for the image of a surface. `visibility` has a value for each point of `seen.surface`, (h,
        w), or for pixel centres only, (y, x), which `seen.extend` then extends to all points.

        **Returns:** (y, x, 3), linear. It is also differentiable with respect to all numbers that move outlines.

        **Raises** `ValueError` unless the numbers of visibilities and lights are equal.
        """
        height = seen.resolution[0]
        pairs = each_light(visibility, light)
        everywhere = [seen.extend(image) if image.shape[0] == height else image for image, _ in pairs]
        return seen.resolve(self(seen.surface, everywhere, [light for _, light in pairs], camera))


def each_light(visibility: Visibilities, light: Lights) -> list[tuple[Visibility, AbstractLight]]:
    """Each light with its visibility.

    **Raises** `ValueError` unless the numbers of visibilities and lights are equal.
    """
    if isinstance(light, AbstractLight):
        return [(jnp.asarray(visibility), light)]
    if len(visibility) != len(light):
        raise ValueError(
            f"got {counted(len(visibility), 'visibility')} for {counted(len(light), 'light')}; expected one, (h, w), "
            "for each light"
        )
    return list(zip(visibility, light, strict=True))
