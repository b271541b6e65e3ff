"""Maps the unit square to the unit disk."""

import numpy as np

from ..._checks import check_value
from ..._types import HostArray
from ...settings.patterns import DiskMapping


def to_disk(points: HostArray, mapping: DiskMapping) -> HostArray:
    """Maps points (..., 2) of the unit square to the unit disk.

    - `"polar"`: (u, v) goes to radius √v and angle 2πu.
    - `"concentric"`: squares around the centre become circles (Shirley & Chiu, "A Low Distortion Map Between Disk and
        Square", Journal of Graphics Tools 2(3), 1997).

    **Raises** `ValueError` if `mapping` is unknown.
    """
    check_value("the mapping to the disk", mapping, DiskMapping)
    if mapping == "polar":
        return on_rays(np.sqrt(points[..., 1]), 2 * np.pi * points[..., 0])
    a, b = 2 * points[..., 0] - 1, 2 * points[..., 1] - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    # Avoids 0 / 0 at the centre, where the angle does not matter.
    ratio = np.where(wide, b, a) / np.where(radius == 0, 1, radius)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    return on_rays(radius, angle)


def on_rays(radius: HostArray, angle: HostArray) -> HostArray:
    """Points (..., 2) at these polar coordinates."""
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
