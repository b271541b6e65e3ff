"""Sizes for padded arrays, so that inputs of similar size share compiled programs."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._device import is_on_gpu


def round_up_to_power_of_two(n: int) -> int:
    """The smallest power of two that is at least `n`; 0 stays 0."""
    return 0 if n <= 0 else 1 << (n - 1).bit_length()


# Sizes for small padded arrays.
_SMALL_SIZES = (256, 4096, 16384)


def shared_size(n: int) -> int:
    """A size of at least `n`, so that arrays of similar size share compiled programs: a few sizes for small arrays, and
    four sizes to each octave for large arrays, with less than a fifth of padding."""
    if n <= _SMALL_SIZES[-1]:
        return next(size for size in _SMALL_SIZES if n <= size)
    step = round_up_to_power_of_two(n) // 8
    return -(-n // step) * step


def shared_mesh_size(faces: int, vertices: int) -> tuple[int, int]:
    """The padded numbers of faces and vertices of a mesh. They have one common size if the vertices fit."""
    size = shared_size(faces)
    return size, size if vertices <= size else shared_size(vertices)


def padded_to(array: Any, size: int, value: Any = 0, axis: int = 0) -> Any:
    """`array` padded with `value` to `size` along an axis.

    On the host, which compiles nothing. An array on a GPU stays there: copies to the host and back take longer than to
    draw a mesh.
    """
    if isinstance(array, jax.Array) and is_on_gpu():
        return _padded_on_gpu(array, size, value, axis)
    return _padded(np, np.asarray(array), size, value, axis)


def _padded(xp: Any, array: Any, size: int, value: Any, axis: int) -> Any:
    shape = list(array.shape)
    shape[axis] = size - shape[axis]
    return xp.concatenate([array, xp.broadcast_to(xp.asarray(value, array.dtype), shape)], axis)


_padded_on_gpu = jax.jit(partial(_padded, jnp), static_argnums=(1, 3))
