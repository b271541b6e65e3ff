"""Compiled programs, shared by the fits of a process that differ in nothing but numbers."""

from collections import OrderedDict
from typing import Any

import jax

# A program of a phase takes some ten megabytes.
_MOST_PROGRAMS = 16

_PROGRAMS: OrderedDict[Any, Any] = OrderedDict()


def compiled(function: Any, arguments: tuple[Any, ...]) -> Any:
    """What `function`, by `eqx.filter_jit`, compiles to for arguments of these shapes, types and static fields.

    The programs used last are kept.
    """
    leaves, tree = jax.tree.flatten(arguments)
    key = id(function), tree, tuple(map(_kind, leaves))
    program = _PROGRAMS.pop(key, None)
    if program is None:
        program = function.lower(*arguments).compile()
    _PROGRAMS[key] = program
    while len(_PROGRAMS) > _MOST_PROGRAMS:
        _PROGRAMS.popitem(last=False)
    return program


def _kind(leaf: Any) -> Any:
    """What a program depends on: of an array its shape and type, and all of anything else."""
    if hasattr(leaf, "shape") and hasattr(leaf, "dtype"):
        return leaf.shape, str(leaf.dtype), getattr(leaf, "weak_type", False)
    return type(leaf), leaf
