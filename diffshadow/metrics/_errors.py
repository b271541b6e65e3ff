"""Errors of a visibility image against its reference.

False shadow is acne; false light is leaks and Peter-panning. A pixel of the reference is *lit* at visibility 1, *dark*
at 0 (both to within 1e-6), and in penumbra in between. The error of a pixel is the fraction of the light that is
wrongly removed or added. A count of pixels that are more wrong than right would miss acne that a filter spreads thinly
over many pixels. Errors at a shadow's outline depend on the map's resolution and are excluded, so a band along the
outline is left out.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike
from scipy import ndimage

from .._types import HostArray
from ._inputs import as_images

_NEARLY = 1e-6
_WINDOW, _SIGMA = 11, 1.5
# (K L)² with a dynamic range L of 1.
_C1, _C2 = 0.01**2, 0.03**2


@dataclasses.dataclass(frozen=True)
class ShadowErrors:
    """The errors of a visibility image against its reference; each field is named after its metric function."""

    rmse: float
    mae: float
    ssim: float
    false_shadow_rate: float
    false_light_rate: float

    def as_dict(self) -> dict[str, float]:
        """The fields by name, in order."""
        return dataclasses.asdict(self)


def measure_errors(
    visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, band: int = 1
) -> ShadowErrors:
    """All errors of `visibility` (h, w) against `reference` (h, w) over `mask` (h, w).

    `band` is the width in pixels of the band along shadow outlines that the two rates leave out.

    **Raises** `ValueError` if shapes differ, the mask is empty, a value in it is not finite, or `band` is negative.

    !!! Example

        ```python
        errors = metrics.measure_errors(visibility, truth.visibility, truth.mask)
        errors.rmse, errors.false_shadow_rate, errors.false_light_rate  # all from 0 to 1
        ```
    """
    return ShadowErrors(
        rmse=rmse(visibility, reference, mask),
        mae=mae(visibility, reference, mask),
        ssim=ssim(visibility, reference, mask),
        false_shadow_rate=false_shadow_rate(visibility, reference, mask, band),
        false_light_rate=false_light_rate(visibility, reference, mask, band),
    )


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


def ssim(visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Mean structural similarity (SSIM) over the mask: at most 1, and 1 for equal images.

    Each Gaussian window covers only pixels in the mask, with its weights rescaled to sum to 1. Pixels outside the mask
    and the image's border therefore have no effect. Arguments and errors are as for `mae`.

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
    """The Gaussian-weighted sum around each pixel. Values outside the image are zero."""
    offset = np.arange(_WINDOW) - _WINDOW // 2
    kernel = np.exp(-(offset**2) / (2 * _SIGMA**2))
    kernel /= kernel.sum()
    rows = ndimage.correlate1d(values, kernel, axis=0, mode="constant")
    return ndimage.correlate1d(rows, kernel, axis=1, mode="constant")


def false_shadow_rate(
    visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, band: int = 1
) -> float:
    """Fraction of the mask that is lit in the reference but shadowed in the image (acne).

    **Arguments:**

    - `visibility`, `reference`, `mask`: as for `mae`.
    - `band`: a lit pixel counts only if all mask pixels in the square of `band` pixels to each side are lit too;
        0 counts every lit pixel.

    **Returns:** the missing light in pixels (visibility 0.9 at a lit pixel counts 0.1), divided by the number of pixels
    in the mask, including the band; in [0, 1].

    **Raises** `ValueError` if shapes differ, the mask is empty, a value in it is not finite, or `band` is negative.
    """
    image, truth, inside = as_images(visibility, reference, mask)
    lit = _interior(inside & (truth >= 1 - _NEARLY), inside, band)
    return float(np.sum(np.where(lit, 1 - image, 0)) / np.sum(inside))


def false_light_rate(
    visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, band: int = 1
) -> float:
    """Fraction of the mask that is dark in the reference but lit in the image (leaks, Peter-panning).

    Arguments, result and errors are as for `false_shadow_rate`, with dark in place of lit.
    """
    image, truth, inside = as_images(visibility, reference, mask)
    dark = _interior(inside & (truth <= _NEARLY), inside, band)
    return float(np.sum(np.where(dark, image, 0)) / np.sum(inside))


def _interior(region: Bool[HostArray, "h w"], mask: Bool[HostArray, "h w"], band: int) -> Bool[HostArray, "h w"]:
    """The pixels of `region` that are more than `band` pixels from the rest of `mask`."""
    if isinstance(band, bool) or not isinstance(band, int | np.integer) or band < 0:
        raise ValueError(f"band is {band!r}; expected a whole number of pixels, 0 or more")
    rest = (mask & ~region).astype(np.uint8)
    return region & (ndimage.maximum_filter(rest, size=2 * int(band) + 1, mode="constant") == 0)
