"""Figures of aliasing."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from ._inputs import check_on_host


@dataclasses.dataclass(frozen=True)
class AliasingFigures:
    """Figures of the size of a shadow map's texels on the screen.

    - `worst`: the greatest extent, in pixels; `percentile_99`: the extent that 1 % of the pixels exceed.
    - `mean_log2`: the mean of the extents' logarithms to base 2; 0 if texels are as large as pixels on average.
    - `undersampled`: the fraction of the pixels whose texel is larger than a pixel.
    """

    worst: float
    percentile_99: float
    mean_log2: float
    undersampled: float

    def as_dict(self) -> dict[str, float]:
        """The fields by name, in order."""
        return dataclasses.asdict(self)


def measure_aliasing(extent: ArrayLike, mask: ArrayLike) -> AliasingFigures:
    """Figures of the extents of texels on the screen, (h, w), in pixels, over `mask` (h, w).

    `extent` may be `shadow.Aliasing.extent`, or `perspective_extent` for the part due to perspective.

    **Raises** `ValueError` if shapes differ, the mask is empty, or an extent in it is negative or not finite.
    """
    check_on_host(extent, mask)
    extents, inside = np.asarray(extent, dtype=np.float64), np.asarray(mask)
    if extents.shape != inside.shape or inside.dtype != bool:
        raise ValueError(
            f"the extent has shape {extents.shape}, and the mask has shape {inside.shape} and type {inside.dtype}; "
            "expected booleans of the same shape"
        )
    if not inside.any():
        raise ValueError("the mask has no pixels; expected a surface that lies in the map and faces the light")
    values = extents[inside]
    if not (np.isfinite(values) & (values >= 0)).all():
        raise ValueError("some extents are negative, NaN or infinite; expected pixels, 0 or more")
    # A texel seen exactly edge-on has the extent 0, which has no logarithm.
    logarithms = np.log2(np.maximum(values, np.finfo(np.float32).tiny))
    return AliasingFigures(
        worst=float(values.max()),
        percentile_99=float(np.percentile(values, 99)),
        mean_log2=float(logarithms.mean()),
        undersampled=float((values > 1).mean()),
    )
