"""Shadow maps (Williams 1978): the scene's depth as the light sees it.

A map stores a window depth at the centre of each texel, by default of the nearest caster: (h, w), from 0 at the near
plane to 1 at the far plane, and 1 where the light sees nothing. Row 0 is the bottom row. A light with several views,
such as a point light or cascades, has a layer for each: (l, h, w).

A map can also store the casters' silhouettes within its texels. They give shadows derivatives with respect to lights
and meshes.
"""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._checks import shown_with_values
from .._pictures import as_html, grey_of, is_known
from .._types import Resolution
from ..geometry import AbstractLight, View
from ..settings.maps import DepthFormat
from ..settings.maps import ShadowMap as Settings
from .silhouettes import SilhouetteMap

Overflow = Bool[Array, ""]
"""Whether some of a map's silhouettes are missing, because they cross more texel sides than the memory allows."""


class ShadowMap(eqx.Module):
    """The depth that a light sees.

    - `depth`: (h, w), window depth; 1 where the light sees nothing. Row 0 is the bottom row. (l, h, w) for a light with
        several views, such as a point light.
    - `light`: the light it was drawn from.
    - `depth_format`: the storage format of depths.
    - `silhouettes`: the casters' outlines within texels; `None` if the map was drawn without edges.
    - `padded`: its depths in an `Atlas`, which look-ups then read instead of padding `depth`.
    - `view`: the light's view, which every program that reads the map needs. The view is computed once with the map.
        For another light, make another map.
    - `overflow`: whether silhouettes are missing, so that the map is wrong; `None` if drawing raises an error instead.
    - `crossings`: the number of texel sides that the silhouettes cross, including missing silhouettes; known if
      `overflow` is.
    """

    depth: Float[Array, "*l h w"]
    light: AbstractLight
    depth_format: DepthFormat = eqx.field(static=True)
    silhouettes: SilhouetteMap | None
    padded: Any
    view: View
    overflow: Overflow | None
    crossings: Int[Array, ""] | None

    def __init__(
        self,
        depth: Float[Array, "*l h w"],
        light: AbstractLight,
        depth_format: DepthFormat = Settings.depth_format,
        silhouettes: SilhouetteMap | None = None,
        padded: Any = None,
        view: View | None = None,
        overflow: Overflow | None = None,
        crossings: Int[Array, ""] | None = None,
    ):
        self.depth, self.light, self.depth_format = depth, light, depth_format
        self.silhouettes, self.padded = silhouettes, padded
        self.overflow, self.crossings = overflow, crossings
        self.view = light.view() if view is None else view

    def __repr__(self) -> str:
        return shown_with_values(self)

    def _repr_html_(self) -> str | None:
        """A picture of the depths. Near depths are dark. If there are several layers, the first is shown."""
        if not is_known(self):
            return None
        depth = np.asarray(self.depth)
        size = " x ".join(map(str, depth.shape[::-1]))
        title = f"ShadowMap of a {type(self.light).__name__}: {size} texels, {self.depth_format}"
        return as_html(title, grey_of(depth.reshape(-1, *depth.shape[-2:])[0]))

    @property
    def resolution(self) -> Resolution:
        """(height, width) in texels."""
        height, width = self.depth.shape[-2:]
        return height, width
