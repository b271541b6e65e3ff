"""How Python and the C library manage memory."""

import atexit
import contextlib
import ctypes
import gc
import sys
from pathlib import Path

# Parameters of glibc's mallopt(3).
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX = -1, -2, -4
_MOST = 2**31 - 1
# The size of a heap of any thread but the main one. An empty heap goes back to the system only if the padding fits into
# the heap before it. Padding of this size never does.
_HEAP = 64 << 20

# Of `gc.set_threshold`; Python 3.12 begins with (700, 10, 10).
_RARELY = (200_000, 20, 100)

_MAPPINGS = Path("/proc/self/maps")
# Linux allows a process 65,530.
_MAX_MAPPINGS = 25_000


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory for the next arrays; does nothing under other C libraries.

    Otherwise arrays of more than 32 MiB come from fresh pages each time. The kernel clears these pages one by one, so
    drawing images of 2048 x 2048 pixels takes up to 1.5 times as long. The process's memory then stays at its peak. The
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

    Imports and traces make millions of objects that stay. Otherwise the collector searches all of these objects
    repeatedly, which takes a sixth of the time of imports and traces. The memory of arrays is freed without the
    collector. At the end of the process, the collector does not run, which saves a second after a fit. The command
    `diffshadow` calls this itself.
    """
    gc.set_threshold(*_RARELY)
    atexit.register(gc.freeze)


def limit_programs() -> None:
    """Drops all compiled programs if they take much of the memory mappings that Linux allows a process.

    A fit with images of a new size compiles programs that take some 700 mappings and 28 MB. After a hundred sizes, LLVM
    is out of mappings, and the process ends with a segmentation fault. Programs that are used again after a call load
    from the disk if they are kept there. `fit.fit`, `fit.train` and sweeps call this themselves. Call it in a loop of
    your own that draws images or maps of ever new sizes. It does nothing where the system has no `/proc`.
    """
    if _MAPPINGS.exists() and _MAPPINGS.read_bytes().count(b"\n") > _MAX_MAPPINGS:
        import jax

        jax.clear_caches()
        gc.collect()
