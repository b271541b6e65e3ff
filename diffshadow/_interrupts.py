"""Ctrl-C during native code. It must not be lost or become another error."""

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

# Seconds until a Ctrl-C without effect is repeated.
_INTERRUPT_INTERVAL = 0.2


@contextlib.contextmanager
def reported_interrupts() -> Iterator[None]:
    """Raises `KeyboardInterrupt` instead of the error that JAX makes from an interrupt in a callback. Only the text of
    this error mentions the interrupt."""
    try:
        yield
    except RuntimeError as error:
        if KeyboardInterrupt.__name__ in str(error):
            raise KeyboardInterrupt from error
        raise


@contextlib.contextmanager
def repeated_interrupts() -> Iterator[None]:
    """Repeats the `KeyboardInterrupt` of Ctrl-C until it has an effect.

    Python raises it at the current position of the main thread. A callback of the garbage collector drops it with a
    message. Native code that calls Python, such as Pydantic, may drop it silently.

    A shell starts the background jobs of a script with Ctrl-C ignored. It then stays ignored, as in other programs.
    SIGTERM ends these jobs.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        yield
        return

    def interrupt(*_: Any) -> None:
        signal.setitimer(signal.ITIMER_REAL, _INTERRUPT_INTERVAL)
        # The handling of the first interrupt must not be interrupted.
        error = sys.exception()
        while error is not None:
            if isinstance(error, KeyboardInterrupt):
                return
            error = error.__context__
        raise KeyboardInterrupt

    def report(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            others(unraisable)

    others, sys.unraisablehook = sys.unraisablehook, report
    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGALRM)}
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = others
