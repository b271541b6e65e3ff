"""How Python and the C library manage memory."""

import atexit
import contextlib
import ctypes
import gc
import sys

# Parameters of glibc's mallopt(3).
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX = -1, -2, -4
_MOST = 2**31 - 1
# The size of a heap of any thread but the main one. An empty heap goes back to the system only if the padding fits into
# the heap before it. Padding of this size never does.
_HEAP = 64 << 20

# Of `gc.set_threshold`; Python 3.12 begins with (700, 10, 10).
_RARELY = (200_000, 20, 100)


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory for the next arrays; does nothing under other C libraries.

    Arrays of more than 32 MiB otherwise come from fresh pages each time, which the kernel clears one by one: drawing
    images of 2048 x 2048 pixels takes up to half as long again. The process's memory then stays at its peak. The
    command `diffshadow` calls this itself.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, _MOST)
        mallopt(_M_TOP_PAD, _HEAP)


def give_back_freed_memory() -> None:
    """Gives the system what glibc keeps of freed memory; does nothing under other C libraries.

    Threads have heaps of their own, whose freed parts lie between others. A process whose threads make arrays in turns
    otherwise grows for hours.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)


def collect_rarely() -> None:
    """Makes Python's garbage collector run less often.

    Imports and traces make millions of objects that stay. The collector otherwise looks through all of them again and
    again, which takes a sixth of the time of both. Arrays do not wait for it. As the process ends, the collector looks
    through nothing, which spares a second after a fit. The command `diffshadow` calls this itself.
    """
    gc.set_threshold(*_RARELY)
    atexit.register(gc.freeze)
