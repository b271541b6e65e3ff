"""Times of techniques, from rounds that time each technique once, and the load of the machine."""

import math
import os
import time
from collections.abc import Hashable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.stats import binom

from ..._types import HostArray
from ..record._sweeps import Load, Times

# The probability that the interval around a median misses the true median.
_MISSED = 0.05
# A machine is busy if other processes use more than this fraction of its processors.
_OTHERS = 0.15
# It is also busy if the middle half of the rounds differ by more than this fraction of their median, in either
# direction.
_UNEVEN = 0.1


def busy_remark(load: Load) -> str | None:
    """A sentence about a busy machine, or `None`."""
    others = load.others or 0.0
    if others <= _OTHERS and load.unevenness <= _UNEVEN:
        return None
    causes = [f"other processes used {others:.0%} of its processors"] if others > _OTHERS else []
    if load.unevenness > _UNEVEN:
        causes.append(f"the time of equal work varied by ± {load.unevenness:.0%}")
    return f"the machine was busy while techniques were timed, so times are rough: {', and '.join(causes)}"


def times_of(rounds: Float[HostArray, "rounds techniques 2"], programs: Sequence[Hashable]) -> list[Times]:
    """The times of techniques.

    Each technique's time is divided by the geometric mean of all times in its round, because a slow phase of the
    machine affects all of them. Ratios and milliseconds are medians of these quotients, so milliseconds have the same
    ratios.

    **Arguments:**

    - `rounds`: (rounds, techniques, 2), seconds for the map and for the look-up.
    - `programs`: (techniques,), keys of the techniques' programs. Techniques with equal programs share their times.
    """
    members = {program: [i for i, other in enumerate(programs) if other == program] for program in programs}
    totals = {program: np.median(rounds[:, among].sum(axis=2), axis=1) for program, among in members.items()}
    pace = _pace(list(totals.values()))
    relative = {program: total / pace for program, total in totals.items()}
    fastest = min(float(np.median(each)) for each in relative.values())
    found = {}
    for program, among in members.items():
        middle, spread = _median(relative[program])
        own = rounds[:, among]
        part = float(np.median(own[..., 0] / own.sum(axis=2)))
        ms = middle * float(np.median(pace)) * 1e3
        found[program] = Times(map_ms=part * ms, lookup_ms=(1 - part) * ms, ratio=middle / fastest, spread=spread)
    return [found[program] for program in programs]


def unevenness_of(rounds: Float[HostArray, "rounds techniques 2"]) -> float:
    """Half of the interquartile range of the times of rounds, as a fraction of their median."""
    low, middle, high = np.percentile(_pace(list(rounds.sum(axis=2).T)), (25, 50, 75))
    return float((high - low) / 2 / middle)


def _pace(totals: Sequence[Float[HostArray, " rounds"]]) -> Float[HostArray, " rounds"]:
    """The geometric mean of each round's times."""
    return np.exp(np.mean(np.log(totals), axis=0))


def _median(samples: Float[HostArray, " rounds"]) -> tuple[float, float]:
    """The median, and half the width of its order-statistics interval as a fraction of it."""
    ordered, count = np.sort(samples), len(samples)
    rank = max(int(binom.ppf(_MISSED / 2, count, 0.5)) - 1, 0)
    middle = float(np.median(ordered))
    return middle, float(ordered[count - 1 - rank] - ordered[rank]) / 2 / middle


class Watch:
    """Measures the use of the machine's processors by other processes, from its creation on."""

    def __init__(self) -> None:
        self._began = time.perf_counter()
        self._own, self._all = _own_seconds(), _busy_seconds()

    def others(self) -> float | None:
        """The fraction of all processors' time that other processes used. `None` if the system does not report it."""
        busy = _busy_seconds()
        if busy is None or self._all is None:
            return None
        available = (time.perf_counter() - self._began) * (os.cpu_count() or 1)
        return min(max((busy - self._all - (_own_seconds() - self._own)) / available, 0.0), 1.0)


def _own_seconds() -> float:
    """The processors' time that this process has used."""
    return time.process_time()


def _busy_seconds() -> float | None:
    """The busy time of all processors since the system started, from Linux' /proc/stat."""
    try:
        kind, *ticks = Path("/proc/stat").read_text().split("\n", 1)[0].split()
        # user, nice, system, idle, iowait, irq, softirq, steal
        counts = [int(tick) for tick in ticks[:8]]
    except (OSError, ValueError):
        return None
    if kind != "cpu" or len(counts) < 5:
        return None
    seconds = (sum(counts) - counts[3] - counts[4]) / os.sysconf("SC_CLK_TCK")
    return seconds if math.isfinite(seconds) else None
