"""Choices that depend on whether arrays are on a GPU."""

import jax


def is_on_gpu() -> bool:
    """Whether JAX's default backend is not the CPU. On a GPU, each step of a loop must start all of its kernels, and
    updates of the same address, such as additions, wait for each other."""
    return jax.default_backend() != "cpu"


def chunk_size(on_cpu: int, on_gpu: int) -> int:
    """The number of elements that a loop processes at a time. On a CPU, they fit into the cache; on a GPU, there are
    many more."""
    return on_gpu if is_on_gpu() else on_cpu
