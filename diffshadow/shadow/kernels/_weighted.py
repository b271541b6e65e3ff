"""Kernels with given weights: bilinear compares one texel apart."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._lookup import Lookup
from ._kernel import AbstractRow, Footprint, Span


class WeightedRow(AbstractRow):
    """One row of the texels under a square of bilinear compares one texel apart, numbered from the lowest.

    At a position between two texel centres, at the fraction s towards the right one, the weights are (1 - s) k + s k'.
    Here k' is the kernel k, shifted by one texel.

    - `weights`: weights of the compare at the centre, and of the compares 1, 2, ... texels from it along each axis.
      Weights of an averaging kernel sum to 1 if all except the first are counted twice.
    """

    weights: tuple[Float[Array, "..."], ...]

    @property
    def texels(self) -> int:
        """Texels per side that the kernel reads."""
        return 2 * len(self.weights)

    def footprint(self, lookup: Lookup, step: Int[Array, "*n"]) -> Footprint:
        column, right = self._first(lookup.x)
        row, above = self._first(lookup.y)
        return Footprint(
            column, row, [self._span(right, i) for i in range(self.texels)], [self._span(above, step)], step
        )

    def reach(self, lookup: Lookup, steps: Any) -> Float[Array, "..."]:
        return jnp.asarray(float(len(self.weights)))

    def _first(self, position: Float[Array, "*n"]) -> tuple[Array, Array]:
        """The first texel along one axis, and the fraction of a texel that the kernel is shifted by."""
        own = jnp.floor(position - 0.5)
        return own - (len(self.weights) - 1), position - 0.5 - own

    def _span(self, shift: Float[Array, "*n"], number: Array | int) -> Span:
        from_middle = number - (len(self.weights) - 1)
        return Span((1 - shift) * self._weight(from_middle) + shift * self._weight(from_middle - 1))

    def _weight(self, from_middle: Array | int) -> Array | float:
        """The weight of the compare at this distance from the centre, in texels; 0 beyond the kernel."""
        if isinstance(from_middle, int):
            return self.weights[abs(from_middle)] if abs(from_middle) < len(self.weights) else 0.0
        at = jnp.abs(from_middle)
        return sum((jnp.where(at == i, weight, 0) for i, weight in enumerate(self.weights)), start=jnp.zeros(()))
