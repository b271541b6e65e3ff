"""How the soft compare of a fit hardens."""

import dataclasses
from typing import ClassVar

import numpy as np

from .._checks import check_settings
from ..settings.fit import Anneal as Settings
from ..settings.maps import SoftKernel


@dataclasses.dataclass(frozen=True)
class Anneal:
    """How the soft compare hardens: `phases` widths from `start` to `end` texels, in geometric steps.

    A single phase has the width `end`.

    **Raises** `ValueError` for a value that is not allowed, or `end` above `start`.

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
        # Downwards from the end, so that a single width is the end's.
        return [float(w) for w in np.geomspace(self.end, self.start, self.phases)[::-1]]
