"""The annealing of a fit's soft compare."""

import dataclasses
from typing import ClassVar

import numpy as np

from .._checks import check_settings
from ..settings.fit import Anneal as Settings
from ..settings.maps import SoftKernel


@dataclasses.dataclass(frozen=True)
class Anneal:
    """The widths of the soft compare: `phases` widths from `start` to `end` texels, in geometric steps. A single phase
    has the width `end`. **Raises** `ValueError` for an invalid value, or for `end` above `start`.

    !!! Example

        ```python
        fit.Anneal(start=1.0, end=0.25, phases=3).widths  # [1.0, 0.5, 0.25]
        ```
    """

    settings: ClassVar = Settings

    start: float = Settings.start
    end: float = Settings.end
    phases: int = Settings.phases
    kernel: SoftKernel = Settings.kernel

    def __post_init__(self):
        check_settings(self)

    @property
    def widths(self) -> list[float]:
        """The width of each phase, in texels."""
        # From the end downwards, so that a single width is the end.
        return [float(w) for w in np.geomspace(self.end, self.start, self.phases)[::-1]]
