"""Values that ended on a bound, and whether the error still falls there."""

from collections.abc import Sequence
from typing import NamedTuple

from ._parameters import Parameter
from ._profile import Bound
from ._run import Run, Values

# A value is on a bound if its distance is at most this fraction of the distance between the bounds.
_ON_BOUND = 1e-3
# The slope at a bound is the slope of a parabola through three losses: at the bound, and at one and two of these
# fractions inside.
_STEP = 0.05
# The loss falls if the slope lowers it by more than this fraction per step. Bounds twice as far apart would then lower
# the error by a hundredth or more. Noise and rounding lower it by less.
_FALLS = 1e-3


class AtBound(NamedTuple):
    """A value that ended on a bound.

    - `name`: name of the parameter; `side`: its lower or upper bound; `value`: value of the bound.
    - `falls`: whether the error under the hard compare still falls there, so that wider bounds may lower it.
    """

    name: str
    side: Bound
    value: float
    falls: bool


def at_bounds(run: Run, parameters: Sequence[Parameter], values: Values) -> list[AtBound]:
    """The parameters whose values are on a bound. The error of each parameter is evaluated at the bound and farther
    inside.

    **Arguments:** `values`: relative to the parameters' offsets.
    """
    found = []
    for i, (parameter, value) in enumerate(zip(parameters, values, strict=True)):
        counted = parameter.counted()
        span = counted.upper - counted.lower
        sides: list[tuple[Bound, float, float]] = [("lower", counted.lower, span), ("upper", counted.upper, -span)]
        for side, bound, inwards in sides:
            if abs(value - bound) <= _ON_BOUND * span:
                steps = (bound + step * _STEP * inwards for step in range(3))
                here, near, far = (run.error((*values[:i], at, *values[i + 1 :])) ** 2 for at in steps)
                slope = (4 * near - far - 3 * here) / 2
                found.append(AtBound(parameter.name, side, getattr(parameter, side), slope > _FALLS * here))
    return found
