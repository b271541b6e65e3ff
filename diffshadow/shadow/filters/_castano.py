"""Castaño's kernels (Castaño, "Shadow Mapping Summary, Part 1", The Witness, 2013)."""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._types import Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import AbstractRow, Footprint, Span, sum_over_rows
from ._abstract import AbstractFilter

CASTANO_KERNELS: dict[int, tuple[int, ...]] = {3: (1, 2, 1), 5: (1, 3, 4, 3, 1), 7: (1, 5, 12, 16, 12, 5, 1)}
"""Weights along each axis, by size, of the bilinear compares one texel apart that the taps are equivalent to."""


class Castano(AbstractFilter):
    """A bell-shaped kernel of fixed width: `size` by `size` bilinear compares one texel apart, weighted by
    `CASTANO_KERNELS` along both axes.

    On a GPU, 4, 9 or 16 bilinear look-ups placed between texels give the same result. It has no radius to fit; `Tent`
    has one.

    - `size`: 3, 5 or 7.

    **Raises** `ValueError` for any other size.
    """

    size: Literal[3, 5, 7] = eqx.field(static=True, default=5)

    def __check_init__(self):
        if self.size not in CASTANO_KERNELS:
            raise ValueError(f"Castaño's kernel has size {self.size}; expected 3, 5 or 7")

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return sum_over_rows(_Row(self.size), shadow_map, compare, lookup)


class _Row(AbstractRow):
    """One row of texels, numbered from the lowest.

    A position between two texel centres, a fraction s of the way to the right one, has the weights (1 - s) k + s k',
    where k' is the kernel k shifted by one texel.
    """

    size: int = eqx.field(static=True)

    @property
    def texels(self) -> int:
        """Texels that the kernel reads along a side."""
        return self.size + 1

    def footprint(self, lookup: Lookup, step: Int[Array, "*n"]) -> Footprint:
        column, right = self._first(lookup.x)
        row, above = self._first(lookup.y)
        k = CASTANO_KERNELS[self.size]
        kernel = jnp.array([0, *k, 0], lookup.x.dtype) / sum(k)
        span = lambda s, i: Span((1 - s) * kernel[i + 1] + s * kernel[i])
        return Footprint(column, row, [span(right, i) for i in range(self.texels)], [span(above, step)], step)

    def reach(self, lookup: Lookup, steps: Any) -> Float[Array, "..."]:
        return jnp.asarray(self.size / 2 + 0.5)

    def _first(self, position: Float[Array, "*n"]) -> tuple[Array, Array]:
        """The first texel along one axis, and the fraction of a texel that the kernel is shifted by."""
        own = jnp.floor(position - 0.5)
        return own - self.size // 2, position - 0.5 - own
