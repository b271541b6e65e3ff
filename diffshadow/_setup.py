"""One call that prepares a process for fast work."""

import os

from ._display import display
from ._memory import collect_rarely, keep_freed_memory
from ._progress import show_with
from ._xla import use_all_cores


def setup(
    *,
    cores: bool = True,
    memory: bool = True,
    collector: bool = True,
    programs: bool | str | os.PathLike[str] = True,
    progress: bool = True,
) -> None:
    """Prepares this process in the same way as the command `diffshadow`. Call it right after the imports.

    JAX reads some of these settings when it makes its first array. Importing the package changes no global state. Each
    part can be left out. A second call does no harm.

    **Arguments:**

    - `cores`: XLA runs loops on all cores, see `use_all_cores`.
    - `memory`: freed memory is kept for the next arrays, see `keep_freed_memory`.
    - `collector`: Python's garbage collector runs less often, see `collect_rarely`.
    - `programs`: compiled programs are kept for the next process, see `io.keep_compiled_programs`. Pass a folder to
      keep them there. This loads JAX.
    - `progress`: `fit.fit`, `fit.train` and `reference.trace_visibility` show their progress in one line, which is
      removed at the end. This works in notebooks, and if stderr is a terminal. To turn it off, call
      `setup(progress=False)` at any time, or set the environment variable `DIFFSHADOW_PROGRESS=0`. A call with your own
      `on_step`, `on_phase` or `progress` shows no line.

    **Warns** with a `RuntimeWarning` if JAX's backend already runs. `cores` then has no effect in this process.
    """
    if cores:
        use_all_cores()
    if memory:
        keep_freed_memory()
    if collector:
        collect_rarely()
    show_with(display if progress and os.environ.get("DIFFSHADOW_PROGRESS") != "0" else None)
    if programs is not False:
        # Loads JAX, which the other parts do not need.
        from .io import keep_compiled_programs

        keep_compiled_programs(None if programs is True else programs)
