"""Memory management of Python and the C library."""

import atexit
import contextlib
import ctypes
import gc
import sys
from pathlib import Path

# Parameters of glibc's mallopt(3).
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX = -1, -2, -4
_MOST = 2**31 - 1
# The size of a heap of any thread except the main one. An empty heap is returned to the system only if the padding fits
# into the heap before it. Padding of this size never fits.
_HEAP = 64 << 20

# For `gc.set_threshold`; the default of Python 3.12 is (700, 10, 10).
_RARELY = (200_000, 20, 100)

_MAPPINGS = Path("/proc/self/maps")
# Linux allows a process 65,530.
_MAX_MAPPINGS = 25_000


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory for the next arrays. Does nothing with other C libraries.

    Otherwise, arrays of more than 32 MiB come from fresh pages each time. The kernel clears these pages one by one, so
    drawing images of 2048 x 2048 pixels takes up to 1.5 times as long. With this call, the process's memory stays at
    its peak. The command `diffshadow` calls this itself.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, _MOST)
        mallopt(_M_TOP_PAD, _HEAP)


def give_back_freed_memory() -> None:
    """Returns freed memory that glibc keeps to the system. Does nothing with other C libraries.

    Each thread has its own heap, whose freed parts are fragmented. If several threads make arrays in turn, the process
    would otherwise grow for hours.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)


def collect_rarely() -> None:
    """Makes Python's garbage collector run less often.

    Imports and traces make millions of objects that stay. By default, the collector searches all of these objects
    repeatedly, which takes a sixth of the time of imports and traces. The memory of arrays is freed without the
    collector. At the end of the process, the collector does not run, which saves a second after a fit. The command
    `diffshadow` calls this itself.
    """
    gc.set_threshold(*_RARELY)
    atexit.register(gc.freeze)


def limit_programs() -> None:
    """Drops all compiled programs if they take much of the memory mappings that Linux allows a process.

    A fit with images of a new size compiles programs that take some 700 mappings and 28 MB. After a hundred sizes, LLVM
    is out of mappings, and the process ends with a segmentation fault. After a call, programs that are stored on disk
    are loaded again when they are needed. `fit.fit`, `fit.train` and sweeps call this themselves. Call it in your own
    loop if the loop draws images or maps of many different sizes. It does nothing on systems without `/proc`.
    """
    if _MAPPINGS.exists() and _MAPPINGS.read_bytes().count(b"\n") > _MAX_MAPPINGS:
        import jax

        jax.clear_caches()
        gc.collect()
