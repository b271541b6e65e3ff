"""The base of all sections of a configuration: strict validation, units, vectors, and checks across keys."""

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

# Enough digits for any 32-bit index.
_LONGEST_INDEX = 10

FAULT = "diffshadow"
"""The type of the errors made by `fault`, to tell them from pydantic's own."""

Conflict = tuple[tuple[str | int, ...], PydanticCustomError]
"""A key inside a section, and what is wrong with it."""


@dataclass(frozen=True)
class Unit:
    """The unit of a number."""

    name: str


@dataclass(frozen=True)
class Form:
    """How to write a value that is not a plain number, text or choice."""

    words: str


@dataclass(frozen=True)
class Fitted:
    """Marks a field as fittable: visibility has a gradient with respect to it, or a search finds it.

    - `path`: the dotted path of the number in the module that its section builds; by default its key.
    - `searched`: whether a search finds it.
    - `needs_value`: whether it can only be fitted if the key is set.
    """

    path: str | None = None
    searched: bool = False
    needs_value: bool = False


def fault(given: str, expected: str, mend: str) -> PydanticCustomError:
    """A validation error: what was given, what was expected, and how to mend it."""
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
"""Accepts a YAML list for a tuple, which pydantic's strict mode rejects."""

MOST_TEXELS = 8192
"""The most texels or pixels along a side of a map or an image. No filter or bias needs to reach farther."""
FARTHEST = 1e9
"""The greatest coordinate and length, in world units. Normals are cross products of edges, and their lengths are
squared, so the fourth power of a length must be representable in float32, which ends at 3e38."""
SMALLEST = 1e-6
"""The least size of a mesh, in world units: the fourth power of an edge a thousandth as long must exceed 1e-38."""
MOST_DEGREES = 3600.0
"""The greatest angle: ten turns. Float32 resolves angles of this size to 0.0002 degrees."""
NARROWEST = 0.01
"""The narrowest field of view, and the least by which one stays below 180 degrees, in degrees: the projection matrix
holds the tangent of the half angle and its reciprocal."""
# Colours are products of several factors, and must be representable in float32.
MOST_FACTOR = 1e6

# Pydantic applies only one of two lower or upper limits, so each field adds only limits that its type does not have.
Degrees = Annotated[float, Unit("degrees")]
Turn = Annotated[float, Field(ge=-MOST_DEGREES, le=MOST_DEGREES), Unit("degrees")]
WorldUnits = Annotated[float, Field(le=FARTHEST), Unit("world units")]
Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST), Unit("world units")]
Texels = Annotated[float, Field(le=MOST_TEXELS), Unit("texels")]
# Beyond this distance a mesh vanishes in the rounding of float32.
Radii = Annotated[float, Field(le=1e4), Unit("radii")]
Fraction = Annotated[float, Field(ge=0, le=1)]

_XYZ = _list_of(3, "three numbers [x, y, z]", "[0, 1, 0]")
Position = Annotated[tuple[Coordinate, Coordinate, Coordinate], *_XYZ, Unit("world units")]
_Step = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]


def _not_zero(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    # Normalizing it squares the components.
    if math.hypot(*direction) < 1 / FARTHEST:
        expected = f"a vector at least {1 / FARTHEST:g} long"
        raise fault(f"is {show(direction)}", expected, "give a direction such as [0, -1, 0]")
    return direction


Direction = Annotated[tuple[_Step, _Step, _Step], *_XYZ, AfterValidator(_not_zero)]
Angles = Annotated[tuple[Turn, Turn, Turn], *_list_of(3, "three angles [x, y, z]", "[0, 90, 0]"), Unit("degrees")]
Colour = Annotated[
    tuple[Fraction, Fraction, Fraction],
    *_list_of(3, "three numbers [red, green, blue] from 0 to 1", "[0.8, 0.8, 0.8]"),
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
    """A mapping in a configuration. Values are not coerced, unknown keys are errors, and sections are immutable.

    `conflicts` checks several keys against each other. It works on the data as given, so that its faults are reported
    together with those of single keys.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """`data` with the defaults that depend on other keys."""
        return data

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        """Faults between keys of `data`, whose values may have any type."""
        yield from ()

    def faults(self) -> Iterator[Conflict]:
        """Faults between keys that are valid on their own."""
        yield from ()

    def units(self) -> Mapping[str, str]:
        """Units that depend on other keys of the section, by key."""
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


# The range of normal float32 numbers, in which everything is computed. Numbers closer to 0 are flushed to 0.
_MOST, _LEAST = math.ldexp(2 - 2.0**-23, 127), math.ldexp(1, -126)


def _beyond_single_precision(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[Conflict]:
    """A fault for each number in `value` that float32 cannot represent. Inner sections check themselves."""
    if isinstance(value, Section) and not path:
        entries: Any = ((key, getattr(value, key)) for key in type(value).model_fields)
    elif isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, list | tuple):
        entries = enumerate(value)
    else:
        if isinstance(value, int | float) and value and not _LEAST <= abs(value) <= _MOST:
            expected = f"0, or a magnitude from {_LEAST:.2g} to {_MOST:.2g}, the range of single precision"
            yield path, fault(f"is {show(value)}", expected, "check its exponent")
        return
    for step, entry in entries:
        yield from _beyond_single_precision(entry, (*path, step))


def _again(error: Any) -> InitErrorDetails:
    context = error.get("ctx", {})
    kind = fault(**context) if error["type"] == FAULT else error["type"]
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"], ctx=context)


def by_type(default: str) -> Discriminator:
    """Selects the variant of a section by its key `type`, which defaults to `default`."""

    def kind(value: Any) -> str:
        return str(value_at(value, "type", default=default))

    return Discriminator(kind)


def type_of(section: type[Section]) -> str:
    """The word in `type` that selects this variant of a section."""
    return get_args(section.model_fields["type"].annotation)[0]


def variants_of(union: Any) -> dict[str, type[Section]]:
    """The variants of a section, by their `type`."""
    marked = get_args(get_args(union)[0])
    return {type_of(variant): variant for variant in (get_args(kind)[0] for kind in marked)}


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
    """Whether `word` is an index of a list entry or a vertex."""
    return word.isascii() and word.isdigit() and len(word) <= _LONGEST_INDEX


def given(data: Mapping[str, Any], *keys: str) -> list[str]:
    """Those of `keys` that have a value in `data`."""
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
