"""The uncertainty of fitted values: the error along each parameter, with the others fitted again."""

from collections.abc import Callable, Collection, Sequence
from typing import Literal, NamedTuple

from ._parameters import Parameter
from ._run import Run, Values

# An end of an interval is found when the error there is this close to its limit, as a fraction of the limit's excess
# and as a fraction of the best error.
_CLOSE, _CLOSE_TO_BEST = 0.1, 2e-3
# The other parameters are fitted until the loss would fall by less than this fraction of the excess.
_SETTLED = 0.02
# The maximum number of trials for an end, and the fraction of the bounds at which trials stop.
_TRIALS, _NARROW = 16, 1e-4
# The first trial is at this fraction of the bounds from the best. Until a trial is outside, the distance grows by these
# factors.
_FIRST, _MIN_GROWTH, _MAX_GROWTH = 0.01, 1.3, 4.0
# Later trials keep this fraction of the distance to the trials on both sides.
_MARGIN = 0.1
# A trial that is better by this fraction becomes the best, and the results for the old best are dropped.
_BETTER, _RESTARTS = 1e-3, 4
# Errors of visibility below this value are rounding errors.
_MIN_ERROR = 1e-5

Bound = Literal["lower", "upper"]
"""One of the two bounds of a parameter."""


class End(NamedTuple):
    """An end of an interval.

    - `value`: value of the parameter.
    - `error`: the root of the loss there, with the other parameters fitted again.
    - `is_bound`: whether the error stays within the limit up to the parameter's bound.
    """

    value: float
    error: float
    is_bound: bool


class Interval(NamedTuple):
    """The values around the best at which the error is at most `1 + within` times the best.

    It ends where the error first exceeds this limit. The error may jump there, because pixels jump from lit to
    shadowed.
    """

    within: float
    lower: End
    upper: End


class Profile(NamedTuple):
    """The error along a parameter.

    - `best`: the value with the lowest error, and that error.
    - `points`: (value, error) of all trials, in order of their values.
    - `intervals`: from the narrowest to the widest.
    """

    name: str
    best: tuple[float, float]
    points: list[tuple[float, float]]
    intervals: list[Interval]

    def shifted(self, offset: float) -> "Profile":
        """The profile with `offset` added to the parameter's values."""
        end = lambda each: each._replace(value=each.value + offset)
        return self._replace(
            best=(self.best[0] + offset, self.best[1]),
            points=[(value + offset, error) for value, error in self.points],
            intervals=[each._replace(lower=end(each.lower), upper=end(each.upper)) for each in self.intervals],
        )


class Trial(NamedTuple):
    """Values of all parameters, and the root of the loss there."""

    values: Values
    error: float


def _limit(best: Trial, fraction: float) -> float:
    """The maximum error within a `fraction` of the best."""
    return (1 + fraction) * max(best.error, _MIN_ERROR)


