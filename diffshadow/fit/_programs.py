"""Compiled programs. Fits in a process share them if they differ only in numbers."""

import contextlib
import gc
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import jax

# A program of a phase takes some ten megabytes.
_MAX_PROGRAMS = 16

_PROGRAMS: OrderedDict[Any, Any] = OrderedDict()


def compiled(function: Any, arguments: tuple[Any, ...]) -> Any:
    """The program that `eqx.filter_jit` compiles from `function` for arguments with these shapes, types and static
    fields.

    The most recently used programs are kept.
    """
    leaves, tree = jax.tree.flatten(arguments)
    key = id(function), tree, tuple(map(_kind, leaves))
    program = _PROGRAMS.pop(key, None)
    if program is None:
        with _uncollected():
            lowered = function.lower(*arguments)
        program = lowered.compile()
    _PROGRAMS[key] = program
    while len(_PROGRAMS) > _MAX_PROGRAMS:
        _PROGRAMS.popitem(last=False)
    return program


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Pauses the garbage collector. Nearly all objects that tracing makes stay. Repeated searches through them would
    take a fifth of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _kind(leaf: Any) -> Any:
    """The key of a program: shape and type for an array, and the value for anything else."""
    if hasattr(leaf, "shape") and hasattr(leaf, "dtype"):
        return leaf.shape, str(leaf.dtype), getattr(leaf, "weak_type", False)
    return type(leaf), leaf
