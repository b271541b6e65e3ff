"""The base of all sections of a configuration: strict validation, variants, and rules between keys."""

import functools
import itertools
import math
import operator
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeGuard, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Tag,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import InitErrorDetails, PydanticCustomError, core_schema

from ...settings import Form, LongerThan, Settings, bare, is_union
from .._errors import KeyPath, show

if TYPE_CHECKING:
    from ._config import Config

# Enough digits for any 32-bit index.
_LONGEST_INDEX = 10

FAULT = "diffshadow"
"""The type of the errors made by `fault`, to distinguish them from pydantic's own."""

Conflict = tuple[KeyPath, PydanticCustomError]
"""The path of a key, and its fault."""


def fault(given: str, expected: str, mend: str) -> PydanticCustomError:
    """A validation error: the given value, the expected value, and the remedy."""
    words = {"given": given, "expected": expected, "mend": mend}
    return PydanticCustomError(FAULT, "{given}; expected {expected}; {mend}", words)


def marked(field: FieldInfo) -> tuple[Any, tuple[Any, ...]]:
    """The bare type of `field`, and all of its marks."""
    kind, marks = bare(field.annotation)
    inner = (mark.metadata if isinstance(mark, FieldInfo) else (mark,) for mark in (*field.metadata, *marks))
    return kind, tuple(itertools.chain.from_iterable(inner))


class Section(BaseModel, Settings):
    """A mapping in a configuration. Values are not coerced, unknown keys are errors, and sections are immutable.

    A section defines its rules:

    - `ascending`: keys whose values must increase. `exclusive`: a key, and others that cannot be given together with
      it. Both are checked together with single keys.
    - `faults`: faults between its keys, after each key is valid.
    - `faults_of_run`, `faults_of_fit`: faults between its keys and other sections, after all sections are valid.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    exclusive: ClassVar[tuple[tuple[str, ...], ...]] = ()

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """`data` with the defaults that depend on other keys. Values may have any type."""
        return data

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        """Faults of `data`, found before its keys are checked one by one. Its values may have any type."""
        yield from ()

    def faults(self) -> Iterator[Conflict]:
        """Faults between keys that are valid on their own. Paths are relative to the section."""
        yield from ()

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        """Faults between this section, at the path `at`, and other sections of `config`. Paths start at the root."""
        yield from ()

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        """Like `faults_of_run`, for faults that concern only a fit."""
        yield from ()

    def sections(self, at: KeyPath = ()) -> Iterator[tuple[KeyPath, "Section"]]:
        """This section, at the path `at`, and all sections within it, each with its path."""
        yield at, self
        yield from _sections_in(vars(self).items(), at)

    def with_value(self, path: Sequence[str | int], value: Any) -> Self:
        """This section with another `value` at a path. The value is not checked."""
        key = str(path[0])
        return changed(self, **{key: _with_value(getattr(self, key), path[1:], value)})

    @model_validator(mode="wrap")
    @classmethod
    def _check_everything(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        faults: list[InitErrorDetails] = []
        if isinstance(data, Mapping):
            data = cls.completed(data)
            found = [*_out_of_order(cls, data), *_given_together(cls, data), *cls.conflicts(data)]
            faults += [InitErrorDetails(type=what, loc=key, input=None) for key, what in found]
            # YAML has lists where the sections have tuples, and pydantic's strict mode rejects lists.
            lists = {key: data[key] for key in _lists(cls) if key in data}
            data = {**data, **{key: _as_tuple(value, *_lists(cls)[key]) for key, value in lists.items()}}
        section, single = None, []
        try:
            section = handler(data)
            found = [*_beyond_single_precision(vars(section).items()), *_too_short(section)] or [*section.faults()]
        except ValidationError as error:
            single = error.errors(include_url=False)
            found = _faults_of_rest(cls, data, [each["loc"] for each in single])
        faults += [InitErrorDetails(type=what, loc=key, input=None) for key, what in found]
        faults += _merged(cls, data, map(_again, single))
        if faults:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        return section


def _faults_of_rest(section: type[Section], data: Any, invalid: Iterable[KeyPath]) -> Iterator[Conflict]:
    """The faults between the valid keys of a section, which is checked without its `invalid` keys."""
    if isinstance(data, Mapping):
        rest = unchecked(section, data)
        for location in invalid:
            _drop(rest, location)
        # The rules end at the first one that needs an invalid key.
        with suppress(AttributeError):
            yield from rest.faults()


def _drop(value: Any, location: KeyPath) -> None:
    """Removes a key from a section. Pydantic's locations contain the names of variants between keys."""
    holder: dict[Any, Any] = {}
    last = None
    for step in location:
        if isinstance(value, Section):
            holder, last = vars(value), step
            value = holder.get(step, value)
        elif isinstance(value, Mapping):
            value = value.get(step)
        elif isinstance(value, tuple):
            value = value[step] if isinstance(step, int) and step < len(value) else None
    holder.pop(last, None)


