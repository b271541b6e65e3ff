"""Axes: values of keys that a sweep's runs or a fit's views combine."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ...settings import Form, Limits, Unit
from ...settings.quantities import Degrees, Turn
from .._errors import KeyPath, dotted, show
from ._section import Conflict, Section, fault, is_number, value_at

LABEL = "label"
"""The key in an entry of `list` that names the entry; all others are set."""

Values = Annotated[tuple[Any, ...], Form("a list of values")]
_Hour = Annotated[float, Field(ge=0, le=24), Unit("hours")]
SUN = ("scene.light.azimuth", "scene.light.elevation")
"""The keys that `sun` sets."""


class QuasiRandomAxisConfig(Section):
    """The range of a key whose values come from a quasi-random sequence."""

    lower: Annotated[float, "least value"]
    upper: Annotated[float, "greatest value"]
    log: Annotated[bool, "whether values are spread evenly on a logarithmic scale"] = False
    integer: Annotated[bool, "whether values are rounded to whole numbers"] = False
    ascending = (("lower", "upper"),)

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        lower = data.get("lower")
        if data.get("log") is True and is_number(lower) and lower <= 0:
            yield ("lower",), fault(f"is {lower} on a logarithmic scale", "a number greater than 0", "raise it")


class QuasiRandomConfig(Section):
    """Quasi-random points in the box of several ranges."""

    sequence: Annotated[Literal["sobol", "halton"], "the sequence, scrambled"] = "sobol"
    count: Annotated[int, Unit("points"), Limits(1, 65536), "number of points"]
    seed: Annotated[int, Limits(0, 2**32, below_high=True), "seed of the scrambling"] = 0
    axes: Annotated[dict[str, QuasiRandomAxisConfig], "ranges, by dotted key"]

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        if data.get("axes") == {}:
            yield ("axes",), fault("is empty", "at least one key", "add 'bias.constant: {lower: 0, upper: 2}'")


class PathConfig(Section):
    """Points evenly spaced in time along paths, which lead from value to value in straight lines."""

    count: Annotated[int, Unit("points"), Limits(2, 65536), "number of points, both ends included"]
    through: Annotated[dict[str, Values], "values to pass in turn, numbers or lists of them, by dotted key"]

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        through = data.get("through")
        if through == {}:
            yield ("through",), fault("is empty", "at least one key", "add 'scene.camera.orbit.azimuth: [0, 90]'")
        for key, values in through.items() if isinstance(through, Mapping) else ():
            if not isinstance(values, list | tuple):
                continue
            rows = [value if isinstance(value, list | tuple) else [value] for value in values]
            if (
                len(rows) < 2
                or len({len(row) for row in rows}) > 1
                or not all(is_number(x) for row in rows for x in row)
            ):
                expected = "two or more numbers, or lists of as many numbers each"
                yield ("through", key), fault(f"is {show(values)}", expected, "write a list such as [0, 90, 180]")


class SunConfig(Section):
    """The sun over a day, by its declination and hour angle; +x is east and +z south."""

    count: Annotated[int, Unit("points"), Limits(1, 65536), "number of hours, evenly spaced"]
    latitude: Annotated[Degrees, Limits(-90, 90), "latitude, north positive, in degrees"] = 45.0
    day: Annotated[int, Limits(1, 366), "day of the year; 172 is the northern summer's solstice"] = 172
    first: Annotated[_Hour, "first hour, in solar time"] = 8.0
    last: Annotated[_Hour, "last hour, in solar time"] = 16.0
    turn: Annotated[Turn, "what is added to the azimuth, in degrees"] = 0.0
    ascending = (("first", "last"),)


class AxesConfig(Section):
    """Every combination of an entry of `list`, a value of each key of `grid`, a file of each key of `files`, a row of
    `zip`, a point of `path`, an hour of `sun` and a point of `qmc`. They are nested in this order."""

    # Where such a section stands.
    at: ClassVar[str] = "sweep"

    list: Annotated[
        Annotated[tuple[dict[str, Any], ...], Form("a list of sections of dotted keys")] | None,
        "sections of dotted keys to set together; label names one",
    ] = None
    grid: Annotated[dict[str, Values] | None, "values to combine, by dotted key"] = None
    files: Annotated[
        dict[str, str] | None, "patterns such as meshes/*.obj, whose files are combined in order, by dotted key"
    ] = None
    zip: Annotated[
        dict[str, Values] | None, "values to step through together, by dotted key; lists of equal length"
    ] = None
    path: Annotated[PathConfig | None, "points along paths, such as a camera's"] = None
    sun: Annotated[SunConfig | None, "azimuth and elevation of scene.light over a day"] = None
    qmc: Annotated[QuasiRandomConfig | None, "quasi-random points"] = None

    @property
    def axes(self) -> tuple[str, ...]:
        """The keys, once each, from slowest to fastest."""
        labels = any(LABEL in entry for entry in self.list or ())
        return tuple(dict.fromkeys([*([LABEL] if labels else []), *(key for _, key in settings_of(self.model_dump()))]))

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        settings = [*settings_of(data)]
        yield from cls.fixed(settings)
        yield from _set_twice(cls.at, settings)
        yield from _bad_lists(data)
        yield from _bad_labels(data)

    @classmethod
    def fixed(cls, settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
        """Faults of keys that must be the same everywhere."""
        yield from ()


def settings_of(data: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Every key that is set, in the order in which they are set, after its path in the section."""
    entries = data.get("list")
    for i, entry in enumerate(entries if isinstance(entries, list | tuple) else ()):
        yield from ((("list", i, key), key) for key in _keys(entry) if key != LABEL)
    for path in (("grid",), ("files",), ("zip",), ("path", "through")):
        yield from (((*path, key), key) for key in _keys(value_at(data, *path)))
    if isinstance(data.get("sun"), Mapping):
        yield from ((("sun",), key) for key in SUN)
    yield from ((("qmc", "axes", key), key) for key in _keys(value_at(data, "qmc", "axes")))
    yield from (((key,), "seed") for key in ("repeats", "seeds") if data.get(key) is not None)


