"""Poisson-disk points, which keep a distance (Cook, "Stochastic Sampling in Computer Graphics", 1986)."""

import numpy as np
from scipy.spatial import KDTree

from ..._types import HostArray
from ._pattern import Pattern, check_counts, pattern_of

# Squared distance, as a share of the area for each point: darts thrown at random stop finding room near 0.7.
_TIGHTNESS = 0.6
_ROUNDS = 30
# Of the square that sets are cut from, at least; and for each point of a set, so that the square holds its disk.
_LEAST_POINTS, _POINTS_A_SAMPLE = 1024, 4


def poisson_disk(samples: int = 32, pattern_size: int = 8, seed: int = 0, rotated: bool = False) -> Pattern:
    """Random points none of which are close to each other, another set for each pixel of a tile.

    Darts are thrown at a square that repeats, and those too close to an earlier one are dropped. Each set is what lies
    in a disk round a point at random, as wide as it takes to hold `samples` of them; scaled to the unit disk, they are
    about 1.3 / √n apart at least.

    **Arguments:**

    - `samples`: points of each set.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.

    **Raises** `ValueError` if there are no samples, or the tile has no pixels.
    """
    check_counts(samples, pattern_size)
    rng = np.random.default_rng(seed)
    darts = _throw_darts(max(_LEAST_POINTS, _POINTS_A_SAMPLE * samples), rng)
    centers = rng.random((pattern_size**2, 1, 2))
    distance, nearest = map(np.asarray, KDTree(darts, boxsize=1).query(centers[:, 0], samples + 1))
    aside = darts[nearest[:, :-1]] - centers
    # The rim lies midway between the last point within and the first one beyond.
    radius = distance[:, -2:].mean(axis=1)[:, None, None]
    points = (aside - np.round(aside)) / radius
    return pattern_of(points.reshape(pattern_size, pattern_size, samples, 2), rotated)


def _throw_darts(number: int, rng: np.random.Generator) -> HostArray:
    """About `number` points (n, 2) of the unit square, a distance apart across its borders as well."""
    apart = np.sqrt(_TIGHTNESS / number)
    darts = np.empty((0, 2))
    for _ in range(_ROUNDS):
        thrown = rng.random((number, 2))
        if len(darts):
            thrown = thrown[KDTree(darts, boxsize=1).query(thrown)[0] >= apart]
        close = KDTree(thrown, boxsize=1).query_pairs(apart, output_type="ndarray")
        darts = np.concatenate([darts, np.delete(thrown, close.max(axis=1, initial=0), axis=0)])
    return darts
