"""Stratified jittered points (Uralsky, "Efficient Soft-Edged Shadows Using Pixel Shader Branching", GPU Gems 2)."""

import math

import numpy as np

from ..._arithmetic import as_float
from ...settings.patterns import Pattern as Settings
from ._disk import to_disk
from ._pattern import EARLY_SAMPLES, Pattern, check_counts, outer_first


def stratified(
    samples: int | tuple[int, int] = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Stratified jittered points, another set for each pixel of a tile. With 4 by 8 strata it is the classic offset
    table.

    **Arguments:**

    - `samples`: (angles, rings), the strata of each set. Or the number of strata: the grid is then as square as
        possible, and its outer rings have one more stratum if the number does not divide evenly.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.

    **Returns:** a pattern with one point per stratum, from the outer ring inwards. Strata have equal areas. If rings
    have more than 8 strata, the outermost point of each octant comes first. Point (u, v) of the jittered unit square
    lies at radius √v and angle 2πu.

    **Raises** `ValueError` if a number is out of its range.
    """
    check_counts(samples, pattern_size)
    angles = _angles_of_rings(samples)
    count, ring = int(angles.sum()), np.repeat(np.arange(angles.size), angles)
    # Rings are numbered inwards; the width of a ring in v is proportional to its number of strata.
    inner = 1 - np.cumsum(angles) / count
    sector = np.arange(count) - np.repeat(np.cumsum(angles) - angles, angles)
    jitter = np.random.default_rng(seed).random((pattern_size, pattern_size, count, 2))
    u = (sector + jitter[..., 0]) / angles[ring]
    v = np.maximum(inner[ring], 0) + jitter[..., 1] * angles[ring] / count
    points = to_disk(np.stack([u, v], axis=-1), "polar")
    if angles[0] > EARLY_SAMPLES:
        # Otherwise the first samples would all lie on one side of the ring.
        points = outer_first(points)
    return Pattern(as_float(np.moveaxis(points, 2, 0)), rotated)


def _angles_of_rings(samples: int | tuple[int, int]) -> np.ndarray:
    """Strata of each ring, from the outer one inwards."""
    if not isinstance(samples, int):
        angles, rings = samples
        return np.full(rings, angles)
    rings = max(1, math.isqrt(samples))
    return samples // rings + (np.arange(rings) < samples % rings)
