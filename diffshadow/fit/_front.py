"""The trade-off of a technique: the front of false shadow against false light."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._arithmetic import as_float
from .._types import HostArray
from ..settings.fit import FEWEST_POINTS
from ._run import Run, Values
from ._search import search
from ._starts import starts_within

# The ratio of the weights of false shadow and false light at one end of a front. At the other end, it is the inverse.
_MAX_RATIO = 256.0
# The number of settings over all of the bounds that are tried first, for each parameter. The corners are also tried for
# at most this many parameters.
_SPREAD, _MAX_CORNERS = 32, 4
# The search around the best setting of each end: evaluations for each parameter, and the fraction of the bounds.
_EVALUATIONS, _PART = 15, 0.25
# The maximum number of fits between two neighbours, for each point of the front.
_FITS = 3
# Settings are the same if neither error differs by more than this fraction.
_SAME = 5e-3

Sides = tuple[float, float]
"""The roots of the losses of false shadow and false light."""


class FrontPoint(NamedTuple):
    """A Pareto-optimal setting: no other setting that was found has both less false shadow and less false light.

    - `values`: values of the parameters, (p,).
    - `false_shadow`, `false_light`: square roots of the losses of the pixels that are too dark, and of the pixels that
        are too light. For a mean over the pixels, the sum of their squares is the loss.
    - `ratio`: the weight of false shadow divided by the weight of false light. This setting has the lowest weighted sum
      of squares among all settings that were found.
    - `rmse`: the RMSE over all pixels that count, even if the fit has another loss.
    - `is_knee`: whether it is farthest from the line between the ends of the front, with each error in units of its
        range. Beyond the knee, one error grows much while the other falls little. Its RMSE may be far from the lowest.
    """

    values: Values
    false_shadow: float
    false_light: float
    ratio: float
    rmse: float
    is_knee: bool = False


def front_of(run: Run, best: Values, count: int) -> list[FrontPoint]:
    """The front. At its first setting, false shadow weighs 256 times as much as false light; at its last, a 256th. The
    setting with the lowest loss is between them.

    Settings over all of the bounds are tried first. Each end is then searched from `best` and from the best of these
    settings, by gradient and by a search under the hard compare. Between two neighbours, the fit minimises the weighted
    sum that is equal for both, starting from both. This finds a setting below the line between them, if there is one
    (noninferior set estimation, Cohon, Church & Sheer 1979). Only the hard compare judges.

    **Returns** at most `count` settings. There are fewer points if no more with different errors were found.
    """
    found = _Settings(run)
    found.add(best)
    found.spread()
    for ratio in (_MAX_RATIO, 1 / _MAX_RATIO):
        found.end(ratio, best)
    found.between(count)
    points = [point._replace(rmse=run.rmse(point.values)) for point in _chosen(found.hull(), count)]
    knee = _knee(points)
    return [point._replace(is_knee=i == knee) for i, point in enumerate(points)]


class _Settings:
    """The settings that were found, and their errors.

    - `settled`: the settings where a fit ended, or started without improvement.
    """

    def __init__(self, run: Run):
        self.run = run
        self.sides: dict[Values, Sides] = {}
        self.settled: set[Values] = set()

    def add(self, values: Values) -> Sides:
        """The errors of `values`, which are evaluated if they are unknown."""
        if values not in self.sides:
            self.run.say(f"front, setting {len(self.sides) + 1}")
            self.sides[values] = self.run.sides(values)
        return self.sides[values]

    def best(self, ratio: float) -> Values:
        """The setting with the lowest weighted sum."""
        return min(self.sides, key=lambda values: _sum(self.sides[values], ratio))

    def refit(self, values: Values, ratio: float) -> None:
        """Fits a weighted sum from `values`."""
        end = self.run.refitted(values, (), ratio=ratio)
        self.add(end)
        self.settled |= {values, end}

    def spread(self) -> None:
        """Tries settings over all of the bounds, and their corners."""
        parameters = self.run.parameters
        ends = [np.asarray(end) for end in (parameters.lower, parameters.upper)]
        tried = np.asarray(starts_within(parameters, parameters.lower, _SPREAD * len(ends[0]), seed=0))
        if len(ends[0]) <= _MAX_CORNERS:
            tried = np.concatenate([tried, list(itertools.product(*np.transpose(ends)))])
        for values in tried.tolist():
            self.add(tuple(values))

    def end(self, ratio: float, best: Values) -> None:
        """Searches an end of the front, from `best` and from the best setting so far."""
        for start in dict.fromkeys((best, self.best(ratio))):
            self.refit(start, ratio)
        lower, upper = (np.asarray(end, np.float64) for end in (self.run.parameters.lower, self.run.parameters.upper))
        error = lambda values: _sum(self.add(tuple(as_float(values).tolist())), ratio)
        search(error, np.asarray(self.best(ratio)), lower, upper, _EVALUATIONS * len(lower), _PART)
        self.refit(self.best(ratio), ratio)

    def between(self, count: int) -> None:
        """Searches for settings between neighbours until `count` are settled. The neighbours that are farthest apart
        come first."""
        tried: set[tuple[Values, Values]] = set()
        for _ in range(_FITS * count):
            hull = self.hull()
            points = _chosen(hull, count)
            rough = [point for point in points if point.values not in self.settled]
            gaps = [
                (gap, a, b)
                for gap, (a, b) in zip(_gaps(hull), itertools.pairwise(hull), strict=True)
                if (a.values, b.values) not in tried and not _are_same(a, b)
            ]
            if rough:
                self.refit(rough[0].values, rough[0].ratio)
            elif gaps and len(points) < count:
                _, a, b = max(gaps, key=lambda each: each[0])
                tried.add((a.values, b.values))
                for start in (a, b):
                    self.refit(start.values, _equal(a, b))
            else:
                break

    def hull(self) -> list[FrontPoint]:
        """The settings that have the lowest weighted sum for some ratio, in order of increasing false shadow."""
        first, last = (self.best(ratio) for ratio in (_MAX_RATIO, 1 / _MAX_RATIO))
        (least, most), (most_light, least_light) = zip(self.sides[first], self.sides[last], strict=True)
        inside = [
            values
            for values, (shadow, light) in self.sides.items()
            if least < shadow < most and least_light < light < most_light
        ]
        points: list[FrontPoint] = []
        for values in dict.fromkeys((first, *sorted(inside, key=self.sides.__getitem__), last)):
            point = FrontPoint(values, *self.sides[values], 1.0, 0.0)
            # Removes points on or above the line between their neighbours.
            while len(points) > 1 and _equal(points[-2], points[-1]) <= _equal(points[-1], point):
                points.pop()
            points.append(point)
        if len(points) == 1:
            return points
        ratios = [_MAX_RATIO, *(_equal(a, b) for a, b in itertools.pairwise(points)), 1 / _MAX_RATIO]
        middle = [(a * b) ** 0.5 for a, b in itertools.pairwise(ratios)]
        middle[0], middle[-1] = ratios[0], ratios[-1]
        return [point._replace(ratio=ratio) for point, ratio in zip(points, middle, strict=True)]


def _sum(sides: Sides, ratio: float) -> float:
    """The weighted sum of the squares of false shadow and false light."""
    return ratio**0.5 * sides[0] ** 2 + ratio**-0.5 * sides[1] ** 2


def _equal(a: FrontPoint, b: FrontPoint) -> float:
    """The ratio for which both have the same weighted sum."""
    return (a.false_light**2 - b.false_light**2) / max(b.false_shadow**2 - a.false_shadow**2, 1e-30)


def _are_same(a: FrontPoint, b: FrontPoint) -> bool:
    pairs = ((a.false_shadow, b.false_shadow), (a.false_light, b.false_light))
    return all(abs(one - other) <= _SAME * max(one, other) for one, other in pairs)


def _scaled(points: Sequence[FrontPoint]) -> Float[HostArray, "n 2"]:
    """The errors, each divided by its range. The ends lie at (0, 1) and (1, 0)."""
    at = np.asarray([(point.false_shadow, point.false_light) for point in points])
    return (at - at.min(axis=0)) / np.maximum(np.ptp(at, axis=0), 1e-12)


def _gaps(points: Sequence[FrontPoint]) -> list[float]:
    """The distances between neighbours."""
    return np.linalg.norm(np.diff(_scaled(points), axis=0), axis=1).tolist()


def _chosen(points: Sequence[FrontPoint], count: int) -> list[FrontPoint]:
    """At most `count` of the distinct points: the lowest loss, the ends, and the points farthest from all of these."""
    at, least = _scaled(points), min(points, key=lambda point: _sum((point.false_shadow, point.false_light), 1.0))
    chosen: list[int] = []
    for i in (points.index(least), 0, len(points) - 1):
        if not any(_are_same(points[i], points[k]) for k in chosen):
            chosen.append(i)
    while len(chosen) < count:
        others = [i for i in range(len(points)) if not any(_are_same(points[i], points[k]) for k in chosen)]
        if not others:
            break
        away = np.linalg.norm(at[others][:, None] - at[chosen], axis=-1).min(axis=1)
        chosen.append(others[int(np.argmax(away))])
    return [points[i] for i in sorted(chosen)]


def _knee(points: Sequence[FrontPoint]) -> int | None:
    """The index of the knee. `None` unless there is a point between the ends."""
    return int(np.argmin(_scaled(points).sum(axis=1))) if len(points) >= FEWEST_POINTS else None
