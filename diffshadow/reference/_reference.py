"""The reference that shadow maps are measured against."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float32, Int32

from .._pictures import as_html
from .._types import HostArray


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """An image of how much of the light is visible from each surface point. Arrays are in host memory.

    - `visibility`: (h, w), visible fraction of the light, in [0, 1]; 1 where there is no surface.
    - `mask`: (h, w), where the camera sees a surface.
    - `position`: (h, w, 3), position of the surface, in world units from the scene's origin; 0 where there is none.
    - `normal`: (h, w, 3), geometric unit normal, facing the camera; 0 where there is no surface.
    - `face`: (h, w), index into the mesh's faces; -1 where there is no surface.
    - `samples`: shadow rays per pixel, summed over its camera rays; 0 if the visibility was given, not traced.
    - `standard_error`: (h, w), estimated standard error of `visibility`. It is half the difference between the means of
      two halves of a pixel's samples. Since that is a single draw, use its mean square over a region, not single
      pixels. The estimate is unbiased for stratified samples and up to 1.7 times too high for Sobol samples, whose
      halves complement each other. It is 0 for a light without size, whose visibility is exact, and for a given
      visibility, whose error is unknown. It is 0.5, the maximum, for a single sample of a light with size.

    Row 0 is the image's bottom row.
    """

    visibility: Float32[HostArray, "h w"]
    mask: Bool[HostArray, "h w"]
    position: Float32[HostArray, "h w 3"]
    normal: Float32[HostArray, "h w 3"]
    face: Int32[HostArray, "h w"]
    samples: int
    standard_error: Float32[HostArray, "h w"]

    def _repr_html_(self) -> str:
        """A picture of the visibility."""
        height, width = self.visibility.shape
        how = f"{self.samples} rays a pixel, noise {self.noise_floor:.2g}" if self.samples else "given"
        return as_html(f"Reference: visibility of {width} x {height} pixels, {how}", self.visibility)

    @property
    def noise_floor(self) -> float:
        """Root mean square of `standard_error` over the mask.

        An RMSE against this reference is not meaningful below about this value.
        """
        return float(np.sqrt(np.mean(np.square(self.standard_error[self.mask], dtype=np.float64))))
