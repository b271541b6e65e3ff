"""Kernels: the texels that filters read, their weights, and sums over them.

To write a filter, use one of these:

- `mean_of_taps` averages compares at the points of a pattern; `single_tap` makes one compare.
- `sum_over_rows` sums over a square of texels, weighted by a `SeparableRow`, a `WeightedRow` or another
  `AbstractRow`.
- `sum_over` sums over any other `AbstractKernel`, on a map padded by `pad`.
"""

from ._atlas import Atlas as Atlas
from ._atlas import StoredMap as StoredMap
from ._atlas import without_depths as without_depths
from ._blur import Blur as Blur
from ._blur import bilinear_fetch as bilinear_fetch
from ._blur import check_radius as check_radius
from ._blur import limit_radius as limit_radius
from ._kernel import AbstractKernel as AbstractKernel
from ._kernel import AbstractRow as AbstractRow
from ._kernel import AbstractSizedRow as AbstractSizedRow
from ._kernel import Footprint as Footprint
from ._kernel import Span as Span
from ._padded_map import PaddedMap as PaddedMap
from ._padded_map import pad as pad
from ._separable import INTEGRALS as INTEGRALS
from ._separable import MIN_RADIUS as MIN_RADIUS
from ._separable import SeparableRow as SeparableRow
from ._separable import weight_between as weight_between
from ._sum import sum_over as sum_over
from ._sum import sum_over_rows as sum_over_rows
from ._taps import Tap as Tap
from ._taps import mean_of_taps as mean_of_taps
from ._taps import single_tap as single_tap
from ._weighted import WeightedRow as WeightedRow
