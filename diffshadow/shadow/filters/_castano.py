"""Castaño's kernels (Castaño, "Shadow Mapping Summary, Part 1", The Witness, 2013)."""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._padded_map import PaddedMap, pad
from .._taps import Sites, bilinear_tap, sites_of, sum_of_parts
from ._abstract import AbstractFilter

CASTANO_KERNELS: dict[int, tuple[int, ...]] = {3: (1, 2, 1), 5: (1, 3, 4, 3, 1), 7: (1, 5, 12, 16, 12, 5, 1)}
"""The weights of bilinear compares one texel apart, along each axis, that the taps of each size add up to."""


class Castano(AbstractFilter):
    """A bell-shaped kernel of fixed width from a few bilinear compares, each of which weighs two by two texels at once.

    It equals `size` by `size` bilinear compares one texel apart, weighed by `CASTANO_KERNELS` along both axes, but
    takes 4, 9 or 16 of them, placed between texels such that they add up to the same. It has no radius to fit: `Tent`
    does.

    - `size`: 3, 5 or 7.

    **Raises** `ValueError` for any other size.
    """

    size: Literal[3, 5, 7] = eqx.field(static=True, default=5)

    def __check_init__(self):
        if self.size not in CASTANO_KERNELS:
            raise ValueError(f"Castaño's kernel has size {self.size}; expected 3, 5 or 7")

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        row = _Row(self.size)
        return sum_of_parts(
            row, pad(shadow_map), compare, sites_of(lookup), jnp.eye(row.taps, dtype=lookup.depth.dtype)
        )


class _Row(eqx.Module):
    """One row of taps, chosen by 1 among zeros."""

    size: int = eqx.field(static=True)

    @property
    def taps(self) -> int:
        """Taps along a side."""
        return self.size // 2 + 1

    @property
    def cost(self) -> float:
        return 4.0 * self.taps

    def __call__(
        self, padded: PaddedMap, compare: AbstractCompare, sites: Sites, chosen: Float[Array, " k"]
    ) -> Float[Array, "*n"]:
        columns, rows = self._along(sites.x), self._along(sites.y)
        # Every row runs the same program, so that a loop can take them; its choice must be cheap to differentiate.
        zero = jnp.zeros_like(sites.x)
        choose = lambda of_rows: sum((chosen[k] * of for k, of in enumerate(of_rows)), start=zero)
        y, weight = (choose(of_rows) for of_rows in zip(*rows, strict=True))
        taps = (column * bilinear_tap(padded, compare, sites, x, y) for x, column in columns)
        return weight * sum(taps, start=zero)

    def reach(self, sites: Sites, steps: Any) -> Float[Array, "..."]:
        return jnp.asarray(self.size / 2 + 0.5)

    def _along(self, position: Float[Array, "*n"]) -> list[tuple[Array, Array]]:
        """Where the taps lie along one axis, and what they count.

        With s the share of the texel to the right of a position between two texels' centres, a kernel k slides as
        (1 - s) k + s k', where k' is k one texel on. Neighbours a and b of these make one tap: it counts a + b and
        lies b / (a + b) of the way from one to the other.
        """
        centre = jnp.floor(position - 0.5) + 0.5
        s = position - centre
        k = CASTANO_KERNELS[self.size]
        sliding = [(1 - s) * here + s * before for here, before in zip((*k, 0), (0, *k), strict=True)]
        pairs = zip(sliding[::2], sliding[1::2], strict=True)
        return [(centre + (2 * i - self.size // 2 + b / (a + b)), (a + b) / sum(k)) for i, (a, b) in enumerate(pairs)]
