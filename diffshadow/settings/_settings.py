"""The parts of a class of settings: types, marks and defaults."""

import functools
import itertools
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, GroupedMetadata, Gt, Le, Len, Lt

MISSING: Any = object()
"""The default of a required setting."""


@dataclass(frozen=True)
class Limits(GroupedMetadata):
    """The limits of a number. `above_low` and `below_high` exclude the limits themselves."""

    low: int | float | None = None
    high: int | float | None = None
    above_low: bool = False
    below_high: bool = False

    def __iter__(self) -> Iterator[Any]:
        """The limits as pydantic reads them."""
        if self.low is not None:
            yield Gt(self.low) if self.above_low else Ge(self.low)
        if self.high is not None:
            yield Lt(self.high) if self.below_high else Le(self.high)

    @classmethod
    def of(cls, marks: Sequence[Any]) -> "Limits":
        """The tightest limits among `marks`."""
        low, high = cls(), cls()
        for mark in itertools.chain.from_iterable(each if isinstance(each, Limits) else (each,) for each in marks):
            match mark:
                case Ge(ge=bound) | Gt(gt=bound) if isinstance(bound, int | float):
                    if low.low is None or bound > low.low:
                        low = cls(low=bound, above_low=isinstance(mark, Gt))
                case Le(le=bound) | Lt(lt=bound) if isinstance(bound, int | float):
                    if high.high is None or bound < high.high:
                        high = cls(high=bound, below_high=isinstance(mark, Lt))
        return cls(low.low, high.high, low.above_low, high.below_high)

    @property
    def least(self) -> str:
        """The lower limit in words; empty if there is none."""
        return "" if self.low is None else f"{'greater than' if self.above_low else 'at least'} {_text(self.low)}"

    @property
    def most(self) -> str:
        """The upper limit in words; empty if there is none."""
        return "" if self.high is None else f"{'less than' if self.below_high else 'at most'} {_text(self.high)}"

    @property
    def words(self) -> str:
        """Both limits in words."""
        return " and ".join(filter(None, (self.least, self.most)))

    def undercut_by(self, value: Any) -> bool:
        """Whether `value` is below the lower limit."""
        return self.low is not None and bool(value <= self.low if self.above_low else value < self.low)

    def exceeded_by(self, value: Any) -> bool:
        """Whether `value` is above the upper limit."""
        return self.high is not None and bool(value >= self.high if self.below_high else value > self.high)


@dataclass(frozen=True)
class Unit:
    """The unit of a number."""

    name: str


@dataclass(frozen=True)
class Form:
    """How to write a value that is not a plain number, text or choice. `repeats` says whether one number may replace
    all."""

    words: str
    example: str = ""
    repeats: bool = False


@dataclass(frozen=True)
class Fitted:
    """Marks a setting as fittable: visibility has a gradient with respect to it, or a search finds it.

    - `searched`: whether a search finds it.
    - `needs_value`: whether it can only be fitted if it is set.
    """

    searched: bool = False
    needs_value: bool = False


@dataclass(frozen=True)
class At:
    """Dotted paths of a setting in its module, if they differ from its name. `At()` if the module has no such field."""

    paths: tuple[str, ...]

    def __init__(self, *paths: str):
        object.__setattr__(self, "paths", paths)


@dataclass(frozen=True)
class LongerThan:
    """The minimum length of a vector."""

    length: float


@dataclass(frozen=True)
class InputFile:
    """Marks the path of a file that a run reads. `builtin`: the prefix of paths that do not name a file, or empty."""

    builtin: str | None = None

    def names(self, path: Any) -> bool:
        """Whether `path` names a file."""
        is_path = isinstance(path, str) and bool(path)
        return is_path and (self.builtin is None or not path.startswith(self.builtin))


