"""Light that is wrongly taken or given: acne, leaks and Peter-panning.

A pixel of the reference is *lit* at visibility 1, *dark* at 0, both to within 1e-6, and in penumbra between. A pixel
of the measured image is wrong by the share of the light that it takes or gives: a filter spreads acne thinly over many
pixels, and none of them may be more dark than lit. Errors at a shadow's outline are another matter, a question of
resolution, so a band along it is left out.
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
    """Share of the mask that the reference lights and the image shadows (acne).

    **Arguments:**

    - `visibility`, `reference`: (h, w), in [0, 1].
    - `mask`: (h, w), the pixels that count; all if left out.
    - `band`: a lit pixel counts only if every pixel of the mask within `band` pixels of it, along rows, columns or
        both, is lit too; 0 counts every lit pixel.

    **Returns:** the wrong light, counted in pixels (visibility 0.9 where all is lit is a tenth of one), over all pixels
    of the mask, the band's included; in [0, 1].

    **Raises** `ValueError` if shapes differ, the mask is empty, a value in it is not finite, or `band` is negative.
    """
    image, truth, inside = as_images(visibility, reference, mask)
    lit = _interior(inside & (truth >= 1 - _NEARLY), inside, band)
    return float(np.sum(np.where(lit, 1 - image, 0)) / np.sum(inside))


def false_light_rate(
    visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, band: int = 1
) -> float:
    """Share of the mask that the reference shadows and the image lights (leaks, Peter-panning).

    Arguments, result and errors as for `false_shadow_rate`, with dark for lit.
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