def _keys(section: Any) -> list[str]:
    return [key for key in section if isinstance(key, str)] if isinstance(section, Mapping) else []


def _set_twice(at: str, settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
    """Faults of keys that would overwrite what an earlier key sets."""
    for i, (path, key) in enumerate(settings):
        for earlier, other in settings[:i]:
            # A run uses only one entry of the list, and `exclusive` reports repeats together with seeds.
            apart = path[0] == earlier[0] == "list" and path[1] != earlier[1]
            if apart or {path[0], earlier[0]} == {"repeats", "seeds"}:
                continue
            if other == key or other.startswith(f"{key}."):
                message = f"sets {key}, and {dotted((at, *earlier))} sets {other}"
                yield path, fault(message, "every value set once", "remove one of them")
                break


def _bad_lists(data: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of lists that are empty, repeat a value or differ in length."""
    rows: dict[KeyPath, Any] = {("list",): data.get("list"), ("seeds",): data.get("seeds")}
    for kind in ("grid", "zip"):
        rows |= {(kind, key): value_at(data, kind, key) for key in _keys(data.get(kind))}
    for path, values in rows.items():
        if not isinstance(values, list | tuple):
            continue
        if not values:
            yield path, fault("is an empty list", "at least one entry", "add one, or remove the key")
        twice = [text for text, count in Counter(map(repr, values)).items() if count > 1]
        if twice and path[0] != "zip":
            yield path, fault(f"holds {twice[0]} twice", "values that differ", "remove one of them")
    lengths = {path[1]: len(v) for path, v in rows.items() if path[0] == "zip" and isinstance(v, list | tuple)}
    for key, length in lengths.items():
        first, expected = next(iter(lengths.items()))
        if length != expected and length:
            message = f"has {length} values, and {first} has {expected}"
            yield ("zip", key), fault(message, "lists of equal length", "make them equally long, or use grid")


def _bad_labels(data: Mapping[str, Any]) -> Iterator[Conflict]:
    entries = data.get("list")
    entries = [e for e in entries if isinstance(e, Mapping)] if isinstance(entries, list | tuple) else []
    labels = [entry.get(LABEL) for entry in entries]
    for i, label in enumerate(labels):
        path = ("list", i, LABEL)
        if LABEL in entries[i] and not isinstance(label, str):
            yield path, fault(f"is {show(label)}", "text", "put it in quotes")
        elif isinstance(label, str) and not label.isprintable():
            yield path, fault(f"is {show(label)}", "text on one line", "remove the unprintable characters")
        elif LABEL not in entries[i] and any(other is not None for other in labels):
            yield ("list", i), fault("has no label, but others have one", "a label for all or none", "add one")
        elif label is not None and label in labels[:i]:
            yield path, fault(f"is {show(label)} again", "labels that differ", "change one of them")
