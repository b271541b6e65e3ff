"""False shadow and false light: acne, leaks and Peter-panning.

A pixel of the reference is *lit* at visibility 1, *dark* at 0 (both to within 1e-6), and in penumbra in between. The
error of a pixel is the fraction of the light that is wrongly removed or added. Counting pixels that are more wrong
than right would miss acne that a filter spreads thinly over many pixels. Errors at a shadow's outline depend on the
map's resolution and are not meant here, so a band along the outline is left out.
"""

import numpy as np
from jaxtyping import Bool
from numpy.typing import ArrayLike
from scipy import ndimage

from .._types import HostArray
from ._inputs import as_images

_NEARLY = 1e-6


def false_shadow_rate(
    visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, band: int = 1
) -> float:
    """Fraction of the mask that is lit in the reference but shadowed in the image (acne).

    **Arguments:**

    - `visibility`, `reference`: (h, w), in [0, 1].
    - `mask`: (h, w), the pixels that count; all of them by default.
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
    """The pixels of `region` that lie more than `band` pixels from the rest of `mask`."""
    if isinstance(band, bool) or not isinstance(band, int | np.integer) or band < 0:
        raise ValueError(f"band is {band!r}; expected a whole number of pixels, 0 or more")
    rest = (mask & ~region).astype(np.uint8)
    return region & (ndimage.maximum_filter(rest, size=2 * int(band) + 1, mode="constant") == 0)
