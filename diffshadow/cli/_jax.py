"""JAX, which commands start once their configuration has no mistakes."""

import os
import sys

from .._setup import setup


def start_jax() -> None:
    """Starts JAX's backend, with a cache of the programs that it compiles.

    **Raises** `ValueError` if it cannot run on the platforms that the environment names.
    """
    setup(cores=False, memory=False, collector=False, progress=False)
    platforms = os.environ.get("JAX_PLATFORMS")
    if not platforms:
        return
    import jax

    try:
        jax.devices()
    except (AssertionError, RuntimeError) as error:
        raise ValueError(
            f"JAX cannot run on JAX_PLATFORMS={platforms}; expected platforms whose plugins are installed, such as "
            "cpu: change it, or unset it"
        ) from error


def join_processes() -> None:
    """Makes this process one of several processes that share a fit through JAX. All but the first print only errors.

    **Raises** `ValueError` unless a launcher has started several processes.
    """
    import jax

    try:
        jax.distributed.initialize()
    except (ValueError, RuntimeError) as error:
        raise ValueError(
            f"JAX finds no other processes for --distributed ({str(error).rstrip('.')}); expected several that SLURM "
            "or Open MPI started, as by srun diffshadow fit CONFIG --distributed: leave it out, or start the processes "
            "in Python with jax.distributed.initialize"
        ) from error
    if jax.process_index() > 0:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
