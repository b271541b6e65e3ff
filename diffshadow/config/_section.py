"""What all sections of a configuration share: strictness, units, vectors, and checks across keys."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeGuard, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from ._errors import show

FAULT = "diffshadow"
"""The type of the errors that `fault` makes, among pydantic's own."""

Conflict = tuple[tuple[str | int, ...], PydanticCustomError]
"""A key inside a section, and what is wrong with it."""


@dataclass(frozen=True)
class Unit:
    """The unit of a number."""

    name: str


@dataclass(frozen=True)
class Form:
    """How a value that is no plain number, text or choice is written."""

    words: str


@dataclass(frozen=True)
class Fitted:
    """Says of a number that it has a gradient, so that a fit may change it.

    - `path`: dotted, to the number in the module that its section stands for; its key if left out.
    """

    path: str | None = None


def fault(given: str, expected: str, mend: str) -> PydanticCustomError:
    """An error of validation that says what was given, what was expected, and how to mend it."""
    words = {"given": given, "expected": expected, "mend": mend}
    return PydanticCustomError(FAULT, "{given}; expected {expected}; {mend}", words)


def _list_of(count: int, words: str, example: str) -> tuple[BeforeValidator, Form]:
    def as_tuple(value: Any) -> tuple[Any, ...]:
        if isinstance(value, list | tuple) and len(value) == count:
            return tuple(value)
        given = f"has {len(value)} entries" if isinstance(value, list | tuple) else f"is {show(value)}"
        raise fault(given, words, f"write a list such as {example}")

    return BeforeValidator(as_tuple), Form(words)


as_list = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)
"""Lets a tuple be written as YAML's list, which pydantic's strict mode refuses."""

Degrees = Annotated[float, Unit("degrees")]
WorldUnits = Annotated[float, Unit("world units")]
Texels = Annotated[float, Unit("texels")]
Share = Annotated[float, Field(ge=0, le=1)]

_XYZ = _list_of(3, "three numbers [x, y, z]", "[0, 1, 0]")
Position = Annotated[tuple[float, float, float], *_XYZ, Unit("world units")]
Direction = Annotated[tuple[float, float, float], *_XYZ]
Angles = Annotated[tuple[float, float, float], *_list_of(3, "three angles [x, y, z]", "[0, 90, 0]"), Unit("degrees")]
Colour = Annotated[
    tuple[Share, Share, Share], *_list_of(3, "three numbers [red, green, blue] from 0 to 1", "[0.8, 0.8, 0.8]")
]
_FACTOR = Annotated[float, Field(ge=0)]
Radiance = Annotated[
    tuple[_FACTOR, _FACTOR, _FACTOR],
    *_list_of(3, "a number, or three [red, green, blue], at least 0", "[0.8, 0.8, 0.8]"),
    # One number stands for all three.
    BeforeValidator(lambda value: (value,) * 3 if is_number(value) else value),
]
Pair = Annotated[tuple[float, float], *_list_of(2, "two numbers [factor, units]", "[1.1, 4]")]
Extent = Annotated[tuple[_FACTOR, _FACTOR], *_list_of(2, "two numbers [width, height], each at least 0", "[0.5, 0.5]")]
Count = Annotated[int, Field(ge=1, le=8192)]
Size = Annotated[tuple[Count, Count], *_list_of(2, "two whole numbers [height, width]", "[512, 512]")]


class Section(BaseModel):
    """A mapping of a configuration. Nothing is coerced, no key is ignored, and what is read never changes.

    A section that depends on several of its keys at once says so in `conflicts`, on the data as it was given, so
    that such faults are reported together with those of single keys.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """`data` with the defaults that depend on which other keys are given."""
        return data

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        """Faults that lie between keys of `data`, whose values may be of any type."""
        yield from ()

    def faults(self) -> Iterator[Conflict]:
        """Faults that lie between keys whose values are right by themselves."""
        yield from ()

    def units(self) -> Mapping[str, str]:
        """The units that depend on other keys of the section, by key."""
        return {}

    @model_validator(mode="wrap")
    @classmethod
    def _check_everything(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        faults: list[InitErrorDetails] = []
        if isinstance(data, Mapping):
            data = cls.completed(data)
            faults += [InitErrorDetails(type=what, loc=key, input=None) for key, what in cls.conflicts(data)]
        try:
            section = handler(data)
        except ValidationError as error:
            faults += [_again(details) for details in error.errors(include_url=False)]
        else:
            if not faults:
                faults += [InitErrorDetails(type=what, loc=key, input=None) for key, what in section.faults()]
            if not faults:
                return section
        raise ValidationError.from_exception_data(cls.__name__, faults)


def _again(error: Any) -> InitErrorDetails:
    context = error.get("ctx", {})
    kind = fault(**context) if error["type"] == FAULT else error["type"]
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"], ctx=context)


def by_type(default: str) -> Discriminator:
    """Tells the variants of a section apart by their key `type`, which is `default` where left out."""

    def kind(value: Any) -> str:
        return str(look(value, "type", default=default))

    return Discriminator(kind)


def type_of(section: type[Section]) -> str:
    """The word in `type` that selects this variant of a section."""
    return get_args(section.model_fields["type"].annotation)[0]


def variants_of(union: Any) -> dict[str, type[Section]]:
    """The variants of a section that `by_type` tells apart, by their `type`."""
    marked = get_args(get_args(union)[0])
    return {type_of(variant): variant for variant in (get_args(kind)[0] for kind in marked)}


def look(data: Any, *path: str, default: Any = None) -> Any:
    """The value at `path` of nested mappings or sections, or `default` where there is none."""
    for step in path:
        data = data.get(step) if isinstance(data, Mapping) else getattr(data, step, None)
    return default if data is None else data


def is_number(value: Any) -> TypeGuard[int | float]:
    """Whether `value` is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def given(data: Mapping[str, Any], *keys: str) -> list[str]:
    """Those of `keys` that `data` gives a value."""
    return [key for key in keys if data.get(key) is not None]


def exclusive(data: Mapping[str, Any], key: str, *others: str) -> Iterator[Conflict]:
    """A conflict for each of `others` that is given together with `key`."""
    if data.get(key) is None:
        return
    for other in given(data, *others):
        yield (
            (other,),
            fault(f"is given together with {key}", "one or the other", f"remove {other} or {key}, or set it to null"),
        )


def ordered(data: Mapping[str, Any], low: str, high: str) -> Iterator[Conflict]:
    """A conflict unless `low` is less than `high`, where both are given as numbers."""
    a, b = data.get(low), data.get(high)
    if is_number(a) and is_number(b) and not a < b:
        yield (
            (high,),
            fault(f"is {b} and {low} is {a}", f"{low} less than {high}", f"make {high} larger or {low} smaller"),
        )
