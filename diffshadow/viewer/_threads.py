"""Threads that work for pages."""

import atexit
import threading
from collections.abc import Callable


def start(work: Callable[[], None], stop: Callable[[], None], name: str) -> threading.Thread:
    """Starts a thread that calls `work`.

    When Python exits, it calls `stop` and waits for the thread. A thread that is killed in native code would end the
    process with an error.
    """

    def leave() -> None:
        stop()
        thread.join()

    def run() -> None:
        try:
            work()
        finally:
            atexit.unregister(leave)

    thread = threading.Thread(target=run, daemon=True, name=name)
    atexit.register(leave)
    thread.start()
    return thread
