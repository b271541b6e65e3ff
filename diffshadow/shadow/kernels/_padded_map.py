"""Shadow maps laid out for look-ups.

A texel that holds nothing, and everything beyond the border, is lit however soft the compare. To that end the map is
padded by as many texels as a look-up reads along a side: clamped look-ups then always land on texels that exist, and
no branch is needed.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..._misc import take
from .._map import ShadowMap
from ..silhouettes._padded import PaddedSilhouettes

# Deeper than any receiver by far more than any soft compare is wide.
_NOTHING = 1e6


class PaddedMap(eqx.Module):
    """A shadow map's depths as one row of memory, padded with depths that shadow nothing.

    - `margin`: texels on each side.
    - `silhouettes`: where casters end within texels, if that is known.
    """

    depth: Float[Array, " n"]
    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)
    silhouettes: PaddedSilhouettes | None = None

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
        return self.read(self.depth, place, skip)

    def read(self, row: Array, place: Int[Array, "*n"], skip: Int[Array, ""] | int) -> Array:
        """As `depth_at`, from another row of memory with the same layout."""
        from_there = lax.dynamic_slice(row, (skip,), (row.size - (self.margin - 1) * (self.stride + 1),))
        return take(from_there, place)


def pad(shadow_map: ShadowMap, margin: int = 2) -> PaddedMap:
    """The map, padded by the texels that a look-up reads along a side, with empty texels that shadow nothing."""
    height, width = shadow_map.resolution
    hides = lambda depth: jnp.where(depth < 1, depth, _NOTHING)

    def padded(values: Array, beyond: int | float) -> Array:
        sides = [(0, 0)] * (values.ndim - 2) + [(margin, margin)] * 2
        # Barrier: otherwise XLA pads again for each reader, or texel by texel for one row of memory.
        return lax.optimization_barrier(jnp.pad(values, sides, constant_values=beyond)).reshape(-1)

    found = shadow_map.silhouettes
    silhouettes = None if found is None else PaddedSilhouettes.of(found, padded, hides)
    return PaddedMap(padded(hides(shadow_map.depth), _NOTHING), height, width, margin, silhouettes)
