"""The truth that shadow maps are measured against."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float32, Int32

from .._types import HostArray


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """A camera's image of how much of the light each surface point sees. Arrays are in host memory.

    - `visibility`: (h, w), share of the light that is seen, in [0, 1]; 1 where there is no surface.
    - `mask`: (h, w), where a surface is seen.
    - `position`: (h, w, 3), of the surface, world units; 0 where there is none.
    - `normal`: (h, w, 3), geometric unit normal of the side that the camera sees; 0 where there is none.
    - `face`: (h, w), index into the mesh's faces; -1 where there is none.
    - `samples`: shadow rays a pixel, of all its camera rays together; 0 if the visibility was not traced but given.
    - `standard_error`: (h, w), estimated standard error of `visibility`. Half the difference of the two halves of a
      pixel's samples: one draw, so read it through its mean square over a region rather than pixel by pixel. That is
      right for stratified samples and up to 1.7 times too high for Sobol's, whose halves complement each other. 0 for a
      light without size, whose visibility is exact, and for a given visibility, whose error is not known; 0.5, the
      most that it can be, for a single sample of a light with size.

    Row 0 is the image's bottom row.
    """

    visibility: Float32[HostArray, "h w"]
    mask: Bool[HostArray, "h w"]
    position: Float32[HostArray, "h w 3"]
    normal: Float32[HostArray, "h w 3"]
    face: Int32[HostArray, "h w"]
    samples: int
    standard_error: Float32[HostArray, "h w"]

    @property
    def noise_floor(self) -> float:
        """Root mean square of `standard_error` over the mask.

        An RMSE against this reference below about this number says nothing.
        """
        return float(np.sqrt(np.mean(np.square(self.standard_error[self.mask], dtype=np.float64))))
