"""The capacity to draw an arrangement, wherever its bounds let it move."""

from typing import NamedTuple

import jax

from ..._misc import round_up_to_power_of_two
from ...raster import Capacity
from ...shadow import MapCapacity

# What other values within the bounds may need, relative to the greatest need that was found.
_HEADROOM = 2


class PoseCapacity(NamedTuple):
    """The capacity to draw a shadow map, and the camera's surface."""

    shadow_map: MapCapacity = MapCapacity(Capacity())
    surface: Capacity = Capacity()

    def grown_to(self, other: "PoseCapacity") -> "PoseCapacity":
        """The least capacity that is enough for both."""
        return PoseCapacity(self.shadow_map.grown_to(other.shadow_map), self.surface.grown_to(other.surface))

    def coarser(self) -> "PoseCapacity":
        """The capacity to draw the same in coarser images."""
        shadow_map = self.shadow_map._replace(triangles=coarser(self.shadow_map.triangles))
        return PoseCapacity(shadow_map, coarser(self.surface))


def coarser(capacity: Capacity) -> Capacity:
    """The capacity to draw the same triangles in a coarser image, where none is larger."""
    total, windows = capacity.large, []
    for needed in reversed(capacity.windows):
        total += needed
        windows.append(round_up_to_power_of_two(total) if needed else 0)
    return capacity._replace(windows=tuple(reversed(windows)))


def with_headroom[AnyCapacity: (Capacity, PoseCapacity)](capacity: AnyCapacity) -> AnyCapacity:
    """Twice the capacity."""
    return jax.tree.map(lambda needed: _HEADROOM * needed, capacity)
