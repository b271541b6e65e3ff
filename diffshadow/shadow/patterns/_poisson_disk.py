"""Poisson-disk points, with a minimum distance (Cook, "Stochastic Sampling in Computer Graphics", 1986)."""

import numpy as np
from scipy.spatial import KDTree

from ..._types import HostArray
from ...settings.patterns import Pattern as Settings
from ._pattern import Pattern, check_counts, pattern_of

# Squared minimum distance, as a fraction of the area per point. Random dart throwing saturates near 0.7.
_TIGHTNESS = 0.6
_ROUNDS = 30
# Points in the square that sets are cut from: the minimum, and the number per sample, so that the square holds a disk.
_MIN_POINTS, _POINTS_A_SAMPLE = 1024, 4


def poisson_disk(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Random points with a minimum distance between them, another set for each pixel of a tile.

    Darts are thrown at a periodic square, and those too close to an earlier one are dropped. Each set consists of the
    `samples` darts nearest to a random point. Scaled to the unit disk, they are at least about 1.3 / √n apart.

    **Arguments:**

    - `samples`: points of each set.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.

    **Raises** `ValueError` if a number is out of its range.
    """
    check_counts(samples, pattern_size)
    rng = np.random.default_rng(seed)
    darts = _throw_darts(max(_MIN_POINTS, _POINTS_A_SAMPLE * samples), rng)
    centers = rng.random((pattern_size**2, 1, 2))
    distance, nearest = map(np.asarray, KDTree(darts, boxsize=1).query(centers[:, 0], samples + 1))
    aside = darts[nearest[:, :-1]] - centers
    # The disk's rim lies midway between the last point inside and the first one outside.
    radius = distance[:, -2:].mean(axis=1)[:, None, None]
    points = (aside - np.round(aside)) / radius
    return pattern_of(points.reshape(pattern_size, pattern_size, samples, 2), rotated)


def _throw_darts(number: int, rng: np.random.Generator) -> HostArray:
    """About `number` points (n, 2) in the unit square, a minimum distance apart, also across its borders."""
    apart = np.sqrt(_TIGHTNESS / number)
    darts = np.empty((0, 2))
    for _ in range(_ROUNDS):
        thrown = rng.random((number, 2))
        if len(darts):
            thrown = thrown[KDTree(darts, boxsize=1).query(thrown)[0] >= apart]
        close = KDTree(thrown, boxsize=1).query_pairs(apart, output_type="ndarray")
        darts = np.concatenate([darts, np.delete(thrown, close.max(axis=1, initial=0), axis=0)])
    return darts
