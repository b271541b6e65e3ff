"""Settings of XLA's compilation for the CPU."""

import os
import sys
import warnings
from pathlib import Path

_OPTIONS = "--xla_backend_extra_options"
# A loop is small if one step reads and writes fewer bytes than this. The largest loop that should be one program writes
# windows of 16 x 16 keys of 8 bytes (`raster/_windows.py`). It needs a limit between 4352 and 4608.
_SMALL_LOOP = 5120


def use_all_cores() -> None:
    """Makes XLA run the body of a loop on all cores, by an option in the environment variable `XLA_FLAGS`.

    XLA compiles every loop that it considers small to one program for one core, and wrongly considers loops over whole
    images small. With the option, XLA considers a loop small only if its steps read and write less than 5 kB. XLA keeps
    the body of other loops as many programs, and each program runs on all cores. XLA reads its flags when JAX makes its
    first array, so call this function before that. Options that `XLA_FLAGS` already has do not change. The command
    `diffshadow` calls this itself.

    **Warns** with a `RuntimeWarning` if JAX's backend already runs. The option then has no effect in this process.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _OPTIONS in flags:
        return
    if _is_running():
        warnings.warn(
            "JAX's backend already runs, so XLA keeps the flags that it has read; expected no array before "
            "diffshadow.setup() or use_all_cores(): call it right after the imports",
            RuntimeWarning,
            # The warning points to the user's line, whichever of the two functions the user calls.
            skip_file_prefixes=(str(Path(__file__).parent),),
        )
        return
    os.environ["XLA_FLAGS"] = f"{flags} {_OPTIONS}=xla_cpu_small_while_loop_byte_threshold={_SMALL_LOOP}".strip()


def _is_running() -> bool:
    # Does not load JAX, which is slow. JAX has no public name for this.
    bridge = sys.modules.get("jax._src.xla_bridge")
    return getattr(bridge, "backends_are_initialized", lambda: False)()
