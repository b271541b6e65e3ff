"""A progress line for long work, in a terminal or a notebook."""

import html
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from ._progress import Update

# Seconds between updates in a notebook, where each update is a message.
_PAUSE = 0.1
# One line at a time: nested work is not shown.
_BUSY = threading.Lock()


@contextmanager
def display(name: str) -> Iterator[Update | None]:
    """Shows one line that is updated, and removed at the end. It goes to stderr, or below the notebook's cell.

    Nothing is shown in tests, or if stderr is neither a terminal nor a notebook.
    """
    show = _in_notebook if _is_notebook() else _in_terminal if _is_terminal() else None
    if show is None or not _BUSY.acquire(blocking=False):
        yield None
        return
    try:
        with show(name) as update:
            yield update
    finally:
        _BUSY.release()


def _is_notebook() -> bool:
    # Checked by name, so that IPython is not loaded.
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return type(shell).__name__ == "ZMQInteractiveShell"


def _is_terminal() -> bool:
    return "PYTEST_CURRENT_TEST" not in os.environ and sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def _in_terminal(name: str) -> Iterator[Update]:
    # Imported here, because it is slow to load and most processes show nothing.
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[detail]}"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task(escape(name), total=None, detail="")

    def update(detail: str, fraction: float | None) -> None:
        total = None if fraction is None else 1.0
        bar.update(task, detail=escape(detail), total=total, completed=fraction or 0.0)

    # The exit, also by Ctrl-C, removes the line and shows the cursor again.
    with bar:
        yield update


@contextmanager
def _in_notebook(name: str) -> Iterator[Update]:
    from IPython.display import HTML, display

    handle = display(HTML(_line(name, "", None)), display_id=True)
    assert handle is not None
    shown = time.monotonic()

    def update(detail: str, fraction: float | None) -> None:
        nonlocal shown
        if time.monotonic() - shown > _PAUSE:
            shown = time.monotonic()
            handle.update(HTML(_line(name, detail, fraction)))

    try:
        yield update
    finally:
        handle.update(HTML(""))


def _line(name: str, detail: str, fraction: float | None) -> str:
    value = "" if fraction is None else f' value="{fraction:.3f}"'
    return f"{html.escape(name)} <progress{value}></progress> {html.escape(detail)}"
