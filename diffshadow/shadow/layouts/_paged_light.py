"""A directional light whose shadow map is virtual."""

import dataclasses

from jax import lax
from jaxtyping import Array, Float, Int

from ..._types import Scalar
from ...geometry import AbstractLight, Pages, View, cell_of
from ._fitted_light import AbstractFittedLight


class PagedLight(AbstractFittedLight):
    """A directional light whose shadow map is virtual, and has a layer for each resident page.

    `ResolutionMatched` makes one for a light and a camera.

    - `light`: the directional light, whose own map is the virtual one.
    - `camera`: the view of the camera.
    - `end`: the depth along the camera's axis at which shadows end, in world units.
    - `pages`: the resident pages. Layers without a page are never looked up, and not drawn.
    - `finest`: (c, c), the layer of the finest resident page over each page of level 0.
    - `requested`: the number of requested pages, at the layout's own bias of levels.
    - `bias`: the bias of levels at which pages are resident. It is the layout's own bias, unless this bias requests
        more pages than there are layers.
    - `raised`: the number of levels by which it was raised, so that all pages have a layer.
    - `too_coarse`: the share in [0, 1] of the points that need a finer level than the finest.
    """

    light: AbstractLight
    camera: View
    end: Scalar
    pages: Pages
    finest: Int[Array, "c c"]
    requested: Int[Array, ""]
    bias: Scalar
    raised: Scalar
    too_coarse: Scalar

    @property
    def capacity(self) -> int:
        """The number of layers."""
        return self.pages.level.shape[0]

    def view(self) -> View:
        return dataclasses.replace(self.light.view(), tile=self.pages.tile, pages=self.pages)

    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"]:
        clip = self.light.view().clip(lax.stop_gradient(points))
        column, row = (cell_of(clip[..., k] * 0.5 + 0.5, self.pages.levels) for k in range(2))
        return self.finest[row, column]
