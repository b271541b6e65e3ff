"""Shadow mapping: from a map and a surface to visibility."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._misc import in_unit_range
from .._types import Mask, Visibility
from ..raster import Surface
from ._compare import AbstractCompare, HardCompare
from ._lookup import Lookup, look_up, within_frustum
from ._map import ShadowMap
from ._receiver import receiver
from .biases import AbstractBias
from .filters import AbstractFilter

# Texels beyond the map's border, and so far that no filter reaches it.
_NOWHERE = -1e6


class ShadowMapping(eqx.Module):
    """How a shadow map becomes visibility.

    - `filter`: where the map is tapped.
    - `bias`: what keeps surfaces from shadowing themselves.
    - `compare`: how depths are compared.
    """

    filter: AbstractFilter
    bias: AbstractBias
    compare: AbstractCompare = HardCompare()

    def visibility(self, shadow_map: ShadowMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        A receiver beyond the map's border or its far plane is lit; one whose surface is turned away from the light's
        centre is dark, since light would have to come through it. Pixels without a surface are lit.
        """
        lookup, cosine = self._look_up(shadow_map, surface)
        turned_away = surface.mask & ~(cosine > 0)
        active = surface.mask & lookup.inside & ~turned_away
        # The others look where nothing has to be computed.
        lookup = lookup.at(*(jnp.where(active, place, _NOWHERE) for place in (lookup.x, lookup.y)))
        # Barrier: otherwise XLA recomputes the projection for every tap. One for each array, so that those without a
        # derivative stay without one.
        lookup = jax.tree.map(lax.optimization_barrier, lookup)
        lit = in_unit_range(self.filter(shadow_map, lookup, self.compare))
        return jnp.where(active, lit, jnp.where(turned_away, 0, 1))

    def covered(self, shadow_map: ShadowMap, surface: Surface) -> Mask:
        """Pixels whose surface lies within the light's frustum, (h, w): those that the map can say something of."""
        lookup, _ = self._look_up(shadow_map, surface)
        return surface.mask & within_frustum(lookup, shadow_map)

    @eqx.filter_checkpoint
    def _look_up(self, shadow_map: ShadowMap, surface: Surface) -> tuple[Lookup, Visibility]:
        # Reverse mode recomputes this: storing what it needs for every pixel takes longer.
        at = receiver(shadow_map, surface)
        return look_up(shadow_map, at, self.bias(at)), at.cosine
