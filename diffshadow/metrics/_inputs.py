"""Checks of the images that metrics take."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from .._checks import check_outside_trace
from .._types import HostArray

# How far visibility may be out of range.
_ROUNDING = 1e-3
# Metrics are computed on the host.
_REMEDY = "call it outside; a loss to differentiate is written with jax.numpy, such as jnp.mean((image - truth) ** 2)"


def check_on_host(*given: Any) -> None:
    """**Raises** `ValueError` if an array in `given` is traced."""
    check_outside_trace("a metric", "arrays of known numbers", _REMEDY, given)


def as_images(
    visibility: ArrayLike, reference: ArrayLike, mask: ArrayLike | None
) -> tuple[Float64[HostArray, "h w"], Float64[HostArray, "h w"], Bool[HostArray, "h w"]]:
    """Both images in float64, and the mask; all are (h, w). Values outside the mask may be anything.

    **Raises** `ValueError` if the shapes differ or are not (h, w), the mask is not boolean or is empty, or an image
    holds a value in the mask that is not from 0 to 1.
    """
    check_on_host(visibility, reference, mask)
    image, truth = np.asarray(visibility, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if image.ndim != 2 or image.shape != truth.shape:
        raise ValueError(
            f"the visibility has shape {image.shape} and the reference {truth.shape}; expected the same shape "
            "(height, width): render both with the same camera"
        )
    inside = as_mask(mask, image.shape)
    for name, values in (("visibility", image), ("reference", truth)):
        bad = np.argwhere(inside & ~((values >= -_ROUNDING) & (values <= 1 + _ROUNDING)))
        if len(bad):
            row, column = bad[0]
            raise ValueError(
                f"the {name} holds values in the mask that are not from 0 to 1: {len(bad)}, the first "
                f"{values[row, column]:g} at row {row}, column {column}; expected visibility, from 0 shadowed to 1 "
                "lit: mask NaN out, and divide an image of 8 bits by 255"
            )
    return image, truth, inside


def as_mask(mask: ArrayLike | None, shape: tuple[int, ...]) -> Bool[HostArray, "h w"]:
    """The mask (h, w) of images of `shape`; all pixels by default.

    **Raises** `ValueError` if the mask has another shape, is not boolean, or is empty.
    """
    inside = np.ones(shape, dtype=bool) if mask is None else np.asarray(mask)
    if inside.shape != shape or inside.dtype != bool:
        raise ValueError(
            f"the mask has shape {inside.shape} and type {inside.dtype}; expected booleans of the images' shape {shape}"
        )
    if not inside.any():
        raise ValueError(
            f"the mask holds none of the {inside.size} pixels; expected at least one: check that the camera sees "
            "the scene"
        )
    return inside