def _sections_in(entries: Iterable[tuple[str | int, Any]], at: KeyPath) -> Iterator[tuple[KeyPath, Section]]:
    for step, value in entries:
        if value is None or isinstance(value, str | int | float):
            continue
        if isinstance(value, tuple | list | dict):
            inner = value.items() if isinstance(value, dict) else enumerate(value)
            yield from _sections_in(inner, (*at, step))
        elif isinstance(value, Section):
            yield from value.sections((*at, step))


def _with_value(holder: Any, path: Sequence[str | int], value: Any) -> Any:
    if not path:
        return value
    if isinstance(holder, Section):
        return holder.with_value(path, value)
    at = int(path[0])
    return (*holder[:at], _with_value(holder[at], path[1:], value), *holder[at + 1 :])


def frozen(value: Any) -> Hashable:
    """A key for caches that differs between sections, and between lists and mappings of sections."""
    if isinstance(value, Section):
        return type(value), *(frozen(getattr(value, key)) for key in type(value).model_fields)
    if isinstance(value, Mapping):
        return tuple((key, frozen(entry)) for key, entry in value.items())
    return tuple(map(frozen, value)) if isinstance(value, list | tuple) else value


# The range of normal float32 numbers, in which everything is computed. Numbers closer to 0 are flushed to 0.
_MOST, _LEAST = math.ldexp(2 - 2.0**-23, 127), math.ldexp(1, -126)


def _beyond_single_precision(
    entries: Iterable[tuple[str | int, Any]], path: tuple[str | int, ...] = ()
) -> Iterator[Conflict]:
    """A fault for each number in `entries` that float32 cannot represent. Inner sections check themselves."""
    for step, value in entries:
        # First, because most values are numbers, and searching for mappings is slow.
        if value is None or isinstance(value, str | Section):
            continue
        if isinstance(value, int | float):
            if value and not _LEAST <= abs(value) <= _MOST:
                expected = f"0, or a magnitude from {_LEAST:.2g} to {_MOST:.2g}, the range of single precision"
                yield (*path, step), fault(f"is {show(value)}", expected, "check its exponent")
        elif isinstance(value, list | tuple):
            yield from _beyond_single_precision(enumerate(value), (*path, step))
        elif isinstance(value, Mapping):
            yield from _beyond_single_precision(value.items(), (*path, step))


@functools.cache
def _lists(section: type[Section]) -> dict[str, tuple[Any, tuple[Any, ...]]]:
    """The type and the marks of each key that may be a list."""
    fields = {key: marked(field) for key, field in section.model_fields.items()}
    has = lambda kind: get_origin(kind) is tuple or any(has(bare(inner)[0]) for inner in get_args(kind))
    return {key: (kind, marks) for key, (kind, marks) in fields.items() if has(kind)}


def _too_short(section: Section) -> Iterator[Conflict]:
    """A fault for each vector that is too short."""
    for key, (least, example) in _lengths(type(section)).items():
        vector = getattr(section, key)
        if vector is not None and math.hypot(*vector) < least:
            mend = f"give a vector such as {example}"
            yield (key,), fault(f"is {show(vector)}", f"a vector at least {least:g} long", mend)


@functools.cache
def _lengths(section: type[Section]) -> dict[str, tuple[float, Any]]:
    """The minimum length of each vector that has one, and an example of it."""
    found = {}
    for key, (_, marks) in _lists(section).items():
        for mark in marks:
            if isinstance(mark, LongerThan) and mark.length:
                found[key] = mark.length, next(form.example for form in marks if isinstance(form, Form))
    return found


