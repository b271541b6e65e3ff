"""Silhouettes laid out for look-ups."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..._misc import take
from ._half_planes import Rectangle
from ._silhouette_map import NO_SILHOUETTE, SilhouetteMap

# Lower bound on the area of a part of a texel, in square texels; avoids 0 / 0.
_LEAST_AREA = 1e-9
# Bounds of depths are numbers of steps, two in a word.
_STEP_BITS = 16
_STEPS = (1 << _STEP_BITS) - 1


class PaddedSilhouettes(eqx.Module):
    """Silhouettes of a padded map, and which texels have one.

    - `map`: its slots are padded as the depths are.
    - `bounds`: of the depths within each texel with one, padded too; see `may_part`.
    """

    map: SilhouetteMap
    texels: "Pyramid"
    bounds: UInt32[Array, " n"]

    @classmethod
    def of(
        cls,
        silhouettes: SilhouetteMap,
        depth: Float[Array, " n"],
        pad: Callable[[Array, int], Array],
        hides: Callable[[Array], Array],
    ) -> "PaddedSilhouettes":
        """Pads the slots by `pad`, as `depth` is, and replaces depths of empty parts by `hides`."""
        has_one = silhouettes.slot != NO_SILHOUETTE
        slot, inner, outer = pad(silhouettes.slot, NO_SILHOUETTE), hides(silhouettes.inner), hides(silhouettes.outer)
        padded = eqx.tree_at(lambda found: (found.slot, found.inner, found.outer), silhouettes, (slot, inner, outer))
        depth, inner, outer = lax.stop_gradient((depth, inner, outer))
        of_parts = lambda choose: choose(depth, take(choose(inner, outer), jnp.maximum(slot, 0)))
        bounds = _in_steps(of_parts(jnp.minimum)) << _STEP_BITS | _in_steps(of_parts(jnp.maximum))
        # Barrier, as the depth's: otherwise each look-up finds them again.
        bounds = lax.optimization_barrier(jnp.where(slot == NO_SILHOUETTE, jnp.uint32(_STEPS << _STEP_BITS), bounds))
        return cls(padded, Pyramid.of(has_one), bounds)

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
        fraction = self.map.area_within(slot, part, motion) / jnp.maximum(area, _LEAST_AREA)
        return outer + fraction * (inner - outer) - function(depth)


def may_part(bounds: UInt32[Array, "*n"], depth: Float[Array, "*n"] | None = None) -> Bool[Array, "*n"]:
    """Whether receivers at `depth` may lie between the parts of texels with these bounds; at any depth if left out.

    Bounds are the depths of the nearest and the farthest part in one word, in steps, rounded down as the receivers'
    depth is: some that lie close to a part may be taken for between. Of a texel without parts, the bounds are those of
    no depth.
    """
    nearest, farthest = bounds >> _STEP_BITS, bounds & _STEPS
    if depth is None:
        return nearest <= farthest
    step = _in_steps(depth)
    return (nearest <= step) & (step <= farthest)


def _in_steps(depth: Float[Array, "*n"]) -> UInt32[Array, "*n"]:
    return jnp.clip(depth * _STEPS, 0, _STEPS).astype(jnp.uint32)


class Pyramid(eqx.Module):
    """Which blocks of 1, 2, 4, ... texels a side contain a marked texel, from the finest level to the coarsest.

    - `marked`: all levels, flattened and concatenated; `levels`: (first, rows, columns) of each.
    """

    marked: Bool[Array, " n"]
    levels: tuple[tuple[int, int, int], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, marked: Bool[Array, "*l h w"]) -> "Pyramid":
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
            # Barrier: otherwise XLA computes finer levels again for each coarser one.
            level = lax.optimization_barrier(level)

    def any_within(
        self, x: Float[Array, "*n"], y: Float[Array, "*n"], layer: Int[Array, "*n"] | None, reach: Float[Array, "..."]
    ) -> Bool[Array, "*n"]:
        """Whether there may be a marked texel within a square of half width `reach` texels around each (x, y).

        This reads the finest level with blocks at least as wide as the square, which touches at most 2 x 2 of them.
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
                found = found | take(self.marked, place)
        # Squares outside the map are clamped to its border, and must not find marks there.
        return found & (x + reach >= 0)
