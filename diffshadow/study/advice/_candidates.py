"""Candidates: techniques with their errors and times, and which of them to prefer."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

SAME_TIME = 0.05
"""The fraction by which two times may differ and still count as equal: repeated measurements differ so."""


class Candidate(NamedTuple):
    """A fitted technique.

    - `id`: of its run; `bias`, `filter`: the labels of its entries; `resolution`: of its map, in texels.
    - `values`: the fitted numbers, by the key that sets them; `units`: of these.
    - `rmse`, `false_shadow`, `false_light`: its errors over the validation, or over what the fit sees if there is none.
    - `fit_rmse`: over what the fit sees.
    - `map_ms`, `lookup_ms`: milliseconds to draw the maps of one view and to look them up.
    - `ratio`: its time, relative to the fastest candidate's; `spread`: how far it may be off, as a fraction of it.
    """

    id: str
    bias: str
    filter: str
    resolution: tuple[int, int]
    values: Mapping[str, float]
    units: Mapping[str, str]
    rmse: float
    false_shadow: float
    false_light: float
    fit_rmse: float
    map_ms: float
    lookup_ms: float
    ratio: float
    spread: float = 0.0

    @property
    def ms(self) -> float:
        """Milliseconds for one view."""
        return self.map_ms + self.lookup_ms

    @property
    def times(self) -> str:
        """Its time relative to the fastest candidate's, and how far this may be off."""
        return f"{self.ratio:.2f} ± {self.ratio * self.spread:.2f}"

    @property
    def size(self) -> str:
        """The map's resolution in texels, in words."""
        height, width = self.resolution
        return f"{height}²" if height == width else f"{height} × {width}"

    @property
    def name(self) -> str:
        """Its name in sentences."""
        return f"{self.bias} with {self.filter} at {self.size}"


def same_time(one: Candidate, other: Candidate) -> bool:
    """Whether the times of two candidates differ by no more than `SAME_TIME`, or than both may be off."""
    most = 1 + max(SAME_TIME, one.spread + other.spread)
    return 1 / most <= one.ratio / other.ratio <= most


def ranked(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates by error; of equal ones, the fastest first."""
    return sorted(candidates, key=lambda each: (each.rmse, each.ratio))


def front(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The Pareto front, from fast to slow: no other candidate is faster with as small an error.

    Equal ones are all on it.
    """
    beats = lambda a, b: a.rmse <= b.rmse and a.ratio <= b.ratio and (a.rmse < b.rmse or a.ratio < b.ratio)
    kept = [each for each in candidates if not any(beats(other, each) for other in candidates)]
    return sorted(kept, key=lambda each: (each.ratio, each.rmse))


def recommended(candidates: Sequence[Candidate], within: float, noise: float = 0.0) -> Candidate:
    """The fastest candidate whose RMSE exceeds the least by at most the fraction `within` of it, or by the reference's
    `noise`.

    Of those with the same time, it is the fastest of those with the least error within the noise.
    """
    least = min(each.rmse for each in candidates)
    good = [each for each in candidates if each.rmse <= least + tolerated(least, within, noise)]
    fastest = min(good, key=lambda each: each.ratio)
    near = [each for each in good if same_time(each, fastest)]
    best = min(each.rmse for each in near)
    return min((each for each in near if each.rmse <= best + noise), key=lambda each: (each.ratio, each.rmse))


def tolerated(least: float, within: float, noise: float) -> float:
    """By how much an RMSE may exceed the least and still count as good."""
    return max(least * within, noise)
