"""Says how many runs are to do, and after the first how long all take."""

import math
import time
from collections.abc import Mapping

from rich.console import Console

from ..pages import _table as table
from ..runs._progress import duration

# Stages whose programs and results are kept for the runs that follow.
_ONCE = ("loading", "drawing", "looking for light", "tracing reference")


class Pace:
    """Prints the number of runs before they begin, and an estimate of their time once the first is done.

    **Arguments:**

    - `runs`: what they are called, such as `"fits"`; `after`: what follows them, as a part of a sentence.
    """

    def __init__(self, console: Console, runs: str, after: str = ""):
        self._console, self._runs, self._after = console, runs, after
        self._count, self._workers, self._began, self._is_said = 0, 1, 0.0, False

    def begin(self, count: int, workers: int) -> None:
        """Prints that `count` runs are to do, by so many `workers` at a time."""
        self._count, self._workers, self._began = count, workers, time.perf_counter()
        at_once = f", {min(workers, count)} at a time" if min(workers, count) > 1 else ""
        self._print(f"{count:,} {self._runs} to do{at_once}; the first says how long they take")

    def done(self, count: int, seconds: Mapping[str, float]) -> None:
        """Prints the estimate when the first of several runs is done.

        **Arguments:**

        - `count`: the number of runs that are done.
        - `seconds`: what the stages of the last one took, and `"total"`.
        """
        if self._is_said or count == self._count:
            return
        self._is_said = True
        took = time.perf_counter() - self._began
        # What follows finds these in a cache.
        again = seconds.get("total", took) - sum(seconds.get(stage, 0.0) for stage in _ONCE)
        turns = math.ceil(self._count / min(self._workers, self._count))
        self._print(
            f"the first took {duration(took)}, with what all compile and trace once; all {self._count:,} take about "
            f"{duration(took + again * (turns - 1))}{self._after}"
        )

    def _print(self, line: str) -> None:
        table.print_lines(self._console, [line])
