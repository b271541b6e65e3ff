"""Progress of a run, and how long each of its stages took."""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar

# Seconds between updates of a bar.
_PAUSE = 0.05
# Seconds of work after which the rest is estimated.
_KNOWN = 2.0
_MINUTE = 60.0
# The part of a detail that names a phase of a fit, perhaps of one of several starts.
_PHASE = re.compile(r".*\bphase \d+ of \d+")

# One for all runs of a sweep, since making one takes as long as reading a result.
_QUIET = Console(quiet=True)


class Progress:
    """A progress line that vanishes when the work is done. It is shown on a terminal only. Elsewhere, if the console
    has `names_stages`, it prints a line for each stage and for each phase of a fit as it begins.

    - `seconds`: how long each finished stage took, by name, in order.
    - `part`: the part of the work that has the stages, such as `"view 2 of 9"`; empty if there is only one.
    """

    def __init__(self, console: Console):
        self.seconds: dict[str, float] = {}
        self.part = ""
        self._progress = Bar(
            SpinnerColumn(finished_text=" "),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[detail]}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("", total=None, detail="")
        self._console, self._began = console, time.perf_counter()
        self._named: set[str] | None = set() if getattr(console, "names_stages", False) else None

    @classmethod
    def quiet(cls) -> "Progress":
        """Progress that is not shown."""
        return cls(_QUIET)

    def __enter__(self) -> "Progress":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Names the work inside, and times it."""
        self.show(name)
        self._progress.refresh()
        started = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started

    def show(self, name: str, detail: str = "", done: float | None = None) -> None:
        """Shows the stage `name` with `detail`, and a bar filled to the fraction `done` if that is known."""
        total = None if done is None else 1.0
        self._name(name, detail, done)
        detail = ", ".join(filter(None, (self.part, detail)))
        self._progress.update(self._task, description=escape(name), detail=escape(detail), total=total, completed=done)

    def _name(self, name: str, detail: str, done: float | None) -> None:
        """Prints a line when a stage or a phase begins, if the console asks for it."""
        if self._named is None:
            return
        phase = _PHASE.match(detail)
        # What a fit does besides its steps has a detail with a name, then numbers.
        part = phase[0] if phase else detail.partition(",")[0] if done is None else ""
        line = f"{name}, {part}" if part else name
        if line not in self._named:
            self._named.add(line)
            self._console.print(f"{time.perf_counter() - self._began:6.1f} s  {escape(line)}", soft_wrap=True)

    def counted[T](self, name: str, items: Sequence[T]) -> Iterator[T]:
        """The items, one after another. The `part` is the number of each item, with an estimate of its time and of the
        time left.

        **Arguments:** `name`: name of an item.
        """
        total, began = len(items), 0.0
        for number, item in enumerate(items, start=1):
            if number == 2:
                # The first also compiles.
                began = time.perf_counter()
            self.part, seconds = f"{name} {number:,} of {total:,}", time.perf_counter() - began
            if number > 2 and seconds > _KNOWN:
                self.part += f", about {duration(seconds / (number - 2) * (total - number + 1))} left"
            self._progress.update(self._task, detail=escape(self.part))
            yield item
        self.part = ""


def duration(seconds: float) -> str:
    """A time in words, in seconds or minutes."""
    if seconds < 2 * _MINUTE:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / _MINUTE:.0f} min"


@contextmanager
def counting(console: Console, name: str, total: int) -> Iterator[Callable[..., None]]:
    """A progress bar that vanishes when the work is done. Call it with the number done of `total`, and a detail."""
    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TextColumn("{task.fields[detail]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task(escape(name), total=total, detail="")
    shown = time.monotonic()

    def progress(done: int, detail: str = "") -> None:
        nonlocal shown
        # An update can cost more than the work that is counted.
        if time.monotonic() - shown > _PAUSE or done == total:
            shown = time.monotonic()
            bar.update(task, completed=done, detail=escape(detail))

    with bar:
        yield progress
