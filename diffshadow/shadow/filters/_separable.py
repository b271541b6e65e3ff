"""A separable kernel whose weights are free."""

from collections.abc import Sequence

import numpy as np

from ..._misc import as_float, concrete
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import WeightedRow, sum_over_rows
from ._abstract import AbstractFilter

MOST_WEIGHTS = 16
"""The most weights of a separable kernel: the number of taps grows with its square."""


class Separable(AbstractFilter):
    """A symmetric kernel of fixed width with free weights: bilinear compares one texel apart, weighted along both axes
    and divided by the weights' sum.

    With n weights there are (2n + 1)² compares. All of `Castano`'s kernels are such: 3/4 and 1/4 are that of size 5.

    - `weights`: of the compares 1, 2, ... texels from the middle, relative to the middle's; each 0 or more.

    **Raises** `ValueError` if there is none or more than 16, or one is negative or not finite.
    """

    weights: tuple[Scalar, ...]

    def __init__(self, weights: Sequence[float | Scalar] = (0.75, 0.25)):
        self.weights = tuple(as_float(weight) for weight in weights)

    def __check_init__(self):
        if not 1 <= len(self.weights) <= MOST_WEIGHTS:
            raise ValueError(f"the separable kernel has {len(self.weights)} weights; expected 1 to {MOST_WEIGHTS}")
        for weight in self.weights:
            known = concrete(weight)
            if known is not None and not (known >= 0 and np.isfinite(known)):
                raise ValueError(f"a weight of the separable kernel is {known}; expected 0 or more times the middle's")

    @property
    def normalized(self) -> tuple[Scalar, ...]:
        """The weights of the compares 0, 1, 2, ... texels from the middle, which sum to 1 over both sides."""
        each = (as_float(1), *self.weights)
        total = each[0] + 2 * sum(self.weights)
        return tuple(weight / total for weight in each)

    @property
    def reach(self) -> float:
        return len(self.weights) + 1.0

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        return sum_over_rows(WeightedRow(self.normalized), shadow_map, compare, lookup)
