"""Defers Ctrl-C while worker processes run, until they can be stopped cleanly."""

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import resource_tracker
from typing import Any

# Seconds between checks for Ctrl-C.
POLL = 0.1
# Seconds that processes get to exit: after normal completion, and after an interrupt.
_EXIT_TIMEOUT, _EXIT_TIMEOUT_INTERRUPTED = 30, 2


@contextmanager
def deferred_interrupts() -> Iterator[Callable[[], None]]:
    """Defers Ctrl-C in the block until it calls the yielded function, or ends.

    Otherwise Python raises `KeyboardInterrupt` between any two instructions of the main thread, also within
    libraries, which then stop half-way. The second Ctrl-C also kills the child processes; the third interrupts at once.
    Where Ctrl-C is ignored, as in background jobs of scripts, it stays so.
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
    """Enters and exits the context manager made by `opened` in a thread that does not receive Ctrl-C, and yields its
    value.

    Processes that the thread starts do not receive Ctrl-C either: a terminal sends the signal to all processes of a
    command, but threads and processes inherit blocked signals. Processes that do not exit in time are killed.

    **Arguments:**

    - `opened`: makes the context manager.
    - `interrupted`: called repeatedly while the context manager is entered. If it raises, the context manager is exited
        and the error is raised here.
    """
    # Started first, since starting it unblocks the signal in the calling thread.
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
    timeout = _EXIT_TIMEOUT_INTERRUPTED
    try:
        while not ready.wait(POLL):
            interrupted()
        if failed:
            raise failed[0]
        yield found[0]
        timeout = _EXIT_TIMEOUT
    finally:
        done.set()
        thread.join(timeout)
        if thread.is_alive():
            _kill_children()
            thread.join(timeout)


def _kill_children() -> None:
    for process in multiprocessing.active_children():
        process.kill()
