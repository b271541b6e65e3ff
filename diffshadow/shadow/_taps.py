"""Taps: look-ups in a shadow map at single points."""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._types import Mask, Visibility
from ._compare import AbstractCompare
from ._kernel import AbstractKernel, Footprint, Sites, Span, sites_of
from ._lookup import Lookup
from ._map import ShadowMap
from ._padded_map import pad
from ._sum import Blocks, sum_over
from .patterns import Pattern, interleaved_gradient_noise

TapMode = Literal["nearest", "bilinear"]

# Half the width of a square that stands for a point, in texels.
_POINT = 1 / 512


class Tap(AbstractKernel):
    """A tap at `radius · offset`, a step's (x, y).

    A nearest tap compares with the texel that it falls into: its gradient does not see the position. Where a caster
    ends in the texel, it is the side that the tap lies on that counts. A bilinear tap compares with the four texels
    round it, and blends the four results (never the depths).
    """

    mode: TapMode = eqx.field(static=True)

    @property
    def cost(self) -> float:
        return {"nearest": 1.0, "bilinear": 4.0}[self.mode]

    def footprint(self, sites: Sites, step: tuple[Array, Array]) -> Footprint:
        x, y = step
        if sites.turn is not None:
            cosine, sine = sites.turn
            x, y = cosine * x - sine * y, sine * x + cosine * y
        x, y = sites.x + sites.radius * x, sites.y + sites.radius * y
        if self.mode == "nearest":
            column, row = jnp.floor(x), jnp.floor(y)
            at = lambda p: [Span(1.0, jnp.clip(p - _POINT, -0.5, 0.5), jnp.clip(p + _POINT, -0.5, 0.5))]
            return Footprint(column, row, at(x - column - 0.5), at(y - row - 0.5))
        u, v = x - 0.5, y - 0.5
        column, row = jnp.floor(u), jnp.floor(v)
        along = lambda share: [Span(1 - share, -0.5 + share, 0.5), Span(share, -0.5, share - 0.5)]
        return Footprint(column, row, along(u - column), along(v - row))

    def reach(self, sites: Sites, steps: Any) -> Float[Array, "..."]:
        x, y = steps
        farthest = jnp.sqrt(jnp.max(x * x + y * y))
        return sites.radius * farthest + (0.5 if self.mode == "bilinear" else 0.0)


def single_tap(shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare, mode: TapMode) -> Visibility:
    """One compare a receiver."""
    here = np.zeros(1, lookup.depth.dtype)
    return sum_over(Tap(mode), pad(shadow_map), compare, sites_of(lookup), (here, here))


def mean_of_taps(
    shadow_map: ShadowMap,
    lookup: Lookup,
    compare: AbstractCompare,
    radius: Float[Array, "..."],
    pattern: Pattern,
    mode: TapMode,
    wanted: Mask | None = None,
) -> Visibility:
    """The mean of taps at `texel + radius · offset`.

    **Arguments:**

    - `radius`: in texels, a scalar or one for each receiver.
    - `pattern`: the offsets of each receiver, as the pixels of an image.
    - `mode`: `"nearest"` or `"bilinear"` taps; nearest ones give `radius` and position no gradient.
    - `wanted`: the receivers whose mean is wanted, (h, w): others are 0, and most of them cost nothing. All if left
        out.

    Differentiable with respect to all but `pattern`.
    """
    sites = sites_of(lookup, radius)
    if pattern.rotated:
        angle = 2 * jnp.pi * interleaved_gradient_noise(lookup.depth.shape).astype(lookup.depth.dtype)
        sites = eqx.tree_at(lambda s: s.turn, sites, (jnp.cos(angle), jnp.sin(angle)), is_leaf=lambda x: x is None)
    blocks = Blocks.of(lookup.depth.shape, pattern.offsets.shape[1])
    some = None if wanted is None else blocks.cut(wanted)
    total = sum_over(Tap(mode), pad(shadow_map), compare, sites.map(blocks.cut), _offsets(pattern, blocks), some)
    return blocks.join(total) / pattern.samples


def _offsets(pattern: Pattern, blocks: Blocks) -> tuple[Float[Array, "n p 1 q"], Float[Array, "n p 1 q"]]:
    """The pattern's offsets x and y for each pixel of a block."""
    offsets = lax.stop_gradient(pattern.offsets)
    wide = jnp.tile(offsets, (1, 1, blocks.columns // blocks.rows, 1))[:, :, None]
    # Else each tap would cut its own offset out of the pattern, at every pixel.
    return lax.optimization_barrier((wide[..., 0], wide[..., 1]))
