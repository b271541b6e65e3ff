"""How XLA compiles for the CPU."""

import os
import sys
import warnings

_OPTIONS = "--xla_backend_extra_options"
# Bytes that a step of a small loop reads and writes. The largest loop that should be one program writes windows of 16 x
# 16 keys of 8 bytes (`raster/_windows.py`): 4.2 kB, both ways together.
_SMALL_LOOP = 5120


def use_all_cores() -> None:
    """Makes XLA run the body of a loop on all cores; it writes an option to `XLA_FLAGS` in the process's environment.

    XLA would make one program, for one core, of every loop that it takes for small, and takes loops over whole images
    for such. With the option it does so only where a step reads and writes less than 5 kB. It keeps the body of others
    as many programs, each of which runs on all cores. XLA reads its flags
    as JAX starts its backend, with the first array: call this before. Extra options that `XLA_FLAGS` already has are
    left as they are. The command `diffshadow` calls this itself.

    **Warns** with a `RuntimeWarning` if JAX's backend already runs: the option then has no effect in this process.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _OPTIONS in flags:
        return
    if _is_running():
        warnings.warn(
            "JAX's backend already runs, so XLA keeps the flags that it has read; expected no array before "
            "diffshadow.use_all_cores(): call it right after the imports",
            RuntimeWarning,
            stacklevel=2,
        )
        return
    os.environ["XLA_FLAGS"] = f"{flags} {_OPTIONS}=xla_cpu_small_while_loop_byte_threshold={_SMALL_LOOP}".strip()


def _is_running() -> bool:
    # Without loading JAX, which takes long; it has no public name for this.
    bridge = sys.modules.get("jax._src.xla_bridge")
    return getattr(bridge, "backends_are_initialized", lambda: False)()
