"""What all sections of a configuration share: strictness, units, vectors, and checks across keys."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeGuard, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from .._errors import show

# More vertices than 32-bit integers count.
_LONGEST_INDEX = 10

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
    """Marks a number as fittable: visibility has a gradient with respect to it.

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

MOST_TEXELS = 8192
"""The most texels or pixels along a side of a map or an image. No filter or bias needs to reach further."""
FARTHEST = 1e9
"""The greatest coordinate and length, world units. Normals are cross products of edges, and their lengths are squared:
the fourth power of a length must stay within single precision, which ends at 3e38."""
SMALLEST = 1e-6
"""The least size of a mesh, world units: those same powers, of edges a thousandth as long, end at 1e-38."""
MOST_DEGREES = 3600.0
"""The greatest angle of a turn: ten turns. Single precision tells angles of this size to 0.0002 degrees."""
NARROWEST = 0.01
"""The least opening of a view, and the least by which one stays short of all that is ahead, degrees: its matrix holds
the tangent and one over it."""
# Colours are products of several factors, whose product must stay within single precision.
MOST_FACTOR = 1e6

# Pydantic obeys only one of two lower or upper limits: keys of these types give those that are missing here.
Degrees = Annotated[float, Unit("degrees")]
Turn = Annotated[float, Field(ge=-MOST_DEGREES, le=MOST_DEGREES), Unit("degrees")]
WorldUnits = Annotated[float, Field(le=FARTHEST), Unit("world units")]
Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST), Unit("world units")]
Texels = Annotated[float, Field(le=MOST_TEXELS), Unit("texels")]
# Farther off, a light or a camera is as good as infinitely far, and single precision sees no mesh.
Radii = Annotated[float, Field(le=1e4), Unit("radii")]
Share = Annotated[float, Field(ge=0, le=1)]

_XYZ = _list_of(3, "three numbers [x, y, z]", "[0, 1, 0]")
Position = Annotated[tuple[Coordinate, Coordinate, Coordinate], *_XYZ, Unit("world units")]
_Step = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]


def _not_zero(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    # Its length is found from squares.
    if math.hypot(*direction) < 1 / FARTHEST:
        expected = f"a vector at least {1 / FARTHEST:g} long"
        raise fault(f"is {show(direction)}", expected, "give a direction such as [0, -1, 0]")
    return direction


Direction = Annotated[tuple[_Step, _Step, _Step], *_XYZ, AfterValidator(_not_zero)]
Angles = Annotated[tuple[Turn, Turn, Turn], *_list_of(3, "three angles [x, y, z]", "[0, 90, 0]"), Unit("degrees")]
Colour = Annotated[
    tuple[Share, Share, Share], *_list_of(3, "three numbers [red, green, blue] from 0 to 1", "[0.8, 0.8, 0.8]")
]
Factor = Annotated[float, Field(ge=0, le=MOST_FACTOR)]
Radiance = Annotated[
    tuple[Factor, Factor, Factor],
    *_list_of(3, "a number, or three [red, green, blue], at least 0", "[0.8, 0.8, 0.8]"),
    # One number stands for all three.
    BeforeValidator(lambda value: (value,) * 3 if is_number(value) else value),
]
_Offset = Annotated[float, Field(ge=-MOST_FACTOR, le=MOST_FACTOR)]
Pair = Annotated[tuple[_Offset, _Offset], *_list_of(2, "two numbers [factor, units]", "[1.1, 4]")]
_Length = Annotated[float, Field(ge=0, le=FARTHEST)]
Extent = Annotated[tuple[_Length, _Length], *_list_of(2, "two numbers [width, height], each at least 0", "[0.5, 0.5]")]
Count = Annotated[int, Field(ge=1, le=MOST_TEXELS)]
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
                found = [*_beyond_single_precision(section), *section.faults()]
                faults += [InitErrorDetails(type=what, loc=key, input=None) for key, what in found]
            if not faults:
                return section
        raise ValidationError.from_exception_data(cls.__name__, faults)


# The range of numbers in single precision, in which all is computed; what is nearer to 0 is taken for 0.
_MOST, _LEAST = math.ldexp(2 - 2.0**-23, 127), math.ldexp(1, -126)


def _beyond_single_precision(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[Conflict]:
    """A fault for each number in `value` that single precision has not; sections inside it answer for themselves."""
    if isinstance(value, Section) and not path:
        entries: Any = ((key, getattr(value, key)) for key in type(value).model_fields)
    elif isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, list | tuple):
        entries = enumerate(value)
    else:
        if isinstance(value, int | float) and value and not _LEAST <= abs(value) <= _MOST:
            expected = f"0, or a number of a size from {_LEAST:.2g} to {_MOST:.2g}, as single precision has them"
            yield path, fault(f"is {show(value)}", expected, "check its exponent")
        return
    for step, entry in entries:
        yield from _beyond_single_precision(entry, (*path, step))


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
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    # An integer may be too large for `isfinite`.
    return isinstance(value, int) or math.isfinite(value)


def is_index(word: str) -> bool:
    """Whether `word` numbers an entry of a list, or a vertex."""
    return word.isascii() and word.isdigit() and len(word) <= _LONGEST_INDEX


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


def ordered(
    section: type[Section], data: Mapping[str, Any], low: str, high: str, *, equal: bool = False
) -> Iterator[Conflict]:
    """A conflict unless `low` is less than `high`, or `equal` to it, where both are numbers.

    They are those of `data`, and otherwise the defaults of `section`, which may be what a given number conflicts with.
    """
    fields = section.model_fields
    a, b = (data.get(key, fields[key].default if key in fields else None) for key in (low, high))
    if not (is_number(a) and is_number(b)) or a < b or (equal and a == b):
        return
    key, own, other, number = (low, a, high, b) if low in data and high not in data else (high, b, low, a)
    expected = f"{low} {'at most' if equal else 'less than'} {high}"
    yield (key,), fault(f"is {own} and {other} is {number}", expected, f"make {high} larger or {low} smaller")
