"""Perceptual error of pictures."""

import numpy as np
from jaxtyping import Float32
from numpy.typing import ArrayLike

from .._types import HostArray
from ._inputs import as_mask, check_on_host


def flip(
    picture: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None
) -> tuple[float, Float32[HostArray, "h w"]]:
    """The difference that a viewer perceives when `picture` and `reference` alternate on a screen (LDR-ꟻLIP).

    The screen has 67 pixels per degree of the field of view: 3840 pixels over 0.7 m, seen from 0.7 m.

    **Arguments:**

    - `picture`, `reference`: (h, w, 3), in sRGB (not linear), in [0, 1].
    - `mask`: (h, w), the pixels that count; all of them by default. Outside of the mask, the picture is replaced by the
        reference, so its values there have no effect.

    **Returns:** the arithmetic mean over the mask, and the error of each pixel, (h, w), 0 outside the mask. Both are in
    [0, 1], and 0 for equal pictures.

    **Raises** `ValueError` if shapes differ, the mask is empty, or a value is not in [0, 1]; `ImportError` without the
    package flip-evaluator.

    Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, "ꟻLIP: A Difference Evaluator for Alternating
    Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2), 2020; by the
    authors' own code.
    """
    truth = _as_picture("reference", reference)
    image = _as_picture("picture", picture)
    if image.shape != truth.shape:
        raise ValueError(
            f"the picture has shape {image.shape} and the reference {truth.shape}; expected the same shape "
            "(height, width, 3): shade both with the same camera"
        )
    inside = as_mask(mask, image.shape[:2])
    try:
        # Imported here, since the package has no wheels for the newest Python.
        import flip_evaluator
    except ImportError as error:
        raise ImportError(
            f"FLIP needs the package flip-evaluator, which cannot be imported ({error}); expected it to be "
            "installed: pip install flip-evaluator"
        ) from error
    seen = np.where(inside[..., None], image, truth)
    found, *_ = flip_evaluator.evaluate(truth, seen, "LDR", applyMagma=False, computeMeanError=False)
    errors = np.where(inside, np.asarray(found)[..., 0], np.float32(0))
    return float(np.mean(errors[inside], dtype=np.float64)), errors


def _as_picture(name: str, picture: ArrayLike) -> Float32[HostArray, "h w 3"]:
    """**Raises** `ValueError` unless `picture` has shape (h, w, 3) and values in [0, 1]."""
    check_on_host(picture)
    values = np.asarray(picture)
    if values.ndim != 3 or values.shape[-1] != 3 or not values.size:
        raise ValueError(f"the {name} has shape {values.shape}; expected (height, width, 3), in sRGB")
    # Written so that NaN fails.
    bad = np.argwhere(~((values >= 0) & (values <= 1)))
    if len(bad):
        row, column, _ = bad[0]
        raise ValueError(
            f"the {name} holds {len(bad)} values outside [0, 1] (the first at row {row}, column {column}); expected "
            "sRGB from 0 to 1: divide bytes by 255, and clip values that exceed white"
        )
    return np.ascontiguousarray(values, dtype=np.float32)
