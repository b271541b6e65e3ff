"""The sunflower spiral (Vogel, "A Better Way to Construct the Sunflower Head", Mathematical Biosciences 44, 1979)."""

import numpy as np

from ...settings.patterns import Vogel as Settings
from ._disk import on_rays
from ._pattern import Pattern, check_counts, pattern_of

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""In radians: the smaller part of a full turn divided by the golden ratio."""


def vogel(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Points along a spiral, evenly spread for any number of them.

    Point i of n lies at radius √((i + ½) / n) and angle i · 2.39996 + φ, with a random φ for each pixel of a tile. By
    default the tile is one pixel, and interleaved gradient noise rotates the set.

    **Arguments:**

    - `samples`: points of each set.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.

    **Raises** `ValueError` if a number is out of its range.
    """
    check_counts(samples, pattern_size)
    i = np.arange(samples)
    turn = 2 * np.pi * np.random.default_rng(seed).random((pattern_size, pattern_size, 1))
    radius = np.broadcast_to(np.sqrt((i + 0.5) / samples), (pattern_size, pattern_size, samples))
    return pattern_of(on_rays(radius, i * GOLDEN_ANGLE + turn), rotated)
