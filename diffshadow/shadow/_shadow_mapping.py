"""Shadow mapping: from a map and a surface to visibility."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._misc import in_unit_range
from .._types import Mask, Visibility
from ..geometry import Edges, Scene
from ..raster import Surface
from ._compare import AbstractCompare, HardCompare
from ._lookup import Lookup, look_up, within_frustum
from ._map import MapSettings, ShadowMap
from ._receiver import receiver
from ._technique import AbstractTechnique
from .biases import AbstractBias
from .filters import AbstractFilter

# Texels beyond the map's border, and so far that no filter reaches it.
_NOWHERE = -1e6


class ShadowMapping(AbstractTechnique):
    """Shadow mapping (Williams 1978), and how its map becomes visibility.

    - `filter`: where the map is tapped.
    - `bias`: what keeps surfaces from shadowing themselves.
    - `compare`: how depths are compared.
    - `map`: how the map is drawn.
    """

    filter: AbstractFilter
    bias: AbstractBias
    compare: AbstractCompare = HardCompare()
    map: MapSettings = eqx.field(static=True, default=MapSettings())

    def prepare(self, scene: Scene, surface: Surface | None = None) -> ShadowMap:
        """The shadow map of the scene's casters under its only light. It does not depend on `surface`.

        **Raises** what `draw_shadow_map` raises. For use inside `jax.jit`, call that function with a capacity.
        """
        casters = scene.casters
        edges = Edges.of(casters) if self.map.silhouettes else None
        return self.map.draw(casters, scene.light, edges=edges)

    def visibility(self, state: ShadowMap, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        A receiver beyond the map's border or its far plane is lit; one whose surface faces away from the light's centre
        is dark, since light would have to come through it. Pixels without a surface are lit.
        """
        return _visibility(self.filter, self.bias, self.compare, state, surface)

    def covered(self, state: ShadowMap, surface: Surface) -> Mask:
        """Pixels whose surface lies within the light's frustum, (h, w): those that the map can say something of."""
        return _covered(self.bias, state, surface)


# Without the settings of the map, on which these programs do not depend.
@eqx.filter_jit
def _visibility(
    filter: AbstractFilter, bias: AbstractBias, compare: AbstractCompare, shadow_map: ShadowMap, surface: Surface
) -> Visibility:
    lookup, cosine = _look_up(bias, shadow_map, surface)
    faces_away = surface.mask & ~(cosine > 0)
    active = surface.mask & lookup.inside & ~faces_away
    # The others look where nothing has to be computed.
    lookup = lookup.at(*(jnp.where(active, place, _NOWHERE) for place in (lookup.x, lookup.y)))
    # Barrier: otherwise XLA recomputes the projection for every tap. One for each array, so that those without a
    # derivative stay without one.
    lookup = jax.tree.map(lax.optimization_barrier, lookup)
    lit = in_unit_range(filter(shadow_map, lookup, compare))
    return jnp.where(active, lit, jnp.where(faces_away, 0, 1))


@eqx.filter_jit
def _covered(bias: AbstractBias, shadow_map: ShadowMap, surface: Surface) -> Mask:
    lookup, _ = _look_up(bias, shadow_map, surface)
    return surface.mask & within_frustum(lookup, shadow_map)


@eqx.filter_checkpoint
def _look_up(bias: AbstractBias, shadow_map: ShadowMap, surface: Surface) -> tuple[Lookup, Visibility]:
    # Reverse mode recomputes this: storing what it needs for every pixel takes longer.
    at = receiver(shadow_map, surface)
    return look_up(shadow_map, at, bias(at)), at.cosine
