"""Checks of user input."""

import dataclasses
import difflib
import math
from types import UnionType
from typing import Any, ClassVar, get_args, get_origin

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from ._arithmetic import concrete, is_traced
from .settings import Limits, LongerThan, Setting, Settings

_MAX_SHOWN = 16
# Types whose values are shown. Others, such as random keys, have no readable value.
_NUMBERS = tuple(np.dtype(kind) for kind in ("bool", "int32", "int64", "uint32", "float32", "float64"))


class CheckedModule(eqx.Module):
    """A module that checks its fields when it is created.

    - `settings`: the settings that describe the fields. Their ranges are added to the module's docstring.
    - `part`: the path of the module within these settings, if the module is only a part of a larger one.

    **Raises** the errors of `check_settings`.
    """

    settings: ClassVar[type[Settings]] = Settings
    part: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        if "settings" in vars(cls):
            ranges = (f"    - `{field}`: {each.expected()}" for field, each in _fields(cls.settings, cls.part).values())
            heading = f"{cls.__doc__}\n    **Ranges**, beyond which it raises `ValueError`:\n"
            cls.__doc__ = "\n".join([heading, *ranges, "    "])

    def __check_init__(self):
        check_settings(self, self.part)
        self._check_rules()

    def _check_rules(self) -> None:
        """Rules between fields."""

    def __repr__(self) -> str:
        return shown_with_values(self)


def shown_with_values(module: eqx.Module) -> str:
    """The text of `module`, with its single numbers as numbers. Larger arrays, and traced ones, are shown by shape."""
    return eqx.tree_pformat(jax.tree.map(_as_shown, module))


def _as_shown(leaf: Any) -> Any:
    if not isinstance(leaf, jax.Array | np.ndarray | np.generic) or leaf.ndim or leaf.dtype not in _NUMBERS:
        return leaf
    # Donated buffers have no value any more.
    if isinstance(leaf, Tracer) or (isinstance(leaf, jax.Array) and leaf.is_deleted()):
        return leaf
    # Without digits beyond single precision.
    return float(f"{leaf:.7g}") if leaf.dtype == np.float32 else leaf.item()


def check_settings(module: Any, part: str = "") -> None:
    """Checks the fields of `module` that its `settings` describe.

    **Raises** `ValueError` for the first field with a known and invalid value.
    """
    settings, units = module.settings, module.settings.units(module)
    fields = _fields(settings, part)
    for key, (field, setting) in fields.items():
        check_value(f"{type(module).__name__}.{field}", getattr(module, field), setting, units.get(key))
    for low, high, *equal in settings.ascending:
        first, second = (fields[key][0] if key in fields else key for key in (low, high))
        check_order(module, first, second, bool(equal))


def _fields(settings: type[Settings], part: str) -> dict[str, tuple[str, Setting]]:
    """The field of each setting, by its key, for a module at `part`."""
    paths = {key: [path.rpartition(".") for path in each.paths(key)] for key, each in settings.each().items()}
    of = lambda key: next((field for holder, _, field in paths[key] if holder == part), None)
    return {key: (field, setting) for key, setting in settings.each().items() if (field := of(key)) is not None}


def check_order(module: Any, low: str, high: str, equal: bool = False) -> None:
    """**Raises** `ValueError` unless field `low` is less than `high`, or `equal` to it, if both are known."""
    a, b = (None if (value := getattr(module, name, None)) is None else concrete(value) for name in (low, high))
    if a is None or b is None:
        return
    # Rounded to the same precision: one may be a single-precision array, and the other a number.
    first, second = (number.astype(min(a.dtype, b.dtype)) for number in (a, b))
    if not (first <= second if equal else first < second):
        relation = "at most" if equal else "below"
        raise ValueError(f"{type(module).__name__}.{low} is {a} and {high} is {b}; expected {low} {relation} {high}")


def check_arguments(settings: type[Settings], **values: Any) -> None:
    """Checks arguments of a function by the keys of `settings`.

    **Raises** `ValueError` for the first invalid argument.
    """
    for key, value in values.items():
        check_value((*settings.each()[key].paths(key), key)[0], value, settings.each()[key])


def check_value(name: str, value: Any, setting: Setting | Any, unit: str | None = None) -> None:
    """Checks one value, unless it is traced.

    **Arguments:**

    - `setting`: the setting that describes the value, or its type with marks.
    - `unit`: replaces the setting's own unit.

    **Raises** `ValueError` for an invalid value.
    """
    setting = setting if isinstance(setting, Setting) else Setting.of(setting)
    unit = setting.unit if unit is None else unit
    entries = _entries(setting, value)
    if not (_allows(setting, value) if entries is None else _has_length(setting, entries)):
        words = [choice for choice in setting.choices if isinstance(choice, str)]
        near = difflib.get_close_matches(str(value).lower(), words, n=1) if isinstance(value, str) else []
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"{name} is {_shown(value)}; expected {setting.expected(unit)}{hint}")
    for i, entry in enumerate(entries or ()):
        check_value(f"{name}[{i}]", entry, setting.entry(i), unit)
    least = next((mark.length for mark in setting.marks if isinstance(mark, LongerThan)), None)
    is_known = entries is not None and all(concrete(entry) is not None for entry in entries)
    if least is not None and is_known and np.linalg.norm(np.asarray(entries, float)) < least:
        raise ValueError(f"{name} is {_shown(value)}; expected a vector at least {least:g} long")


