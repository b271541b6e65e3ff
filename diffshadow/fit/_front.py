"""What is given up: the front of false shadow against false light."""

import itertools
from typing import NamedTuple

import numpy as np

from ._run import Run, Values

# The ratio of the factors of false shadow and false light at the two ends of a front, and its inverse.
_MOST_RATIO = 256.0


class FrontPoint(NamedTuple):
    """A Pareto-optimal setting: no other one that was found has both less false shadow and less false light.

    - `values`: of the parameters, (p,).
    - `false_shadow`, `false_light`: roots of the losses of the pixels that are too dark, and of those too light. For a
        mean over the pixels, the sum of their squares is the loss.
    - `ratio`: the weight of false shadow divided by the weight of false light. This setting minimizes the weighted sum.
    - `is_knee`: whether it is farthest from the line between the ends of the front, both errors in units of what they
        range over: beyond it one error grows much for little of the other.
    """

    values: Values
    false_shadow: float
    false_light: float
    ratio: float
    is_knee: bool = False


def front_of(run: Run, best: Values, count: int) -> list[FrontPoint]:
    """The front through `best`, from the least false shadow to the least false light.

    Weighted sums of the two errors are made least, from neighbour to neighbour, away from `best` and back. The hard
    compare then decides which of all settings found is best for each sum.
    """
    ratios = _MOST_RATIO ** np.linspace(1, -1, count)
    middle, found = int(np.argmin(abs(np.log(ratios)))), {best: run.sides(best)}
    at = [best] * count

    def along(path: list[int]) -> None:
        for here, there in itertools.pairwise(path):
            at[there] = run.refitted(at[here], (), ratio=float(ratios[there]))
            found.setdefault(at[there], run.sides(at[there]))

    for end in (0, count - 1):
        step = 1 if end else -1
        outward = list(range(middle, end + step, step))
        along(outward)
        along(outward[::-1])
    points = []
    for ratio in ratios.tolist():
        total = lambda sides, ratio=ratio: ratio**0.5 * sides[0] ** 2 + ratio**-0.5 * sides[1] ** 2
        values = min(found, key=lambda values: total(found[values]))
        points.append(FrontPoint(values, *found[values], ratio))
    # Several sums may have the same least.
    points = list({point.values: point for point in points}.values())
    knee = _knee([(point.false_shadow, point.false_light) for point in points])
    return [point._replace(is_knee=i == knee) for i, point in enumerate(points)]


def _knee(errors: list[tuple[float, float]]) -> int:
    at = np.asarray(errors)
    scaled = (at - at.min(axis=0)) / np.maximum(np.ptp(at, axis=0), 1e-12)
    # The ends lie at (0, 1) and (1, 0).
    return int(np.argmin(scaled.sum(axis=1)))
