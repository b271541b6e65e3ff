"""Per-pixel differences of two visibility images."""

import math

import numpy as np
from numpy.typing import ArrayLike

from ._inputs import as_images


def mae(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Mean absolute difference over the mask, in [0, 1].

    **Arguments:**

    - `visibility`, `reference`: (h, w), in [0, 1].
    - `mask`: (h, w), the pixels that count; all of them by default.

    **Raises** `ValueError` if shapes differ, the mask is empty, or a value in it is not finite.
    """
    image, truth, inside = as_images(visibility, reference, mask)
    return float(np.mean(np.abs(image - truth)[inside]))


def rmse(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Root mean square difference over the mask, in [0, 1]. Arguments and errors are as for `mae`.

    !!! Example

        ```python
        metrics.rmse(visibility, truth.visibility, truth.mask) < 0.3  # True
        ```
    """
    image, truth, inside = as_images(visibility, reference, mask)
    return float(np.sqrt(np.mean((image - truth)[inside] ** 2)))


def psnr(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Peak signal-to-noise ratio in decibels, `-20 log10(rmse)` for a peak of 1; infinite for equal images.

    Arguments and errors are as for `mae`.
    """
    error = rmse(visibility, reference, mask)
    return math.inf if error == 0 else -20 * math.log10(error)