class Profiler:
    """Follows the error of a finished fit along its parameters.

    - `best`: the trial with the lowest error so far.
    """

    def __init__(self, run: Run, parameters: Sequence[Parameter], values: Values):
        self.run, self.parameters = run, parameters
        self.best = Trial(values, run.error(values))
        self._trials: dict[tuple[int, Bound], list[Trial]] = {}
        self._count = self._restarts = 0

    def profiles(self, within: Sequence[float]) -> list[Profile]:
        """The profile of each parameter, with an interval for each of the fractions `within`."""
        return self._about_one_best(
            lambda: [self._profile(index, sorted(within)) for index in range(len(self.parameters))]
        )

    def preferred(self, order: Sequence[tuple[str, Bound]], within: float) -> Trial:
        """The trial that goes farthest towards the sides in `order`, with an error of at most `1 + within` times the
        best.

        The first parameter goes as far as possible, then the next goes as far as is still possible, and so on.
        """
        names = [p.name for p in self.parameters]

        def furthest() -> Trial:
            at, kept = self.best, []
            for name, side in order:
                at = self._furthest(at, names.index(name), side, _limit(self.best, within), kept)
                kept.append(names.index(name))
            return at

        return self._about_one_best(furthest)

    def _about_one_best[Found](self, search: Callable[[], Found]) -> Found:
        """The result of `search` from a whole round that found no better best. After the last restart, no trial becomes
        the best, so that all results refer to the same best."""
        self._restarts = 0
        while True:
            best = self.best
            found = search()
            if self.best == best:
                return found

    def _profile(self, index: int, within: Sequence[float]) -> Profile:
        parameter = self.parameters[index]
        ends: list[tuple[Trial, Trial]] = []
        for fraction in within:
            limit = _limit(self.best, fraction)
            ends.append(
                (self._furthest(self.best, index, "lower", limit), self._furthest(self.best, index, "upper", limit))
            )
        tried = [self.best, *self._trials.get((index, "lower"), ()), *self._trials.get((index, "upper"), ())]
        end = lambda trial, bound: End(trial.values[index], trial.error, trial.values[index] == bound)
        return Profile(
            parameter.name,
            (self.best.values[index], self.best.error),
            sorted({(trial.values[index], trial.error) for trial in tried}),
            [
                Interval(fraction, end(lower, parameter.lower), end(upper, parameter.upper))
                for fraction, (lower, upper) in zip(within, ends, strict=True)
            ],
        )

    def _furthest(self, start: Trial, index: int, side: Bound, limit: float, kept: Collection[int] = ()) -> Trial:
        """The trial with an error of at most `limit` that is farthest to a `side` of `start`, within its interval."""
        bound = getattr(self.parameters[index], side)
        span = self.parameters[index].upper - self.parameters[index].lower
        known = [] if kept else self._trials.setdefault((index, side), [])
        distance = lambda trial: abs(trial.values[index] - start.values[index])
        inside, outside = start, None
        for trial in sorted(known, key=distance):
            if trial.error > limit:
                outside = trial
                break
            inside = trial
        beyond: list[bool] = []
        for _ in range(_TRIALS):
            if distance(inside) >= abs(bound - start.values[index]):
                break
            if limit - inside.error <= self._tolerance(limit):
                break
            if outside is not None and distance(outside) - distance(inside) <= _NARROW * span:
                break
            if outside is not None and len(beyond) > 1 and beyond[-1] == beyond[-2]:
                # Two consecutive trials moved the same end: the error jumps, and interpolation would take many more
                # trials.
                value = (inside.values[index] + outside.values[index]) / 2
            else:
                value = self._next(start, inside, outside, index, side, limit)
            trial = self._trial(inside, index, value, limit, kept)
            known.append(trial)
            beyond.append(trial.error > limit)
            if trial.error < (1 - _BETTER) * self.best.error and self._restarts < _RESTARTS:
                self._restart(trial)
                return trial
            if trial.error > limit:
                outside = trial
            else:
                inside = trial
        return inside

    def _trial(self, near: Trial, index: int, value: float, limit: float, kept: Collection[int]) -> Trial:
        """The best trial with the parameter at `value`, starting from the values of a nearby trial."""
        self._count += 1
        self.run.say(f"how sure, trial {self._count}: {self.parameters[index].name} = {value:.4g}")
        moved = (*near.values[:index], value, *near.values[index + 1 :])
        tolerance = limit / max(self.best.error, _MIN_ERROR) - 1
        again = self.run.refitted(moved, (*kept, index), least_gain=_SETTLED * tolerance)
        # Not rounded to single precision, so that a bound is reached exactly.
        again = (*again[:index], value, *again[index + 1 :])
        trial = Trial(again, self.run.error(again))
        if trial.error <= limit or again == moved:
            return trial
        # A result under a soft compare may be worse under the hard compare.
        return min(trial, Trial(moved, self.run.error(moved)), key=lambda trial: trial.error)

    def _next(self, start: Trial, inside: Trial, outside: Trial | None, index: int, side: Bound, limit: float) -> float:
        """The next value: where a parabola around `start` has an error close enough to `limit`."""
        parameter, here = self.parameters[index], start.values[index]
        known = inside if outside is None else outside
        far, excess = known.values[index] - here, known.error**2 - self.best.error**2
        # The middle of the errors that end the search.
        aim = limit - self._tolerance(limit) / 2
        if outside is not None:
            near = inside.values[index] - here
            part = (aim**2 - inside.error**2) / max(outside.error**2 - inside.error**2, 1e-30)
            reach = (near**2 + part * (far**2 - near**2)) ** 0.5
            margin = _MARGIN * abs(far - near)
            reach = min(max(reach, abs(near) + margin), abs(far) - margin)
        elif far == 0:
            reach = _FIRST * (parameter.upper - parameter.lower)
        else:
            reach = abs(far) * ((aim**2 - self.best.error**2) / max(excess, 1e-30)) ** 0.5
            reach = min(max(reach, _MIN_GROWTH * abs(far)), _MAX_GROWTH * abs(far))
        value = here + reach if side == "upper" else here - reach
        return min(max(value, parameter.lower), parameter.upper)

    def _tolerance(self, limit: float) -> float:
        """The distance between the error at an end and `limit`."""
        return min(_CLOSE * (limit - self.best.error), _CLOSE_TO_BEST * max(self.best.error, _MIN_ERROR))

    def _restart(self, better: Trial) -> None:
        self._restarts += 1
        free = self.run.refitted(better.values, ())
        self.best = min(better, Trial(free, self.run.error(free)), key=lambda trial: trial.error)
        self._trials.clear()
