"""How XLA compiles for the CPU."""

import os

_OPTIONS = "--xla_backend_extra_options"


def use_all_cores_in_loops() -> None:
    """Makes XLA keep the body of a loop as many programs, each of which runs on all cores.

    It would make one program, for one core, of every loop that it takes for small, and takes loops over whole images
    for such. It reads its flags as it starts, before the first computation: later this changes nothing. Options that
    are already given are left as they are.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _OPTIONS not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_OPTIONS}=xla_cpu_small_while_loop_byte_threshold=0".strip()
