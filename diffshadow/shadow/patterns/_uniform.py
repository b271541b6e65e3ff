"""Independent random points: plain Monte Carlo (Cook, Porter & Carpenter 1984)."""

import numpy as np

from ...settings.patterns import Pattern as Settings
from ._disk import to_disk
from ._pattern import Pattern, check_counts, pattern_of


def uniform(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Points that are uniform over the disk and independent of each other, another set for each pixel of a tile.

    The error of their mean falls as n^(-1/2) whatever the occluder. Point (u, v) of the unit square lies at radius √v
    and angle 2πu.

    **Arguments:**

    - `samples`: points of each set.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.

    **Raises** `ValueError` if a number is out of its range.
    """
    check_counts(samples, pattern_size)
    points = np.random.default_rng(seed).random((pattern_size, pattern_size, samples, 2))
    return pattern_of(to_disk(points, "polar"), rotated)
