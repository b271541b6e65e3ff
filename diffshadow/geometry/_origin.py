"""The origin of a scene: the world point that its coordinates are relative to.

Single precision has seven digits. In a scene far from the world's origin, such as a city in national grid coordinates,
the distance uses all of them, and none is left for the shadows. Such a scene has its own origin. It is subtracted once
from all meshes, cameras and lights, in double precision.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._types import HostArray

Origin = tuple[float, float, float]
"""A world point that coordinates are relative to, in world units."""

WORLD: Origin = (0.0, 0.0, 0.0)
"""The world's own origin."""

# A scene within this many of its sizes from the world's origin uses the world's origin. Rounding is then at most a
# millionth of its size.
_NEAR = 16.0
# Coordinate steps larger than this fraction of an extent are visible in its shadows.
_COARSE = 2e-4


class PrecisionWarning(UserWarning):
    """Coordinates are too far from the origin for single precision."""


def origin_of(points: Any) -> Origin:
    """The origin for the coordinates of `points`.

    **Arguments:**

    - `points`: (n, 3), world units, in NumPy and in double precision: the vertices of all meshes of a scene.

    **Returns:** (0, 0, 0), unless the points are farther than 16 of their sizes from there. Otherwise the centre of
    their box, rounded to whole steps that are powers of two and at least as large as the box, so that round numbers
    stay round.
    """
    points = np.asarray(points, np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, float((high - low).max())
    if not np.abs(middle).max() > _NEAR * size:
        return WORLD
    step = 2.0 ** np.ceil(np.log2(max(size, np.finfo(np.float32).tiny)))
    x, y, z = (np.round(middle / step) * step + 0.0).tolist()
    return x, y, z


def step_of(low: HostArray, high: HostArray) -> float:
    """The step between coordinates in single precision, in world units, at the farther corner of the box from `low` to
    `high` (3,). It is 0 if the step is small compared with the box, or if the box is a point."""
    size = float((high - low).max())
    step = float(np.spacing(np.float32(max(np.abs(low).max(), np.abs(high).max()))))
    return step if step > _COARSE * size > 0 else 0.0


def as_origin(given: Sequence[float | int]) -> Origin:
    """**Raises** `ValueError` unless `given` is three finite numbers."""
    values = np.asarray(given, np.float64)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"the scene's origin is {given!r}; expected three finite world coordinates x, y and z")
    x, y, z = values.tolist()
    return x, y, z
