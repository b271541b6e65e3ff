"""Differences of two visibility images, pixel by pixel."""

import math

import numpy as np
from numpy.typing import ArrayLike

from ._inputs import as_images


def mae(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Mean absolute difference over the mask, in visibility, [0, 1].

    **Arguments:**

    - `visibility`, `reference`: (h, w), in [0, 1].
    - `mask`: (h, w), the pixels that count; all if left out.

    **Raises** `ValueError` if shapes differ, the mask is empty, or a value in it is not finite.
    """
    image, truth, inside = as_images(visibility, reference, mask)
    return float(np.mean(np.abs(image - truth)[inside]))


def rmse(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Root of the mean squared difference over the mask, in visibility, [0, 1]. Arguments and errors as for `mae`."""
    image, truth, inside = as_images(visibility, reference, mask)
    return float(np.sqrt(np.mean((image - truth)[inside] ** 2)))


def psnr(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Peak signal-to-noise ratio, `-20 log10(rmse)` in decibels, the peak being 1; infinite for equal images.

    Arguments and errors as for `mae`.
    """
    error = rmse(visibility, reference, mask)
    return math.inf if error == 0 else -20 * math.log10(error)
