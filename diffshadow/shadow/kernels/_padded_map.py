"""Shadow maps laid out for look-ups.

Empty texels, and everything beyond the border, must be lit for any width of a soft compare. The map is therefore padded
with empty texels. Their number on each side is the side of a look-up's square. Clamped look-ups then always read
existing texels, without a branch.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ...geometry import View
from .._map import ShadowMap
from .._receiver import is_in_front
from ._padded_silhouettes import PaddedSilhouettes

# The depth of empty texels: behind any receiver by far more than the width of any soft compare.
_NOTHING = 1e6


class PaddedMap(eqx.Module):
    """A shadow map's depths as a flat array, padded with depths that shadow nothing.

    - `margin`: texels on each side.
    - `silhouettes`: the casters' outlines within texels, or `None`.
    - `first`: the first row of the map in `depth`, if it is one of several in an `Atlas`.
    - `apart`: whether the depths of all look-ups are read before any is compared.
    - `view`: the map's view, if derivatives follow it; see `Lookup.position`.
    """

    depth: Float[Array, " n"]
    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)
    silhouettes: PaddedSilhouettes | None = None
    first: Int[Array, ""] | None = None
    apart: bool = eqx.field(static=True, default=False)
    view: View | None = None

    @property
    def stride(self) -> int:
        """Offset in the flat array from a texel to the one above it."""
        return self.width + 2 * self.margin

    def place(self, x: Float[Array, "*n"], y: Float[Array, "*n"], layer: Int[Array, "*n"] | None) -> Int[Array, "*n"]:
        """Index of texel (x, y), integers. There are `margin` texels to its right and `margin` texels above it. If all
        of these texels are outside the map, the index refers to other empty texels.
        """
        row = _count_from(-self.margin, y, self.height)
        if layer is not None:
            row = row + layer * (self.height + 2 * self.margin)
        if self.first is not None:
            row = row + self.first
        # Without the barrier, XLA computes indices where it reads texels, one by one instead of in SIMD vectors.
        return lax.optimization_barrier(row * self.stride + _count_from(-self.margin, x, self.width))

    def depth_at(self, place: Int[Array, "*n"], skip: Int[Array, ""] | int) -> Float[Array, "*n"]:
        """The depths stored `skip` entries after `place`, fewer than `margin` texels to the right and up.

        Look-ups that differ only in `skip` share their address computation.
        """
        depth = self.read(self.depth, place, skip)
        return lax.optimization_barrier(depth) if self.apart else depth

    def texel(
        self, position: tuple[Float[Array, "*n"], ...], layer: Int[Array, "*n"] | None
    ) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
        """x and y of world points in the map of `view`.

        They are separate arrays, because XLA is slow to add up axes of three coordinates in reverse mode.
        """
        assert self.view is not None
        matrix = self.view.facing(layer).matrix
        x, y, w = (
            sum((matrix[..., row, k] * at for k, at in enumerate(position)), start=matrix[..., row, 3])
            for row in (0, 1, 3)
        )
        # Points that are not in front of the light have no silhouette nearby.
        w = jnp.where(is_in_front(self.view, w), w, 1)
        return (x / w * 0.5 + 0.5) * self.width, (y / w * 0.5 + 0.5) * self.height

    def with_depths_detached(self) -> "PaddedMap":
        """The same map without derivatives with respect to the stored depths."""
        maps = lambda padded: [] if padded.silhouettes is None else [padded.silhouettes.map]
        depths = lambda padded: (padded.depth, *(values for own in maps(padded) for values in (own.inner, own.outer)))
        return eqx.tree_at(depths, self, lax.stop_gradient(depths(self)))

    def read(self, row: Array, place: Int[Array, "*n"], skip: Int[Array, ""] | int) -> Array:
        """Like `depth_at`, from another flat array with the same layout."""
        from_there = lax.dynamic_slice(row, (skip,), (row.size - (self.margin - 1) * (self.stride + 1),))
        # XLA clamps signed indices to two bounds, and unsigned indices to one.
        index, element = place.astype(jnp.uint32)[..., None], lax.GatherDimensionNumbers((), (0,), (0,))
        return lax.gather(from_there, index, element, (1,), mode="promise_in_bounds")


def _count_from(first: int, x: Float[Array, "*n"], last: int) -> Int[Array, "*n"]:
    """`x - first` for integers x from `first` to `last`, and `last - first` for all others.

    Adding 1.5 · 2^23 to a small integer puts it into the lowest bits of a float32. This takes one SIMD instruction. A
    conversion takes several, because it checks the range. As unsigned words, negative differences exceed all others.
    """
    dtype = np.dtype(x.dtype)
    word = np.dtype(f"uint{8 * dtype.itemsize}")
    offset = np.asarray(1.5 * 2.0 ** np.finfo(dtype).nmant, dtype)
    count = lax.bitcast_convert_type(x + offset, word) - (offset + dtype.type(first)).view(word)
    return jnp.minimum(count, word.type(last - first)).astype(jnp.int32)


def pad(shadow_map: ShadowMap, margin: int = 2) -> PaddedMap:
    """Pads a map with empty texels, unless it is padded already. `margin` is the number of texels per side that a
    look-up reads."""
    ready = shadow_map.padded
    if ready is not None and ready.margin >= margin:
        return ready
    height, width = shadow_map.resolution
    depth = jnp.where(shadow_map.depth < 1, shadow_map.depth, _NOTHING)

    def padded(values: Array, beyond: int | float | np.uint32) -> Array:
        sides = [(0, 0)] * (values.ndim - 2) + [(margin, margin)] * 2
        # Without the barrier, XLA pads again for each reader, or texel by texel to make the flat array.
        return lax.optimization_barrier(jnp.pad(values, sides, constant_values=beyond)).reshape(-1)

    found = shadow_map.silhouettes
    silhouettes = None if found is None else PaddedSilhouettes.of(found, depth, padded, _NOTHING)
    view = None if found is None else shadow_map.view
    return PaddedMap(padded(depth, _NOTHING), height, width, margin, silhouettes, view=view)
