"""Checks of values that users give."""

import dataclasses
import math
from typing import Any

import equinox as eqx
import numpy as np

from ._misc import concrete
from ._types import Scalar

MOST_PIXELS_ACROSS = 8192
"""The most pixels along a side of an image, or texels along a side of a map."""


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """**Raises** `ValueError` if `value` is not one of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} is {value!r}; expected one of {', '.join(choices)}")


def check_not_negative(name: str, value: Scalar | None, unit: str = "texels") -> None:
    """**Raises** `ValueError` if `value` is known, and negative or not finite."""
    known = None if value is None else concrete(value)
    if known is not None and not (known >= 0 and np.isfinite(known)):
        raise ValueError(f"{name} is {known}; expected 0 or more {unit}")


def check_instance(name: str, value: Any, kind: type, example: str) -> None:
    """**Raises** `TypeError` unless `value` is a `kind`, of which `example` names one."""
    if not isinstance(value, kind):
        given = f"the class {value.__name__}" if isinstance(value, type) else f"of type {type(value).__name__}"
        raise TypeError(f"{name} is {given}; expected {example}")


def check_vector(name: str, value: Any) -> None:
    """**Raises** `ValueError` unless `value` is three numbers."""
    if np.shape(value) != (3,):
        raise ValueError(f"{name} has shape {np.shape(value)}; expected (3,): x, y and z")


def check_points(name: str, points: Any) -> None:
    """**Raises** `ValueError` unless `points` is (n, 3), with one point or more."""
    if hasattr(points, "vertices"):
        raise ValueError(f"{name} are of type {type(points).__name__}; expected an array (n, 3): give its vertices")
    shape = np.shape(points)
    if len(shape) != 2 or shape[0] == 0 or shape[1] != 3:
        raise ValueError(f"{name} have shape {shape}; expected (n, 3), at least one point with x, y and z")


def check_resolution(name: str, resolution: Any) -> None:
    """**Raises** `ValueError` unless `resolution` is two integers from 1 to `MOST_PIXELS_ACROSS`."""
    is_pair = isinstance(resolution, tuple | list) and len(resolution) == 2
    if not is_pair or not all(isinstance(n, int | np.integer) and 1 <= n <= MOST_PIXELS_ACROSS for n in resolution):
        raise ValueError(
            f"{name} is {resolution!r}; expected (height, width), each an integer from 1 to {MOST_PIXELS_ACROSS}"
        )


def text_within(value: float, lower: float, upper: float, digits: int = 4) -> str:
    """The value of a parameter with these bounds, to so many digits, and to more where it is far from 0 and its bounds
    are close to each other."""
    beyond = abs(value) / (100 * (upper - lower))
    return f"{value:.{digits + (math.ceil(math.log10(beyond)) if beyond > 1 else 0)}g}"


def listed(values: Any) -> str:
    """`values` as text, without the digits that single precision does not have."""
    return str([float(f"{value:.7g}") for value in np.ravel(values)])


def check_again(tree: Any) -> None:
    """Repeats the checks that the modules in `tree` made of their fields as they were built.

    For modules whose fields were replaced, which checks nothing. **Raises** what the checks raise.
    """
    if isinstance(tree, eqx.Module):
        for own in type(tree).__mro__:
            vars(own).get("__check_init__", lambda module: None)(tree)
        tree = [getattr(tree, field.name) for field in dataclasses.fields(tree)]
    if isinstance(tree, dict):
        tree = list(tree.values())
    if isinstance(tree, list | tuple):
        for part in tree:
            check_again(part)
