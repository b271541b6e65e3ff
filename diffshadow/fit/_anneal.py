"""How the soft compare of a fit hardens."""

from typing import NamedTuple

import numpy as np

from ..shadow import SoftKernel


class Anneal(NamedTuple):
    """How the soft compare hardens: `phases` widths from `start` to `end` texels, in geometric steps.

    A single phase has the width `end`.
    """

    start: float = 2.0
    end: float = 0.05
    phases: int = 4
    kernel: SoftKernel = "logistic"

    @property
    def widths(self) -> list[float]:
        """The width of each phase, in texels."""
        # Downwards from the end, so that a single width is the end's.
        return [float(w) for w in np.geomspace(self.end, self.start, self.phases)[::-1]]


def check_anneal(anneal: Anneal) -> None:
    """**Raises** `ValueError` unless the widths are positive and shrink, in at least one phase."""
    if anneal.phases < 1:
        raise ValueError(f"the anneal has {anneal.phases} phases; expected 1 or more")
    for name, value in (("start", anneal.start), ("end", anneal.end)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(
                f"the anneal's {name} is {value} texels; expected a finite width above 0: a fit ends with the hard "
                "compare in any case"
            )
    if anneal.end > anneal.start:
        raise ValueError(
            f"the anneal widens from {anneal.start} to {anneal.end} texels; expected end at most start: swap the two"
        )
