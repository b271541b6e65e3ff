"""Structural similarity."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import ndimage

from .._types import HostArray
from ._inputs import as_images

_WINDOW, _SIGMA = 11, 1.5
# (K L)² with a dynamic range L of 1.
_C1, _C2 = 0.01**2, 0.03**2


def ssim(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Mean structural similarity (SSIM) over the mask: at most 1, and 1 for equal images.

    Each Gaussian window covers only pixels in the mask, with its weights rescaled to sum to 1. Pixels outside the mask
    and the image's border therefore have no effect.

    **Arguments:**

    - `visibility`, `reference`: (h, w), in [0, 1].
    - `mask`: (h, w), the pixels that count; all of them by default.

    **Raises** `ValueError` if shapes differ, the mask is empty, or a value in it is not finite.

    Wang, Bovik, Sheikh and Simoncelli, "Image quality assessment: from error visibility to structural similarity", IEEE
    Transactions on Image Processing 13(4), 2004, equation 13, with its 11 × 11 window of standard deviation 1.5 pixels.
    """
    image, truth, inside = as_images(visibility, reference, mask)
    x, y = np.where(inside, image, 0), np.where(inside, truth, 0)
    weight = _blur(inside.astype(np.float64))
    average = lambda values: _blur(values) / np.where(inside, weight, 1)
    mean_x, mean_y = average(x), average(y)
    variance_x = average(x * x) - mean_x**2
    variance_y = average(y * y) - mean_y**2
    covariance = average(x * y) - mean_x * mean_y
    similarity = ((2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)) / (
        (mean_x**2 + mean_y**2 + _C1) * (variance_x + variance_y + _C2)
    )
    return float(np.mean(similarity[inside]))


def _blur(values: Float64[HostArray, "h w"]) -> Float64[HostArray, "h w"]:
    """The Gaussian-weighted sum round each pixel; values outside the image are zero."""
    offset = np.arange(_WINDOW) - _WINDOW // 2
    kernel = np.exp(-(offset**2) / (2 * _SIGMA**2))
    kernel /= kernel.sum()
    rows = ndimage.correlate1d(values, kernel, axis=0, mode="constant")
    return ndimage.correlate1d(rows, kernel, axis=1, mode="constant")
