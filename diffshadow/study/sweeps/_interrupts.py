"""Ctrl-C while other processes work: it waits for a place where they can be ended in order."""

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import resource_tracker
from typing import Any

# Seconds between looks at whether Ctrl-C was pressed.
POLL = 0.1
# Seconds that processes are given to end: where all is done, and where that is cut short.
_PATIENCE, _PATIENCE_CUT_SHORT = 30, 2


@contextmanager
def deferred_interrupts() -> Iterator[Callable[[], None]]:
    """Lets Ctrl-C interrupt the block only where it calls the function that it is given, and at its end.

    Python raises `KeyboardInterrupt` between any two instructions of the main thread, those of libraries included,
    which then stop half-way. Pressed twice, Ctrl-C also kills the processes that this one has started; the third time
    it interrupts at once.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        yield lambda: None
        return
    pressed = 0

    def press(*_: Any) -> None:
        nonlocal pressed
        pressed += 1
        if pressed == 2:
            _kill_children()
        elif pressed > 2:
            raise KeyboardInterrupt

    def interrupted() -> None:
        if pressed:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, press)
    try:
        yield interrupted
        interrupted()
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def out_of_reach(opened: Callable[[], AbstractContextManager[Any]], interrupted: Callable[[], None]) -> Iterator[Any]:
    """What `opened` gives, entered and left by a thread that does not receive Ctrl-C, nor do processes it starts.

    A terminal sends the signal to all processes of a command. Threads and processes inherit which signals are blocked.
    Processes that do not end in time are killed.

    **Arguments:**

    - `interrupted`: called while it is opened; what it raises is raised here once all is closed again.
    """
    # Its start unblocks the signal for the thread that starts it.
    resource_tracker.ensure_running()
    ready, done = threading.Event(), threading.Event()
    found, failed = [], []

    def serve() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with opened() as inside:
                found.append(inside)
                ready.set()
                done.wait()
        except BaseException as error:
            failed.append(error)
        finally:
            ready.set()

    thread = threading.Thread(target=serve, name="diffshadow pool", daemon=True)
    thread.start()
    patience = _PATIENCE_CUT_SHORT
    try:
        while not ready.wait(POLL):
            interrupted()
        if failed:
            raise failed[0]
        yield found[0]
        patience = _PATIENCE
    finally:
        done.set()
        thread.join(patience)
        if thread.is_alive():
            _kill_children()
            thread.join(patience)


def _kill_children() -> None:
    for process in multiprocessing.active_children():
        process.kill()