def _entries(setting: Setting, value: Any) -> tuple[Any, ...] | None:
    """The entries of a known list, if lists are valid here."""
    if get_origin(setting.kind) is not tuple:
        return None
    if isinstance(value, tuple | list):
        return tuple(value)
    if isinstance(value, eqx.Module):
        return tuple(jax.tree.leaves(value))
    known = concrete(value) if hasattr(value, "shape") else None
    return tuple(known) if known is not None and known.ndim == 1 else None


def _has_length(setting: Setting, entries: tuple[Any, ...]) -> bool:
    kinds, lengths = get_args(setting.kind), setting.lengths
    if kinds[-1] is not Ellipsis:
        return len(entries) == len(kinds)
    return lengths.min_length <= len(entries) <= (len(entries) if lengths.max_length is None else lengths.max_length)


def _allows(setting: Setting, value: Any) -> bool:
    """Whether `value` is valid or traced."""
    if value is None:
        return setting.optional
    if setting.alternatives:
        return any(_allows(one, value) for one in setting.alternatives)
    if setting.choices:
        return any(type(value) is type(choice) and value == choice for choice in setting.choices)
    entries = _entries(setting, value)
    if entries is not None:
        return _has_length(setting, entries) and all(_allows(setting.entry(i), part) for i, part in enumerate(entries))
    if get_origin(setting.kind) is tuple:
        return hasattr(value, "shape") and concrete(value) is None
    if setting.kind is bool:
        return isinstance(value, bool | np.bool_)
    if setting.kind is int and (isinstance(value, bool) or not isinstance(value, int | np.integer)):
        return False
    known = concrete(value)
    return known is None or (known.shape == () and _is_within(known, setting.limits))


def _is_within(number: np.ndarray, limits: Limits) -> bool:
    if not (np.issubdtype(number.dtype, np.number) and np.isrealobj(number) and np.isfinite(number)):
        return False
    # Limits are rounded like the number.
    kind = number.dtype if np.issubdtype(number.dtype, np.floating) else None
    low, high = (None if end is None else np.asarray(end, kind).item() for end in (limits.low, limits.high))
    limits = Limits(low, high, limits.above_low, limits.below_high)
    return not (limits.undercut_by(number) or limits.exceeded_by(number))


def _shown(value: Any) -> str:
    if isinstance(value, tuple | list) and len(value) <= _MAX_SHOWN:
        return f"[{', '.join(map(_shown, value))}]"
    known = concrete(value) if hasattr(value, "shape") else None
    if known is None:
        return f"a list of {len(value)}" if isinstance(value, tuple | list) else repr(value)
    if known.size > _MAX_SHOWN:
        return f"an array of shape {known.shape}"
    return str(known) if known.ndim == 0 else listed(known)


def check_instance(name: str, value: Any, kind: type | UnionType, example: str) -> None:
    """**Raises** `TypeError` unless `value` is a `kind`. The message gives `example`."""
    if not isinstance(value, kind):
        given = f"the class {value.__name__}" if isinstance(value, type) else f"of type {type(value).__name__}"
        raise TypeError(f"{name} is {given}; expected {example}")


def check_outside_trace(name: str, expected: str, remedy: str, given: Any) -> None:
    """**Raises** `ValueError` if an array in `given` is traced. `name` is the function that received it."""
    if is_traced(given):
        raise ValueError(f"{name} was called inside jax.jit (or grad, or vmap); expected {expected}: {remedy}")


def check_points(name: str, points: Any) -> None:
    """**Raises** `ValueError` unless `points` is (n, 3) with at least one point."""
    if hasattr(points, "vertices"):
        raise ValueError(f"{name} are of type {type(points).__name__}; expected an array (n, 3): give its vertices")
    shape = np.shape(points)
    if len(shape) != 2 or shape[0] == 0 or shape[1] != 3:
        raise ValueError(f"{name} have shape {shape}; expected (n, 3), at least one point with x, y and z")


def as_tuple(value: Any) -> Any:
    """A list becomes a tuple, which can be a static part of a compiled program. Other values are returned unchanged."""
    return tuple(value) if isinstance(value, list) else value


def text_within(value: float, lower: float, upper: float, digits: int = 4) -> str:
    """The value of a parameter with these bounds, to the given number of digits. It gets more digits if it is far from
    0 and its bounds are close to each other."""
    beyond = abs(value) / (100 * (upper - lower))
    return f"{value:.{digits + (math.ceil(math.log10(beyond)) if beyond > 1 else 0)}g}"


def listed(values: Any) -> str:
    """`values` as text, without digits beyond single precision."""
    return str([float(f"{value:.7g}") for value in np.ravel(values)])


def check_again(tree: Any) -> None:
    """Repeats the checks of fields for all modules in `tree`.

    For modules whose fields were replaced, because a replacement is not checked. **Raises** the errors of the checks.
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
