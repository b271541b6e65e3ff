"""Compiled programs, shared by the fits of a process that differ in nothing but numbers."""

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
    """The program that `eqx.filter_jit` compiles from `function` for arguments of these shapes, types and static
    fields.

    The programs used last are kept.
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
    """Pauses the garbage collector. Nearly all of the objects that tracing makes stay, and searching through them again
    and again would take a fifth of its time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _kind(leaf: Any) -> Any:
    """What a program depends on: of an array its shape and type, and all of anything else."""
    if hasattr(leaf, "shape") and hasattr(leaf, "dtype"):
        return leaf.shape, str(leaf.dtype), getattr(leaf, "weak_type", False)
    return type(leaf), leaf
