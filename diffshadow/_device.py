"""Choices that depend on whether arrays live on a GPU."""

import jax


def is_on_gpu() -> bool:
    """Whether JAX's default backend is not the CPU. On a GPU, each step of a loop costs the start of all its kernels,
    and updates of one place, such as additions, wait for each other."""
    return jax.default_backend() != "cpu"


def chunk_size(on_cpu: int, on_gpu: int) -> int:
    """How many elements a loop takes at a time: on a CPU as many as fit into its cache, on a GPU many more."""
    return on_gpu if is_on_gpu() else on_cpu
