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

# A texel position so far outside the map that no filter reaches it.
_NOWHERE = -1e6


class ShadowMapping(AbstractTechnique):
    """Shadow mapping (Williams 1978).

    - `filter`: where the map is tapped, and how the taps are weighted.
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

        A receiver outside the map or beyond its far plane is lit. A surface that faces away from the light's centre is
        dark. Pixels without a surface are lit.
        """
        return _visibility(self.filter, self.bias, self.compare, state, surface)

    def covered(self, state: ShadowMap, surface: Surface) -> Mask:
        """Pixels whose surface lies within the light's frustum, (h, w): those that the map covers."""
        return _covered(self.bias, state, surface)


# These take no map settings: the compiled programs do not depend on them.
@eqx.filter_jit
def _visibility(
    filter: AbstractFilter, bias: AbstractBias, compare: AbstractCompare, shadow_map: ShadowMap, surface: Surface
) -> Visibility:
    lookup, cosine = _look_up(bias, shadow_map, surface)
    faces_away = surface.mask & ~(cosine > 0)
    active = surface.mask & lookup.inside & ~faces_away
    # Inactive pixels look far outside the map, where no work is done.
    lookup = lookup.at(*(jnp.where(active, place, _NOWHERE) for place in (lookup.x, lookup.y)))
    # Barrier: otherwise XLA recomputes the projection for every tap. One barrier per array, so that arrays without a
    # derivative do not get one.
    lookup = jax.tree.map(lax.optimization_barrier, lookup)
    lit = in_unit_range(filter(shadow_map, lookup, compare))
    return jnp.where(active, lit, jnp.where(faces_away, 0, 1))


@eqx.filter_jit
def _covered(bias: AbstractBias, shadow_map: ShadowMap, surface: Surface) -> Mask:
    lookup, _ = _look_up(bias, shadow_map, surface)
    return surface.mask & within_frustum(lookup, shadow_map)


@eqx.filter_checkpoint
def _look_up(bias: AbstractBias, shadow_map: ShadowMap, surface: Surface) -> tuple[Lookup, Visibility]:
    # Reverse mode recomputes this, which is faster than storing residuals for every pixel.
    at = receiver(shadow_map, surface)
    return look_up(shadow_map, at, bias(at)), at.cosine
