"""Random disk sampling (Uralsky, "Efficient Soft-Edged Shadows Using Pixel Shader Branching", GPU Gems 2, ch. 17)."""

import math
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._misc import as_float, concrete
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._map import ShadowMap
from .._receiver import Lookup
from .._taps import TapMode, mean_of_taps
from ._abstract import AbstractFilter

EARLY_SAMPLES = 8
"""How many samples, the outermost, decide the early-out."""


def offset_table(pattern_size: int, samples: tuple[int, int], seed: int) -> Float[Array, "p p n 2"]:
    """Stratified jittered offsets in the unit disk, another set for each pixel of a square pattern.

    **Arguments:**

    - `pattern_size`: pixels on a side of the pattern.
    - `samples`: (angles, rings), the strata of each set.

    **Returns:** (pattern_size, pattern_size, angles · rings, 2). Sample (u, v) of the jittered unit square lies at
    radius √v and angle 2πu; samples run from the outer ring inwards.
    """
    angles, rings = samples
    jitter = np.random.default_rng(seed).random((pattern_size, pattern_size, rings, angles, 2))
    u = (np.arange(angles) + jitter[..., 0]) / angles
    v = (np.arange(rings)[::-1, None] + jitter[..., 1]) / rings
    offsets = np.sqrt(v)[..., None] * np.stack([np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)], axis=-1)
    return as_float(offsets.reshape(pattern_size, pattern_size, angles * rings, 2))


class RandomDisk(AbstractFilter):
    """The mean of taps at random offsets in a disk, which differ from pixel to pixel.

    - `radius`: of the disk, in texels.
    - `offsets`: (p, p, n, 2), the offset table; a pixel uses the set at its coordinates modulo p.
    - `lookup`: `"bilinear"` or `"nearest"` taps. Nearest ones give `radius` no gradient.
    - `early_out`: whether the first 8 samples, which are the outermost, decide alone where they agree.

    **Raises** `ValueError` if `radius` is negative, there are no samples, or `lookup` is unknown.
    """

    radius: Scalar
    offsets: Float[Array, "p p n 2"]
    lookup: TapMode = eqx.field(static=True)
    early_out: bool = eqx.field(static=True)

    def __init__(
        self,
        radius: float | Scalar = 2.0,
        samples: tuple[int, int] = (4, 8),
        pattern_size: int = 8,
        lookup: TapMode = "bilinear",
        early_out: bool = False,
        seed: int = 0,
    ):
        if min(samples) < 1 or pattern_size < 1:
            raise ValueError(
                f"the random disk has samples {samples} and pattern_size {pattern_size}; expected each to be 1 or more"
            )
        self.radius = as_float(radius)
        self.offsets = offset_table(pattern_size, samples, seed)
        self.lookup = lookup
        self.early_out = early_out

    def __check_init__(self):
        if self.lookup not in ("bilinear", "nearest"):
            raise ValueError(f'the random disk\'s lookup is {self.lookup!r}; expected "bilinear" or "nearest"')
        radius = concrete(self.radius)
        if radius is not None and not (radius >= 0 and math.isfinite(radius)):
            raise ValueError(f"the random disk's radius is {radius}; expected 0 or more texels")

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        offsets = jnp.moveaxis(self.offsets, 2, 0)
        spread = partial(_spread, shape=lookup.depth.shape)
        mean = lambda chosen: mean_of_taps(shadow_map, lookup, compare, self.radius, chosen, self.lookup, spread)
        if not self.early_out or offsets.shape[0] <= EARLY_SAMPLES:
            return mean(offsets)
        outer, inner = mean(offsets[:EARLY_SAMPLES]), mean(offsets[EARLY_SAMPLES:])
        share = EARLY_SAMPLES / offsets.shape[0]
        agree = (outer == 0) | (outer == 1)
        return jnp.where(agree, outer, share * outer + (1 - share) * inner)


def _spread(pattern: Float[Array, "p p"], shape: tuple[int, ...]) -> Float[Array, "h w"]:
    """The pattern repeated over an image of `shape`."""
    size = pattern.shape[0]
    height, width = shape
    repeats = (math.ceil(height / size), math.ceil(width / size))
    return jnp.tile(pattern, repeats)[:height, :width]
