"""Several shadow maps in one array, as in the shadow atlases of engines."""

import math
from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_array, as_int
from .._map import ShadowMap
from ._padded_map import PaddedMap, pad

# Texels on each side of a map. Filters that read wider squares pad the map themselves.
_MARGIN = 16


class Atlas(eqx.Module):
    """Maps of one size, one after another, padded for look-ups.

    Otherwise a program that reads many maps in turn, or one map often, would copy and pad a whole map for each read of
    a few texels.

    - `texels`: (n,), the depths of all maps and their layers.
    - `shape`: the shape of each map's depths, (h, w) or (l, h, w).
    """

    texels: Float[Array, " n"]
    shape: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, maps: Sequence[ShadowMap]) -> "Atlas":
        """The atlas of maps without silhouettes whose depths have the same shape."""
        shape, dtype = maps[0].depth.shape, maps[0].depth.dtype
        # One after another, so that there is never a second copy of all.
        texels = as_array(np.zeros(cls.size(len(maps), shape), dtype))
        for number, each in enumerate(maps):
            texels = _with(texels, each, as_int(number))
        return cls(texels, shape)

    @staticmethod
    def size(maps: int, shape: tuple[int, ...]) -> int:
        """The number of texels of so many maps of this shape."""
        return maps * math.prod(shape[:-2]) * (shape[-2] + 2 * _MARGIN) * (shape[-1] + 2 * _MARGIN)

    def reading(self, shadow_map: ShadowMap, number: Int[Array, ""]) -> ShadowMap:
        """`shadow_map` with its depths replaced by the depths of the map with this number."""
        *layers, height, width = self.shape
        stride = width + 2 * _MARGIN
        rows = self.size(1, self.shape) // stride
        first = as_int(number) * rows
        own = lax.dynamic_slice(self.texels.reshape(-1, stride), (first, as_int(0)), (rows, stride))
        own = own.reshape(*layers, height + 2 * _MARGIN, stride)[..., _MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
        padded = PaddedMap(self.texels, height, width, _MARGIN, first=first)
        return ShadowMap(
            jnp.minimum(own, 1), shadow_map.light, shadow_map.depth_format, padded=padded, view=shadow_map.view
        )


@partial(jax.jit, donate_argnums=0)
def _with(texels: Float[Array, " n"], shadow_map: ShadowMap, number: Int[Array, ""]) -> Float[Array, " n"]:
    own = pad(shadow_map, _MARGIN).depth
    return lax.dynamic_update_slice(texels, own, (number * own.size,))
