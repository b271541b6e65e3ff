"""The interface of filters."""

import abc

import numpy as np

from ..._arithmetic import concrete
from ..._checks import CheckedModule
from ..._types import Visibility
from ...settings.filters import Filter
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import ShaderPart


class AbstractFilter(CheckedModule):
    """Turns a shadow map and a look-up into visibility. A filter defines the positions and the weights of its taps.

    !!! Example

        ```python
        class Corners(shadow.AbstractFilter):
            radius: float = 1.0

            def __call__(self, shadow_map, lookup, compare):
                corners = jnp.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
                pattern, radius = shadow.Pattern(corners[:, None, None]), jnp.asarray(self.radius)
                return shadow.mean_of_taps(shadow_map, lookup, compare, radius, pattern, "bilinear")

        shadow.ShadowMapping(Corners(2.0), shadow.Bias(1.0)).visibility(state, surface).shape  # (32, 32)
        ```
    """

    @abc.abstractmethod
    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        """Visibility in [0, 1] of each receiver, (h, w): 1 lit, 0 shadowed."""

    def shader(self) -> ShaderPart:
        """The function `shadow_filter` of a shader.

        **Raises** `ValueError` if it has no shader.
        """
        raise ValueError(
            f"the filter is of type {type(self).__name__}, which has no shader; expected one of this package's "
            "filters, such as PercentageCloser"
        )

    @property
    def reach(self) -> float | None:
        """The distance from the receiver's texel coordinates to the farthest texel that the filter reads, in texels.
        `None` if unknown, for example inside `jit` or for a filter without settings. Maps with a margin need a margin
        of this width."""
        reach = concrete(self.settings.reach_of(self)) if issubclass(self.settings, Filter) else None
        return None if reach is None else float(np.max(reach))
