"""A fit that continues while pages open and close."""

import threading
from collections.abc import Callable
from typing import Any

from rich.console import Console

from .. import fit, study
from ..config import Config
from ._reasons import reason_of
from ._threads import start

# Significant digits of the values that a page shows.
_DIGITS = 8


class Fit:
    """Runs at most one fit, in its own thread.

    - `changed`: called with the latest news; `state` has all news.
    """

    def __init__(self, changed: Callable[[dict[str, Any]], None]):
        self.changed = changed
        self.state: dict[str, Any] = {"running": False}
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._number = 0

    def start(self, config: Config) -> int | None:
        """Starts a fit of `config`, unless one is running. **Returns** its number."""
        if self.state["running"]:
            return None
        self._number += 1
        self._stopping.clear()
        self.state = {"running": True, "number": self._number, "steps": [], "values": {}, "note": "drawing"}
        self.changed(self.state)
        self._thread = start(lambda: self._run(config), self.stop, "fitting")
        return self._number

    def stop(self) -> None:
        """Stops the fit after its current step."""
        self._stopping.set()

    def join(self) -> None:
        """Waits until no fit is running."""
        if self._thread is not None:
            self._thread.join()

    def _run(self, config: Config) -> None:
        progress, names = _Progress(self), list(config.fit.parameters)

        def on_step(step: fit.Step) -> None:
            self.go_on()
            values = {name: round(value, _DIGITS) for name, value in zip(names, step.values, strict=True)}
            self._tell(step={"phase": step.phase, "error": max(step.loss, 0.0) ** 0.5}, values=values)

        try:
            run = study.fit_technique(config, progress, on_step)
        except _StoppedError:
            self._tell(running=False, note="stopped; the sliders show its last values")
        except Exception as error:
            self._tell(running=False, error=reason_of(error))
        else:
            values = {name: float(f"{value:.{_DIGITS}g}") for name, value in run.result.fitted.items()}
            self._tell(running=False, note=run.verdict.sentence, values=values, done=True)

    def go_on(self) -> None:
        """**Raises** an error that ends the fit, if a stop was requested."""
        if self._stopping.is_set():
            raise _StoppedError

    def note(self, text: str) -> None:
        """Sets the note that the page shows about the fit."""
        self._tell(note=text)

    def _tell(self, step: dict[str, Any] | None = None, **news: Any) -> None:
        if step is not None:
            self.state["steps"].append(step)
        self.state |= news
        self.changed({"number": self._number, "running": self.state["running"], "step": step, **news})


class _StoppedError(Exception):
    """The fit was stopped by a page."""


class _Progress(study.Progress):
    """Progress of a fit. The page also shows its stages."""

    def __init__(self, fit: Fit):
        super().__init__(Console(quiet=True))
        self._fit, self._shown = fit, ""

    def show(self, name: str, detail: str = "", done: float | None = None) -> None:
        self._fit.go_on()
        super().show(name, detail, done)
        # Each step sends its own news.
        if name != self._shown:
            self._shown = name
            self._fit.note(name)
