"""Several shadow maps in one array, as in the shadow atlases of engines."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_array, as_int
from ...geometry import AbstractLight
from .._map import ShadowMap
from ._padded_map import PaddedMap, pad

# Texels on each side of a map. Filters that read wider squares pad the map themselves.
_MARGIN = 16


class Atlas(eqx.Module):
    """Maps of one size, one after another, padded for look-ups.

    Without an atlas, a program that reads many maps in turn, or one map often, would copy and pad a whole map for each
    read of a few texels.

    - `texels`: (n,), the depths of all maps and their layers.
    - `shape`: the shape of each map's depths, (h, w) or (l, h, w).
    """

    texels: Float[Array, " n"]
    shape: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, maps: Sequence[ShadowMap]) -> "Atlas":
        """The atlas of maps without silhouettes whose depths have the same shape."""
        # One after another, so that there is never a second copy of all maps.
        atlas = cls.of_none(len(maps), maps[0])
        for number, each in enumerate(maps):
            atlas = atlas.holding(each, number)
        return atlas

    @classmethod
    def of_none(cls, count: int, like: ShadowMap) -> "Atlas":
        """An atlas with memory for `count` maps of the size of `like`."""
        return cls(as_array(np.zeros(cls.size(count, like.depth.shape), like.depth.dtype)), like.depth.shape)

    def holding(self, shadow_map: ShadowMap, number: int) -> "Atlas":
        """The atlas with this map at the position `number`. The old atlas can no longer be read."""
        return Atlas(_with(self.texels, shadow_map, as_int(number)), self.shape)

    @staticmethod
    def size(maps: int, shape: tuple[int, ...]) -> int:
        """The number of texels of this many maps of this shape."""
        return maps * math.prod(shape[:-2]) * (shape[-2] + 2 * _MARGIN) * (shape[-1] + 2 * _MARGIN)

    def reading(self, shadow_map: ShadowMap, number: Int[Array, ""]) -> ShadowMap:
        """`shadow_map` with its depths replaced by the depths of the map with this number."""
        *_, height, width = self.shape
        padded = PaddedMap(self.texels, height, width, _MARGIN, first=self._first_row(number))
        return ShadowMap(
            self.depths(number), shadow_map.light, shadow_map.depth_format, padded=padded, view=shadow_map.view
        )

    def depths(self, number: Int[Array, ""]) -> Float[Array, "*l h w"]:
        """The original depths of the map with this number."""
        *layers, height, width = self.shape
        stride = width + 2 * _MARGIN
        rows = self.size(1, self.shape) // stride
        own = lax.dynamic_slice(self.texels.reshape(-1, stride), (self._first_row(number), as_int(0)), (rows, stride))
        own = own.reshape(*layers, height + 2 * _MARGIN, stride)[..., _MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
        return jnp.minimum(own, 1)

    def _first_row(self, number: Int[Array, ""]) -> Int[Array, ""]:
        return as_int(number) * (self.size(1, self.shape) // (self.shape[-1] + 2 * _MARGIN))


class StoredMap(eqx.Module):
    """A shadow map whose depths are only in an atlas, so that many maps need memory once.

    - `atlas`: the atlas with the map at the position `number`.
    - `rest`: the map without depths.
    """

    atlas: Atlas
    number: np.int32 = eqx.field(converter=np.int32)
    rest: ShadowMap

    @property
    def light(self) -> AbstractLight:
        """The light it was drawn from."""
        return self.rest.light

    def whole(self) -> ShadowMap:
        """The map, with the same depths to the bit."""
        return eqx.tree_at(_depth, self.rest, _depths(self.atlas, self.number), is_leaf=lambda leaf: leaf is None)


def without_depths(shadow_map: ShadowMap) -> ShadowMap:
    """A map without its depths, as a program reads it from an atlas."""
    return eqx.tree_at(_depth, shadow_map, None)


def _depth(shadow_map: ShadowMap) -> Any:
    return shadow_map.depth


@jax.jit
def _depths(atlas: Atlas, number: Int[Array, ""]) -> Float[Array, "*l h w"]:
    return atlas.depths(number)


@partial(jax.jit, donate_argnums=0)
def _with(texels: Float[Array, " n"], shadow_map: ShadowMap, number: Int[Array, ""]) -> Float[Array, " n"]:
    own = pad(shadow_map, _MARGIN).depth
    return lax.dynamic_update_slice(texels, own, (number * own.size,))
