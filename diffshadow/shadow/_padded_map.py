"""Shadow maps laid out for look-ups.

A texel that holds nothing, and everything beyond the border, is lit however soft the compare. To that end the map is
padded by as many texels as a look-up reads along a side: clamped look-ups then always land on texels that exist, and
no branch is needed.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._misc import take
from ._map import ShadowMap
from .silhouettes import NO_SILHOUETTE, Rectangle, SilhouetteMap

# Deeper than any receiver by far more than any soft compare is wide.
_NOTHING = 1e6
# Of a part of a texel, in square texels: less cannot be told from none.
_LEAST_AREA = 1e-9


class PaddedMap(eqx.Module):
    """A shadow map's depths as one row of memory, padded with depths that shadow nothing.

    - `margin`: texels on each side.
    - `silhouettes`: where casters end within texels, if that is known.
    """

    depth: Float[Array, " n"]
    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)
    silhouettes: "_PaddedSilhouettes | None" = None

    @property
    def stride(self) -> int:
        """Places from a texel to the one above it."""
        return self.width + 2 * self.margin

    def place(self, x: Float[Array, "*n"], y: Float[Array, "*n"], layer: Int[Array, "*n"] | None) -> Int[Array, "*n"]:
        """Where texel (x, y), whole numbers, is stored: clamped so that a `margin` of texels from there on exist."""
        clamp = lambda p, size: jnp.clip(p, -self.margin, size).astype(jnp.int32) + self.margin
        row = clamp(y, self.height)
        if layer is not None:
            row = row + layer * (self.height + 2 * self.margin)
        return row * self.stride + clamp(x, self.width)

    def depth_at(self, place: Int[Array, "*n"], skip: Int[Array, ""] | int) -> Float[Array, "*n"]:
        """The depths stored `skip` places after `place`: fewer than `margin` texels to the right, and up.

        Look-ups that differ by `skip` alone share what it takes to find them.
        """
        return self._read(self.depth, place, skip)

    def has_silhouette(self, place: Int[Array, "*n"], skip: Int[Array, ""] | int) -> Bool[Array, "*n"]:
        """Whether a caster ends in the texel `skip` places after `place`. Only for maps with silhouettes."""
        return self._read(self._found.slot, place, skip) != NO_SILHOUETTE

    def change_by_silhouette(
        self,
        function: Callable[[Array], Array],
        place: Int[Array, "*n"],
        part: Rectangle,
        motion: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None,
    ) -> Float[Array, "*n"]:
        """By how much the mean of a function of depth, over a `part` of a texel, differs from that of the stored depth.

        Only for texels with a silhouette, which is taken to have moved by `motion`.
        """
        found = self._found
        slot = jnp.maximum(take(found.slot, place), 0)
        inner, outer = function(take(found.inner, slot)), function(take(found.outer, slot))
        area = (part.right - part.left) * (part.above - part.below)
        share = found.area_within(slot, part, motion) / jnp.maximum(area, _LEAST_AREA)
        return outer + share * (inner - outer) - function(take(self.depth, place))

    @property
    def _found(self) -> SilhouetteMap:
        assert self.silhouettes is not None
        return self.silhouettes.map

    def _read(self, row: Array, place: Int[Array, "*n"], skip: Int[Array, ""] | int) -> Array:
        from_there = lax.dynamic_slice(row, (skip,), (row.size - (self.margin - 1) * (self.stride + 1),))
        return take(from_there, place)


def pad(shadow_map: ShadowMap, margin: int = 2) -> PaddedMap:
    """The map, padded by the texels that a look-up reads along a side, with empty texels that shadow nothing."""
    height, width = shadow_map.resolution
    hides = lambda depth: jnp.where(depth < 1, depth, _NOTHING)

    def padded(values: Array, beyond: int | float) -> Array:
        sides = [(0, 0)] * (values.ndim - 2) + [(margin, margin)] * 2
        # Else XLA pads anew for each reader, or, texel by texel, for one row of memory.
        return lax.optimization_barrier(jnp.pad(values, sides, constant_values=beyond)).reshape(-1)

    silhouettes, found = None, shadow_map.silhouettes
    if found is not None:
        where = lambda found: (found.slot, found.inner, found.outer)
        new = padded(found.slot, NO_SILHOUETTE), hides(found.inner), hides(found.outer)
        silhouettes = _PaddedSilhouettes(eqx.tree_at(where, found, new), _Pyramid.of(found.slot != NO_SILHOUETTE))
    return PaddedMap(padded(hides(shadow_map.depth), _NOTHING), height, width, margin, silhouettes)


class _PaddedSilhouettes(eqx.Module):
    """Silhouettes whose slots are padded as their map is, and which texels have one."""

    map: SilhouetteMap
    texels: "_Pyramid"


class _Pyramid(eqx.Module):
    """Which blocks of 1, 2, 4, ... texels a side hold a marked one, from the finest level to the coarsest.

    - `marked`: of all levels, one after the other; `levels`: (first, rows, columns) of each.
    """

    marked: Bool[Array, " n"]
    levels: tuple[tuple[int, int, int], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, marked: Bool[Array, "*l h w"]) -> "_Pyramid":
        level, first = marked.reshape(-1, *marked.shape[-2:]), 0
        flat, levels = [], []
        while True:
            _, rows, columns = level.shape
            flat.append(level.reshape(-1))
            levels.append((first, rows, columns))
            first += level.size
            if rows == columns == 1:
                return cls(jnp.concatenate(flat), tuple(levels))
            even = jnp.pad(level, ((0, 0), (0, rows % 2), (0, columns % 2)))
            level = even[:, ::2, ::2] | even[:, 1::2, ::2] | even[:, ::2, 1::2] | even[:, 1::2, 1::2]

    def any_within(
        self, x: Float[Array, "*n"], y: Float[Array, "*n"], layer: Int[Array, "*n"] | None, reach: Float[Array, "..."]
    ) -> Bool[Array, "*n"]:
        """Whether there may be a marked texel within a square of half width `reach` texels round each (x, y).

        The least blocks as wide as the square are asked: it touches two by two of them at the most.
        """
        x, y, reach = lax.stop_gradient((x, y, reach))
        level = jnp.ceil(jnp.log2(jnp.maximum(2 * reach, 1))).astype(jnp.int32)
        level = jnp.minimum(level, len(self.levels) - 1)
        first, rows, columns = jnp.moveaxis(jnp.array(self.levels, jnp.int32)[level], -1, 0)
        block = lambda place, size: jnp.clip(place * 0.5**level, 0, size - 1).astype(jnp.int32)
        before = 0 if layer is None else layer
        found = jnp.zeros(x.shape, bool)
        for row in (block(y - reach, rows), block(y + reach, rows)):
            for column in (block(x - reach, columns), block(x + reach, columns)):
                place = first + (before * rows + row) * columns + column
                found = found | self.marked.at[place].get(mode="promise_in_bounds")
        # Squares beyond the border would find what is on it.
        return found & (x + reach >= 0)
