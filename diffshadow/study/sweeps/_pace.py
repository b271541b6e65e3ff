"""Says how many runs are to do, and how long all take, as soon as that is known and again when it changes."""

import time
from collections.abc import Callable, Mapping

from rich.console import Console

from ..pages import _table as table
from ..runs._progress import duration

# Stages whose programs and results are kept for the runs that follow.
_ONCE = ("loading", "drawing", "looking for light", "tracing reference")
# An estimate is said again if it differs from the last by more than this factor.
_CHANGED = 1.25
# So many steps are done before it is said how long all take.
_KNOWN = 3


class Pace:
    """Prints the number of runs before they begin, an estimate of their time once the first is done, and better
    estimates as more runs are done.

    **Arguments:**

    - `runs`: what they are called, such as `"fits"`; `after`: what follows them, as a part of a sentence.
    """

    def __init__(self, console: Console, runs: str, after: str = ""):
        self._console, self._runs, self._after = console, runs, after
        self._count, self._workers, self._began = 0, 1, 0.0
        self._took, self._said = 0.0, 0.0

    def begin(self, count: int, workers: int) -> None:
        """Prints that there are `count` runs to do, with `workers` of them at a time."""
        self._count, self._workers, self._began = count, workers, time.perf_counter()
        at_once = f", {min(workers, count)} at a time" if min(workers, count) > 1 else ""
        self._print(f"{count:,} {self._runs} to do{at_once}; the first says how long they take")

    def done(self, count: int, seconds: Mapping[str, float]) -> None:
        """Prints an estimate when the first of several runs is done, and when it has changed.

        **Arguments:**

        - `count`: the number of runs that are done.
        - `seconds`: what the stages of the last one took, and `"total"`.
        """
        took = time.perf_counter() - self._began
        # What follows finds these in a cache. Each run compiles programs of its own.
        self._took += seconds.get("total", took) - sum(seconds.get(stage, 0.0) for stage in _ONCE)
        if count == self._count:
            return
        whole = took + self._took / count * (self._count - count) / min(self._workers, self._count)
        if self._said and whole < _CHANGED * self._said and self._said < _CHANGED * whole:
            return
        if self._said:
            self._print(f"{count:,} of {self._count:,} are done; all take about {duration(whole)}{self._after}")
        else:
            self._print(
                f"the first took {duration(took)}, with what all compile and trace once; all {self._count:,} take "
                f"about {duration(whole)} if the others compile as long{self._after}"
            )
        self._said = whole

    def _print(self, line: str) -> None:
        table.print_lines(self._console, [line])


def saying_how_long(console: Console, what: str, total: int, progress: Callable[[int], None]) -> Callable[[int], None]:
    """Like `progress`, but it also prints how long `total` steps of `what` take, as soon as a few are done."""
    began, is_said = time.perf_counter(), False

    def step(done: int) -> None:
        nonlocal is_said
        progress(done)
        if done >= _KNOWN and not is_said:
            is_said = True
            whole = (time.perf_counter() - began) / done * total
            table.print_lines(console, [f"{what} takes about {duration(whole)}"])

    return step
