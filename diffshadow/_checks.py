"""Checks of values that users give."""

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np

from ._misc import concrete
from ._types import Scalar


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """**Raises** `ValueError` if `value` is not one of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} is {value!r}; expected one of {', '.join(choices)}")


def check_not_negative(name: str, value: Scalar | None, unit: str = "texels") -> None:
    """**Raises** `ValueError` if `value` is known, and negative or not finite."""
    known = None if value is None else concrete(value)
    if known is not None and not (known >= 0 and np.isfinite(known)):
        raise ValueError(f"{name} is {known}; expected 0 or more {unit}")


def check_again(tree: Any) -> None:
    """Repeats the checks that the modules in `tree` made of their fields as they were built.

    For modules whose fields were replaced, which checks nothing. **Raises** what the checks raise.
    """
    if isinstance(tree, eqx.Module):
        for own in type(tree).__mro__:
            vars(own).get("__check_init__", lambda module: None)(tree)
        tree = [getattr(tree, field.name) for field in dataclasses.fields(tree)]
    parts = tree.values() if isinstance(tree, dict) else tree
    if isinstance(tree, dict | list | tuple):
        for part in parts:
            check_again(part)
