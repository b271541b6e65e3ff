"""The interface of filters."""

import abc

from ..._checks import CheckedModule
from ..._types import Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap


class AbstractFilter(CheckedModule):
    """Turns a shadow map and a look-up into visibility: where the map is tapped, and how the taps are weighted."""

    @abc.abstractmethod
    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        """Visibility in [0, 1] of each receiver, (h, w): 1 lit, 0 shadowed."""
