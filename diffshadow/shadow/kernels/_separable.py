"""Separable kernels of any radius: box, tent and Gaussian.

A texel's weight is the integral of the kernel over it, so the kernel moves and grows smoothly. Integrals are for radius
1, like pbrt's filters (Pharr, Jakob & Humphreys, "Physically Based Rendering", section 8.8).
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...settings.filters import Shape
from .._lookup import Lookup
from ._kernel import AbstractSizedRow, Footprint, Span

# The cut-off of the Gaussian in standard deviations.
_DEVIATIONS = 3.0
_WITHIN_DEVIATIONS = math.erf(_DEVIATIONS / math.sqrt(2))
MIN_RADIUS = 1e-3
"""In texels: smaller radii are clamped to this."""

INTEGRALS: dict[Shape, Callable[[Array], Array]] = {
    "box": lambda u: u / 2,
    "tent": lambda u: u - u * jnp.abs(u) / 2,
    "gaussian": lambda u: lax.erf(u * (_DEVIATIONS / math.sqrt(2))) / (2 * _WITHIN_DEVIATIONS),
}
"""Integrals of the kernels of radius 1 from 0 to u, for u in [-1, 1]."""


def weight_between(
    shape: Shape, radius: Float[Array, "..."], low: Float[Array, "*n"], high: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """The weight, in [0, 1], of the interval from `low` to `high` under a kernel of this `radius` around 0.

    Weights of intervals that cover the kernel sum to 1, so their derivatives sum to 0. If a side of an interval is at
    the kernel's end, derivatives are those of a smaller radius.
    """
    radius = jnp.maximum(radius, MIN_RADIUS)

    def until(x: Array) -> Array:
        u = x / radius
        # Not a clip, which halves derivatives at its bounds.
        return INTEGRALS[shape](jnp.where(u < 1, jnp.where(u > -1, u, -1), 1))

    # Rounding must not make a weight negative: blurred exponentials would become negative.
    return jnp.maximum(until(high) - until(low), 0)


class SeparableRow(AbstractSizedRow):
    """One row of the texels under a kernel of this `shape`, numbered from the lowest that the largest radius covers."""

    shape: Shape = eqx.field(static=True)

    def footprint(self, lookup: Lookup, step: Int[Array, "*n"]) -> Footprint:
        column, left = self._first(lookup.x)
        row, below = self._first(lookup.y)
        span = lambda first, i: Span(weight_between(self.shape, self.radius, first + i, first + (i + 1)))
        return Footprint(column, row, [span(left, i) for i in range(self.texels)], [span(below, step)], step)

    def _first(self, position: Float[Array, "*n"]) -> tuple[Array, Array]:
        """The first texel along one axis, and its start relative to `position`."""
        own = jnp.floor(position)
        # Relative to the position's own texel, so that weights sum to 1 at any distance from the origin.
        within = position - own
        first = jnp.floor(within - self.max_radius)
        return own + first, first - within
