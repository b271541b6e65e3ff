"""Halton's sequence, scrambled."""

import numpy as np

from ...settings.patterns import DiskMapping
from ...settings.patterns import Pattern as Settings
from ._disk import to_disk
from ._pattern import Pattern, check_counts, pattern_of


def halton(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
    mapping: DiskMapping = "concentric",
) -> Pattern:
    """The first points of Halton's sequence in bases 2 and 3, scrambled independently for each pixel of a tile.

    Digits are permuted at random (Owen, "A Randomized Halton Algorithm in R", 2017). Each point is uniform, and the set
    has low discrepancy for any number of samples.

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

    sets = [qmc.Halton(2, scramble=True, rng=rng).random(samples) for _ in range(pattern_size**2)]
    points = np.reshape(sets, (pattern_size, pattern_size, samples, 2))
    return pattern_of(to_disk(points, mapping), rotated)