def _out_of_order(section: type[Section], data: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of keys that should be in ascending order."""
    for low, high, *equal in section.ascending:
        yield from ordered(section, data, low, high, equal=bool(equal))


def _given_together(section: type[Section], data: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of keys that exclude each other."""
    for key, *others in section.exclusive:
        for other in given(data, *others) if given(data, key) else ():
            mend = f"remove {other} or {key}, or set it to null"
            yield (other,), fault(f"is given together with {key}", "one or the other", mend)


def _as_tuple(value: Any, kind: Any, marks: Sequence[Any] = ()) -> Any:
    """`value` with tuples instead of lists where `kind` has tuples of this length. Other lists do not change; they are
    mistakes."""
    if is_union(kind):
        return next((_as_tuple(value, each) for each in get_args(kind) if get_origin(each) is tuple), value)
    if get_origin(kind) is dict and isinstance(value, Mapping):
        return {key: _as_tuple(entry, *bare(get_args(kind)[1])) for key, entry in value.items()}
    if get_origin(kind) is not tuple:
        return value
    kinds = get_args(kind)
    if any(isinstance(mark, Form) and mark.repeats for mark in marks) and is_number(value):
        return (value,) * len(kinds)
    if not isinstance(value, list | tuple):
        return value
    if kinds[-1] is Ellipsis:
        return tuple(_as_tuple(entry, *bare(kinds[0])) for entry in value)
    return (tuple if len(value) == len(kinds) else list)(value)


def _merged(section: type[Section], data: Any, faults: Iterable[InitErrorDetails]) -> Iterator[InitErrorDetails]:
    """`faults`, with a single fault for each value that may have several forms, such as a word or a list of words,
    instead of one for each form."""
    seen: set[str | int] = set()
    for each in faults:
        key = next(iter(each.get("loc", ())), "")
        if key not in _of_several_forms(section):
            yield each
        elif key not in seen:
            seen.add(key)
            # The words of this type of error are never shown.
            yield InitErrorDetails(type="literal_error", loc=(key,), input=data[key], ctx={"expected": ""})


@functools.cache
def _of_several_forms(section: type[Section]) -> frozenset[str]:
    """The keys of values that may have several forms."""
    return frozenset(key for key, field in section.model_fields.items() if is_union(marked(field)[0]))


def _again(error: Any) -> InitErrorDetails:
    context = error.get("ctx", {})
    kind = fault(**context) if error["type"] == FAULT else error["type"]
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"], ctx=context)


class Variants:
    """The variants of a section, selected by the key `type`: one for each subclass of `base` that has a `type`.

    Sections written by hand add rules between keys. The other sections are made here, in the namespace of `module`.
    Sections of users' classes are added when a configuration names them, and are not offered as choices to other
    configurations.
    """

    def __init__(self, base: type[Settings], default: str, module: str):
        self.default = default
        self.sections: dict[str, type[Section]] = {}
        """Each variant by its `type`."""
        self.plugins: dict[str, type[Section]] = {}
        """The sections of users' classes, by `module:name`."""
        for settings in _below(base):
            if "type" in vars(settings) and not issubclass(settings, Section):
                self.sections[vars(settings)["type"]] = _section_of(settings, module)

    def make(self) -> Any:
        """The default section."""
        return self.sections[self.default]()

    def add(self, settings: type[Settings]) -> None:
        """Adds the section of a user's class."""
        self.plugins[vars(settings)["type"]] = _made(settings, settings.__module__)

    def named(self, word: Any) -> type[Section] | None:
        """The variant whose `type` is `word`, if there is one."""
        return self.sections.get(word) or self.plugins.get(word)

    def of(self, data: Any) -> type[Section]:
        """The variant that `data` names, or the default variant if it does not exist. The fault is reported
        elsewhere."""
        return self.named(str(value_at(data, "type", default=self.default))) or self.sections[self.default]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """The type for pydantic's validation."""
        kind = lambda value: str(value_at(value, "type", default=self.default))
        tagged = [Annotated[section, Tag(word)] for word, section in self.sections.items()]
        own = handler.generate_schema(Annotated[functools.reduce(operator.or_, tagged), Discriminator(kind)])
        return core_schema.no_info_wrap_validator_function(self._validated, own)

    def _validated(self, data: Any, handler: Callable[[Any], Any]) -> Any:
        """The section of `data`, possibly of a user's class."""
        word = str(value_at(data, "type", default=self.default))
        section = self.plugins.get(word)
        if section is None or isinstance(data, section):
            return data if section is not None else handler(data)
        try:
            return section.model_validate(data)
        except ValidationError as error:
            # As in a union, the location begins with the variant.
            faults = [_again(details) for details in error.errors(include_url=False)]
            faults = [{**each, "loc": (word, *each.get("loc", ()))} for each in faults]
            raise ValidationError.from_exception_data(section.__name__, faults) from None


def _below(base: type[Settings]) -> Iterator[type[Settings]]:
    for inner in base.__subclasses__():
        yield inner
        yield from _below(inner)


def _section_of(settings: type[Settings], module: str) -> type[Section]:
    for inner in _below(settings):
        if issubclass(inner, Section):
            return inner
    made = _made(settings, module)
    # Pickle finds the class by this name.
    setattr(sys.modules[module], made.__name__, made)
    return made


def _made(settings: type[Settings], module: str) -> type[Section]:
    # Rules for several classes are written once, in the section of their common base.
    shared = (each for base in settings.__mro__[1:] if "type" not in vars(base) for each in base.__subclasses__())
    bases: Any = (next((each for each in shared if issubclass(each, Section)), Section), settings)
    made: Any = create_model(f"{settings.__name__}Config", __base__=bases, __module__=module, __doc__=settings.__doc__)
    return made


def changed[S](section: S, **values: Any) -> S:
    """`section` with other `values`. They are not checked."""
    assert isinstance(section, Section)
    return section.model_copy(update=values)


def settings_of(section: type[Section]) -> type[Settings]:
    """The settings of a section with several variants."""
    return next(each for each in section.__mro__ if "type" in vars(each) and not issubclass(each, Section))


def type_of(section: type[Section]) -> str:
    """The word in `type` that selects this variant of a section."""
    return section.model_fields["type"].default


def unchecked(section: type[Section], data: Any) -> Any:
    """A section of `data` whose values may have any type. Anything except a mapping counts as empty."""
    given = section.completed(data if isinstance(data, Mapping) else {})
    slots = {key: (field, *marked(field)) for key, field in section.model_fields.items()}
    values = {
        key: _unchecked(kind, marks, given.get(key))
        for key, (field, kind, marks) in slots.items()
        if given.get(key) is not None or field.is_required()
    }
    return section.model_construct(**values)


def _unchecked(kind: Any, marks: Sequence[Any], data: Any) -> Any:
    for mark in marks:
        if isinstance(mark, Variants):
            return unchecked(mark.of(data), data)
    if isinstance(kind, type) and issubclass(kind, Section):
        return unchecked(kind, data)
    if get_origin(kind) is tuple:
        entry = bare(get_args(kind)[0])
        return tuple(_unchecked(*entry, each) for each in data) if isinstance(data, list | tuple) else ()
    if get_origin(kind) is dict and isinstance(data, Mapping):
        entry = bare(get_args(kind)[1])
        return {key: _unchecked(*entry, each) for key, each in data.items()}
    return data


def value_at(data: Any, *path: str, default: Any = None) -> Any:
    """The value at `path` in nested mappings or sections, or `default` if there is none."""
    for step in path:
        data = data.get(step) if isinstance(data, Mapping) else getattr(data, step, None)
    return default if data is None else data


def is_number(value: Any) -> TypeGuard[int | float]:
    """Whether `value` is a finite number."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    # An integer may be too large for `isfinite`.
    return isinstance(value, int) or math.isfinite(value)


def is_index(word: str) -> bool:
    """Whether `word` is the index of a list entry or a vertex."""
    return word.isascii() and word.isdigit() and len(word) <= _LONGEST_INDEX


def given(data: Mapping[str, Any], *keys: str) -> list[str]:
    """The `keys` that have a value in `data`."""
    return [key for key in keys if data.get(key) is not None]


def ordered(
    section: type[Section], data: Mapping[str, Any], low: str, high: str, *, equal: bool = False
) -> Iterator[Conflict]:
    """A conflict unless `low` is less than `high`, or `equal` to it if that is allowed.

    Values missing from `data` are taken from the defaults of `section`. Values that are not numbers are not compared.
    """
    fields = section.model_fields
    a, b = (data.get(key, fields[key].default if key in fields else None) for key in (low, high))
    if not (is_number(a) and is_number(b)) or a < b or (equal and a == b):
        return
    key, own, other, number = (low, a, high, b) if low in data and high not in data else (high, b, low, a)
    expected = f"{low} {'at most' if equal else 'less than'} {high}"
    yield (key,), fault(f"is {own} and {other} is {number}", expected, f"make {high} larger or {low} smaller")
