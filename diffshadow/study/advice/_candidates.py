"""Candidates: techniques with their errors and times, and the choice among them."""

from collections.abc import Sequence

from ..record._sweeps import Candidate

SAME_TIME = 0.05
"""Times count as equal if they differ by at most this fraction, because repeated measurements differ as much."""


def same_time(one: Candidate, other: Candidate) -> bool:
    """Whether the times of two candidates differ by at most `SAME_TIME`, or by at most the uncertainty of both."""
    most = 1 + max(SAME_TIME, one.spread + other.spread)
    return 1 / most <= one.ratio / other.ratio <= most


def ranked(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates in order of error. Candidates of equal error are in order of time."""
    return sorted(candidates, key=lambda each: (each.rmse, each.ratio))


def front(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The Pareto front, from fast to slow: no other candidate is faster with an error as small. Equal candidates are
    all on the front.
    """
    beats = lambda a, b: a.rmse <= b.rmse and a.ratio <= b.ratio and (a.rmse < b.rmse or a.ratio < b.ratio)
    kept = [each for each in candidates if not any(beats(other, each) for other in candidates)]
    return sorted(kept, key=lambda each: (each.ratio, each.rmse))


def recommended(candidates: Sequence[Candidate], within: float, noise: float = 0.0) -> Candidate:
    """The fastest candidate whose RMSE exceeds the lowest RMSE by at most the fraction `within`, or by at most the
    reference's `noise`.

    Among candidates that take the same time, it is the one with the lowest error, or the fastest if errors differ only
    by noise.
    """
    least = min(each.rmse for each in candidates)
    good = [each for each in candidates if each.rmse <= least + tolerated(least, within, noise)]
    fastest = min(good, key=lambda each: each.ratio)
    near = [each for each in good if same_time(each, fastest)]
    best = min(each.rmse for each in near)
    return min((each for each in near if each.rmse <= best + noise), key=lambda each: (each.ratio, each.rmse))


def tolerated(least: float, within: float, noise: float) -> float:
    """The amount by which an RMSE may exceed the lowest and still count as good."""
    return max(least * within, noise)
