"""Sobol's sequence, scrambled."""

import math

import numpy as np

from ..._types import HostArray
from ...settings.patterns import DiskMapping
from ...settings.patterns import Pattern as Settings
from ._disk import to_disk
from ._pattern import Pattern, check_counts, pattern_of

_BITS = 32


def sobol(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
    mapping: DiskMapping = "concentric",
) -> Pattern:
    """The first points of Sobol's sequence in two dimensions, scrambled independently for each pixel of a tile.

    Owen scrambling (Owen, "Randomly Permuted (t, m, s)-Nets and (t, s)-Sequences", 1995) flips each bit of a coordinate
    at random, depending on the bits above it. Each point is uniform, and the set keeps its stratification. It is
    implemented by hashing (Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020). A power of two of samples
    has the lowest discrepancy.

    **Arguments:**

    - `samples`: points of each set.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.
    - `mapping`: `"concentric"` or `"polar"`, from the square to the disk.

    **Raises** `ValueError` if a number is out of its range, or `mapping` is unknown.
    """
    check_counts(samples, pattern_size)
    rng = np.random.default_rng(seed)
    from scipy.stats import qmc  # here, since it takes long to load

    plain = qmc.Sobol(2, scramble=False, bits=_BITS).random_base2(math.ceil(math.log2(samples)))[:samples]
    seeds = rng.integers(1 << _BITS, size=(pattern_size, pattern_size, 1, 2), dtype=np.uint32)
    digits = _owen_scrambled((plain * 2.0**_BITS).astype(np.uint32), seeds)
    # Random bits below the last scrambled one.
    points = (digits + rng.random(digits.shape)) / 2.0**_BITS
    return pattern_of(to_disk(points, mapping), rotated)


def _owen_scrambled(x: HostArray, seed: HostArray) -> HostArray:
    """32-bit fractions `x`; each bit is flipped or not depending on `seed` and the bits above it."""
    x = _reversed_bits(x) + seed
    # With bits reversed, multiplying by an even number lets a bit affect only the bits above it (Laine & Karras 2011).
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        x = x ^ (x * np.uint32(factor))
    return _reversed_bits(x)


def _reversed_bits(x: HostArray) -> HostArray:
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        shift, mask = np.uint32(shift), np.uint32(mask)
        x = (x >> shift & mask) | ((x & mask) << shift)
    return x
