"""Percentage-closer filtering (Reeves, Salesin & Cook 1987)."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._misc import as_float, concrete
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._map import ShadowMap
from .._receiver import Lookup
from .._taps import nearest_tap, pad
from ._abstract import AbstractFilter

# Narrower than this a box cannot be told from a point.
_LEAST_RADIUS = 1e-3


class PercentageCloser(AbstractFilter):
    """The share of a box of the map that does not shadow the receiver.

    The box slides and grows smoothly: a texel counts by the part of it that the box covers. A radius of 0.5 is the
    bilinear compare; 2.5 covers 5 x 5 texels.

    - `radius`: half the box's width, in texels.
    - `max_radius`: the largest radius that can be asked for, in texels; the number of taps grows with its square. It
        defaults to `radius`, rounded up.

    **Raises** `ValueError` if `radius` is negative or above `max_radius`.
    """

    radius: Scalar
    max_radius: int = eqx.field(static=True)

    def __init__(self, radius: float | Scalar = 2.5, max_radius: float | None = None):
        self.radius = as_float(radius)
        # At least 1: a box without width still needs the least one to divide by.
        self.max_radius = max(1, math.ceil(float(radius) if max_radius is None else max_radius))

    def __check_init__(self):
        radius = concrete(self.radius)
        if radius is not None and not 0 <= radius <= self.max_radius:
            raise ValueError(
                f"the filter's radius is {radius} texels; expected 0 to max_radius = {self.max_radius}: give a larger "
                "max_radius"
            )

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        padded = pad(shadow_map)

        def tap(x: Array, y: Array) -> Visibility:
            moved = Lookup(lookup.texel + jnp.stack([x, y]), lookup.depth, lookup.depth_per_texel, lookup.inside)
            return nearest_tap(padded, moved, compare)

        reach = self.max_radius
        columns = range(-reach, reach + 1)

        def add_row(j: Array, total: Visibility) -> Visibility:
            y = jnp.asarray(j, total.dtype)
            row = sum(self._share(lookup.texel[..., 0], i) * tap(jnp.asarray(i, total.dtype), y) for i in columns)
            return total + self._share(lookup.texel[..., 1], y) * row

        return jax.lax.fori_loop(-reach, reach + 1, add_row, jnp.zeros_like(lookup.depth))

    def _share(self, position: Float[Array, "h w"], offset: Array | int) -> Float[Array, "h w"]:
        """Share of the box's width that lies in the texel `offset` away from the one `position` is in."""
        radius = jnp.clip(self.radius, _LEAST_RADIUS, self.max_radius)
        # Measured from the position's own texel, so that shares add up to 1 however far away that is.
        within = position - jnp.floor(position)
        overlap = jnp.minimum(within + radius, offset + 1) - jnp.maximum(within - radius, offset)
        return jnp.maximum(overlap, 0) / (2 * radius)