@dataclass(frozen=True)
class Setting:
    """One setting: its type, default, limits, unit and meaning.

    - `kind`: its type without marks; `marks`: limits, its unit and so on. Plain text among the marks is its meaning.
    - `default`: `MISSING` if it is required.
    - `optional`: whether `None` is valid.
    """

    kind: Any
    marks: tuple[Any, ...] = ()
    default: Any = MISSING
    optional: bool = False

    @classmethod
    def of(cls, annotation: Any, default: Any = MISSING, marks: Sequence[Any] = ()) -> "Setting":
        """The setting of a type with marks; `marks` are additional marks."""
        kind, own = bare(annotation)
        return cls(kind, (*own, *marks), default, _is_optional(annotation))

    @functools.cached_property
    def unit(self) -> str:
        """Its unit; empty if it has none."""
        return next((mark.name for mark in self.marks if isinstance(mark, Unit)), "")

    @property
    def is_fitted(self) -> bool:
        """Whether fits may change it."""
        return any(isinstance(mark, Fitted) for mark in self.marks)

    @property
    def meaning(self) -> str:
        """Its description; may be empty."""
        return next((mark for mark in self.marks if isinstance(mark, str)), "")

    @property
    def form(self) -> Form | None:
        """The form of its value in words, if the type does not say enough; otherwise `None`."""
        return next((mark for mark in self.marks if isinstance(mark, Form)), None)

    @property
    def limits(self) -> Limits:
        """Its limits."""
        return Limits.of(self.marks)

    @property
    def lengths(self) -> Len:
        """The number of entries that a list may have."""
        return next((mark for mark in self.marks if isinstance(mark, Len)), Len())

    @property
    def choices(self) -> tuple[Any, ...]:
        """Its choices; empty if it is not a choice."""
        return get_args(self.kind) if get_origin(self.kind) is Literal else ()

    @property
    def alternatives(self) -> tuple["Setting", ...]:
        """The kinds of value that it may have, if there are several."""
        return tuple(Setting.of(kind, marks=self.marks) for kind in get_args(self.kind)) if is_union(self.kind) else ()

    def entry(self, index: int) -> "Setting":
        """Entry `index` of a list."""
        kinds = get_args(self.kind)
        return Setting.of(kinds[0] if kinds[-1] is Ellipsis else kinds[index])

    def paths(self, key: str) -> tuple[str, ...]:
        """The path of the setting `key` in its module. The `type` that selects a class has no path."""
        return next((mark.paths for mark in self.marks if isinstance(mark, At)), () if key == "type" else (key,))

    def expected(self, unit: str | None = None) -> str:
        """The valid values, in plain words. `unit` replaces the setting's own unit."""
        unit = self.unit if unit is None else unit
        unit = f", in {unit}" if unit else ""
        if self.form is not None:
            return f"{self.form.words}{unit}"
        if self.choices:
            return " or ".join(filter(None, (", ".join(map(str, self.choices[:-1])), str(self.choices[-1]))))
        words = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
        return " ".join(filter(None, (words.get(self.kind, "a section"), self.limits.words))) + unit


class Settings:
    """The settings of one technique, filter, light or solver. Each annotation is a type with marks, and each value is a
    default.

    `ascending` names pairs of keys. The first must be less than the second, or at most equal to it if the pair ends in
    `True`.
    """

    ascending: ClassVar[tuple[tuple[str, str] | tuple[str, str, bool], ...]] = ()
    plugin: ClassVar[Any] = None
    """The user's class that it describes, or `None`."""

    @classmethod
    @functools.cache
    def each(cls) -> Mapping[str, Setting]:
        """Each setting by its key."""
        hints = get_type_hints(cls, include_extras=True)
        return {
            key: Setting.of(hint, getattr(cls, key, MISSING))
            for key, hint in hints.items()
            if get_origin(hint) is not ClassVar
        }

    def units(self) -> Mapping[str, str]:
        """Units that depend on other settings, by key."""
        return {}


def bare(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """The type in `annotation`, without marks and `None`; and the marks."""
    if get_origin(annotation) is Annotated:
        inside, *marks = get_args(annotation)
        kind, inner = bare(inside)
        return kind, (*marks, *inner)
    if is_union(annotation):
        others = [kind for kind in get_args(annotation) if kind is not types.NoneType]
        if len(others) == 1:
            return bare(others[0])
    return annotation, ()


def is_union(annotation: Any) -> bool:
    """Whether `annotation` is a union."""
    return get_origin(annotation) in (Union, types.UnionType)


def _is_optional(annotation: Any) -> bool:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return is_union(annotation) and any(kind is types.NoneType or _is_optional(kind) for kind in get_args(annotation))


def _text(limit: int | float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"
