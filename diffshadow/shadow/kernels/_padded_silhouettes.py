"""Silhouettes laid out for look-ups."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..._arithmetic import take
from .._lookup import Lookup
from ..silhouettes import NO_SILHOUETTE, Rectangle, SilhouetteMap

# Lower bound on the area of a part of a texel, in square texels, which avoids 0 / 0.
_MIN_AREA = 1e-9
# Bounds of depths are numbers of steps, with the minimum in the upper half of a word and the maximum in its lower half.
_STEP_BITS = 16
_STEPS = (1 << _STEP_BITS) - 1
# The bounds of an empty set of depths.
_NONE = np.uint32(_STEPS << _STEP_BITS)
# Squares are widened by this much, in texels, because the positions of their sides are rounded.
_ROUNDING = 1 / 16


class PaddedSilhouettes(eqx.Module):
    """Silhouettes of a padded map.

    - `map`: its slots are padded as the depths are.
    - `bounds`: bounds of the depths within each texel with a silhouette, padded too; see `may_part`.
    - `blocks`: the same bounds for blocks of texels.
    """

    map: SilhouetteMap
    bounds: UInt32[Array, " n"]
    blocks: "BlockBounds"

    @classmethod
    def of(
        cls,
        silhouettes: SilhouetteMap,
        depth: Float[Array, "*l h w"],
        pad: Callable[[Array, Any], Array],
        beyond: float,
    ) -> "PaddedSilhouettes":
        """Pads the slots by `pad`, like `depth`, and sets the depths of empty parts `beyond` all others."""
        slot = silhouettes.slot
        inner, outer = (jnp.where(part < 1, part, beyond) for part in (silhouettes.inner, silhouettes.outer))
        replaced = pad(slot, NO_SILHOUETTE), inner, outer
        padded = eqx.tree_at(lambda found: (found.slot, found.inner, found.outer), silhouettes, replaced)
        depth, inner, outer = lax.stop_gradient((depth, inner, outer))
        of_parts = lambda choose: choose(depth, take(choose(inner, outer), jnp.maximum(slot, 0)))
        bounds = _in_steps(of_parts(jnp.minimum)) << _STEP_BITS | _in_steps(of_parts(jnp.maximum))
        # Without the barrier, each look-up finds them again.
        bounds = lax.optimization_barrier(jnp.where(slot == NO_SILHOUETTE, _NONE, bounds))
        return cls(padded, pad(bounds, _NONE), BlockBounds.of(bounds))

    def change(
        self,
        function: Callable[[Array], Array],
        depth: Float[Array, "*n"],
        slot: Int[Array, "*n"],
        part: Rectangle,
        motion: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None,
    ) -> Float[Array, "*n"]:
        """The mean of a function of depth over a `part` of a texel, minus its value at the stored `depth`.

        Only for texels with a silhouette, at `slot`. The silhouette is moved by `motion` if given.
        """
        slot = jnp.maximum(slot, 0)
        inner, outer = function(take(self.map.inner, slot)), function(take(self.map.outer, slot))
        area = (part.right - part.left) * (part.above - part.below)
        fraction = self.map.area_within(slot, part, motion) / jnp.maximum(area, _MIN_AREA)
        return outer + fraction * (inner - outer) - function(depth)


def may_part(
    bounds: UInt32[Array, "*n"], depths: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None
) -> Bool[Array, "*n"]:
    """Whether receivers may be between the parts of texels with these bounds.

    `depths` are the minimum and the maximum depth that receivers may have; by default any depth. Receivers are rounded
    down to steps, like the bounds, so some receivers close to a part may count as between the parts.
    """
    least, greatest = bounds >> _STEP_BITS, bounds & _STEPS
    if depths is None:
        return least <= greatest
    low, high = _in_steps(depths[0]), _in_steps(depths[1])
    return (least <= high) & (low <= greatest)


def _in_steps(depth: Float[Array, "*n"]) -> UInt32[Array, "*n"]:
    return jnp.clip(depth * _STEPS, 0, _STEPS).astype(jnp.uint32)


class BlockBounds(eqx.Module):
    """Bounds of depths within blocks of 2, 4, 8, ... texels a side, from the finest level to the coarsest.

    A level's blocks begin half a block apart, so that few blocks cover a square without reaching far beyond it.

    - `bounds`: bounds of all levels, flattened and concatenated; `levels`: (first, rows, columns) of each level.
    """

    bounds: UInt32[Array, " n"]
    levels: tuple[tuple[int, int, int], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, bounds: UInt32[Array, "*l h w"]) -> "BlockBounds":
        """The blocks, from the bounds within texels."""
        level, first = _with_next(bounds.reshape(-1, *bounds.shape[-2:]), 1), 0
        flat, levels = [], []
        while True:
            # Without the barrier, XLA computes finer levels again for each coarser one.
            level = lax.optimization_barrier(level)
            _, rows, columns = level.shape
            flat.append(level.reshape(-1))
            levels.append((first, rows, columns))
            first += level.size
            if max(rows, columns) <= 4:
                # Without the barrier, XLA finds the level of each word separately, which takes ten times as long.
                return cls(jnp.concatenate(lax.optimization_barrier(flat)), tuple(levels))
            level = _with_next(level, 2)[:, ::2, ::2]

    def may_part(
        self,
        lookup: Lookup,
        reach: Float[Array, "..."],
        depths: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None,
    ) -> Bool[Array, "*n"]:
        """Whether `may_part` may be true for a texel within a square of half width `reach` texels around a look-up.

        This reads the finest level whose 2 x 2 blocks cover the square.
        """
        x, y, reach, depths = lax.stop_gradient((lookup.x, lookup.y, reach, depths))
        # Blocks that begin at most twice their spacing apart leave no gap. The square overlaps at most four spacings.
        level = jnp.ceil(jnp.log2(jnp.maximum((2 * reach + _ROUNDING) / 3, 1))).astype(jnp.int32)
        level = jnp.minimum(level, len(self.levels) - 1)
        first, rows, columns = jnp.moveaxis(jnp.array(self.levels, jnp.int32)[level], -1, 0)

        def ends(middle: Array, count: Array) -> tuple[Array, Array]:
            """The first and the last block that cover the square along an axis."""
            spacing = lambda place: jnp.clip(place * 0.5**level, 0, count - 1).astype(jnp.int32)
            low, high = spacing(middle - reach), spacing(middle + reach)
            return low, jnp.maximum(high - 1, low)

        before = 0 if lookup.layer is None else lookup.layer
        found = jnp.zeros(x.shape, bool)
        for row in ends(y, rows):
            for column in ends(x, columns):
                found = found | may_part(take(self.bounds, first + (before * rows + row) * columns + column), depths)
        return found


def _with_next(bounds: UInt32[Array, "l h w"], apart: int) -> UInt32[Array, "l h w"]:
    """Bounds of the depths at each position and at the positions at the distance `apart` above, to the right and
    both."""
    for axis in (1, 2):
        sides = [(0, apart if own == axis else 0) for own in range(3)]
        after = lax.slice_in_dim(jnp.pad(bounds, sides, constant_values=_NONE), apart, None, axis=axis)
        least = jnp.minimum(bounds, after) & _NONE
        bounds = least | jnp.maximum(bounds & _STEPS, after & _STEPS)
    return bounds
