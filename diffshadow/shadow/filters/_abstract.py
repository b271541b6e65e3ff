"""The interface of filters."""

import abc

import equinox as eqx
import numpy as np

from ..._misc import concrete
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap


class AbstractFilter(eqx.Module):
    """Turns a shadow map and a look-up into visibility: where the map is tapped, and how the taps are weighted."""

    @abc.abstractmethod
    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        """Visibility in [0, 1] of each receiver, (h, w): 1 lit, 0 shadowed."""

    @property
    def reach(self) -> float | None:
        """How far from the receiver's texel coordinates the filter reads the map, in texels; none if that is not
        known, such as under a trace. Maps with a margin need one that is as wide."""
        return None


def reach_of(radius: Scalar, beyond: float = 0.0) -> float | None:
    """`radius` and how far a filter reads `beyond` it, in texels; none under a trace."""
    known = concrete(radius)
    return None if known is None else float(np.max(known)) + beyond
