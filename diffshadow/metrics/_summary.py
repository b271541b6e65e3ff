"""All error metrics of a shadow at once."""

import dataclasses

from numpy.typing import ArrayLike

from ._differences import mae, rmse
from ._false_rates import false_light_rate, false_shadow_rate
from ._ssim import ssim


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
