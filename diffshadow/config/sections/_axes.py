"""Axes: values of keys that a sweep's runs or a fit's views combine."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ...settings import Form, Limits, Unit
from ...settings.quantities import Degrees, Turn
from .._errors import KeyPath, dotted, show
from ._section import Conflict, Section, fault, is_number

LABEL = "label"
"""The key of an entry of `list` that names the entry. All other keys are set."""

Values = Annotated[tuple[Any, ...], Form("a list of values")]
_Hour = Annotated[float, Field(ge=0, le=24), Unit("hours")]
SUN = ("scene.light.azimuth", "scene.light.elevation")
"""The keys that `sun` sets."""
_OF_A_VIEW = ("scene", "reference", "shadow_map.resolution")


class QuasiRandomAxisConfig(Section):
    """The range of a key whose values come from a quasi-random sequence."""

    lower: Annotated[float, "least value"]
    upper: Annotated[float, "greatest value"]
    log: Annotated[bool, "whether values are spread evenly on a logarithmic scale"] = False
    integer: Annotated[bool, "whether values are rounded to whole numbers"] = False
    ascending = (("lower", "upper"),)

    def faults(self) -> Iterator[Conflict]:
        if self.log and self.lower <= 0:
            message = f"is {self.lower:g} on a logarithmic scale"
            yield ("lower",), fault(message, "a number greater than 0", "raise it")


class QuasiRandomConfig(Section):
    """Quasi-random points in the box of several ranges."""

    sequence: Annotated[Literal["sobol", "halton"], "the sequence, scrambled"] = "sobol"
    count: Annotated[int, Unit("points"), Limits(1, 65536), "number of points"]
    seed: Annotated[int, Limits(0, 2**32, below_high=True), "seed of the scrambling"] = 0
    axes: Annotated[dict[str, QuasiRandomAxisConfig], "ranges, by dotted key"]

    def faults(self) -> Iterator[Conflict]:
        if not self.axes:
            yield ("axes",), fault("is empty", "at least one key", "add 'bias.constant: {lower: 0, upper: 2}'")


class PathConfig(Section):
    """Points evenly spaced in time along paths, with straight lines between the values."""

    count: Annotated[int, Unit("points"), Limits(2, 65536), "number of points, both ends included"]
    through: Annotated[
        dict[str, Values], "values along the path, in order: numbers, or lists of numbers, by dotted key"
    ]

    def faults(self) -> Iterator[Conflict]:
        if not self.through:
            yield ("through",), fault("is empty", "at least one key", "add 'scene.camera.orbit.azimuth: [0, 90]'")
        for key, values in self.through.items():
            rows = [value if isinstance(value, list | tuple) else [value] for value in values]
            is_even = len(rows) > 1 and len({len(row) for row in rows}) == 1
            if not (is_even and all(is_number(x) for row in rows for x in row)):
                expected = "two or more numbers, or lists of equal length"
                yield ("through", key), fault(f"is {show(values)}", expected, "write a list such as [0, 90, 180]")


class SunConfig(Section):
    """The sun's directions over a day, from its declination and hour angle; +x is east and +z is south."""

    count: Annotated[int, Unit("points"), Limits(1, 65536), "number of hours, evenly spaced"]
    latitude: Annotated[Degrees, Limits(-90, 90), "latitude, north positive, in degrees"] = 45.0
    day: Annotated[int, Limits(1, 366), "day of the year; 172 is the northern summer's solstice"] = 172
    first: Annotated[_Hour, "first hour, in solar time"] = 8.0
    last: Annotated[_Hour, "last hour, in solar time"] = 16.0
    turn: Annotated[Turn, "offset of the azimuth, in degrees"] = 0.0
    ascending = (("first", "last"),)


class AxesConfig(Section):
    """Every combination of an entry of `list`, a value of each key of `grid`, a file of each key of `files`, a row of
    `zip`, a point of `path`, an hour of `sun` and a point of `qmc`. The axes are nested in this order."""

    # The paths of such sections.
    at: ClassVar[str] = "sweep"

    list: Annotated[
        Annotated[tuple[dict[str, Any], ...], Form("a list of sections of dotted keys")] | None,
        "sections of dotted keys to set together; label names one",
    ] = None
    grid: Annotated[dict[str, Values] | None, "values to combine, by dotted key"] = None
    files: Annotated[
        dict[str, str] | None, "patterns such as meshes/*.obj, whose files are combined in order, by dotted key"
    ] = None
    zip: Annotated[dict[str, Values] | None, "values that change together, by dotted key; lists of equal length"] = None
    path: Annotated[PathConfig | None, "points along paths, such as a camera's"] = None
    sun: Annotated[SunConfig | None, "azimuth and elevation of scene.light over a day"] = None
    qmc: Annotated[QuasiRandomConfig | None, "quasi-random points"] = None

    @property
    def axes(self) -> tuple[str, ...]:
        """The distinct keys, from slowest to fastest."""
        labels = [LABEL] if any(LABEL in entry for entry in self.list or ()) else []
        return tuple(dict.fromkeys([*labels, *(key for _, key in self.assigned())]))

    def assigned(self) -> Iterator[tuple[KeyPath, str]]:
        """Every key that is set, with its path in the section, in the order of setting."""
        for i, entry in enumerate(self.list or ()):
            yield from ((("list", i, key), key) for key in entry if key != LABEL)
        through, ranges = self.path and self.path.through, self.qmc and self.qmc.axes
        for path, keys in ((("grid",), self.grid), (("files",), self.files), (("zip",), self.zip)):
            yield from (((*path, key), key) for key in keys or ())
        yield from ((("path", "through", key), key) for key in through or ())
        yield from ((("sun",), key) for key in (SUN if self.sun else ()))
        yield from ((("qmc", "axes", key), key) for key in ranges or ())

    def faults(self) -> Iterator[Conflict]:
        yield from self._set_twice()
        yield from self._bad_lists()
        yield from self._bad_labels()

    def _set_twice(self) -> Iterator[Conflict]:
        """Faults of keys that would overwrite the value of an earlier key."""
        assigned = [*self.assigned()]
        for i, (path, key) in enumerate(assigned):
            for earlier, other in assigned[:i]:
                # A run uses only one entry of the list. Seeds together with repeats are reported separately.
                apart = path[0] == earlier[0] == "list" and path[1] != earlier[1]
                if not apart and path[0] != "seeds" and (other == key or other.startswith(f"{key}.")):
                    message = f"sets {key}, and {dotted((self.at, *earlier))} sets {other}"
                    yield path, fault(message, "every value set once", "remove one of them")
                    break

    def _bad_lists(self) -> Iterator[Conflict]:
        """Faults of lists that are empty, repeat a value or differ in length."""
        steps = self.zip or {}
        rows: dict[KeyPath, Any] = {} if self.list is None else {("list",): self.list}
        rows |= {("grid", key): values for key, values in (self.grid or {}).items()}
        rows |= {("zip", key): values for key, values in steps.items()}
        for path, values in rows.items():
            yield from bad_list(path, values, may_repeat=path[0] == "zip")
        first, expected = next(((key, len(values)) for key, values in steps.items()), ("", 0))
        for key, values in steps.items():
            if len(values) != expected and values:
                message = f"has {len(values)} values, and {first} has {expected}"
                yield ("zip", key), fault(message, "lists of equal length", "make them equally long, or use grid")

    def _bad_labels(self) -> Iterator[Conflict]:
        entries = self.list or ()
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


def bad_list(path: KeyPath, values: Sequence[Any], *, may_repeat: bool = False) -> Iterator[Conflict]:
    """Faults of a list that is empty or repeats a value."""
    if not values:
        yield path, fault("is an empty list", "at least one entry", "add one, or remove the key")
    twice = [text for text, count in Counter(map(repr, values)).items() if count > 1]
    if twice and not may_repeat:
        yield path, fault(f"holds {twice[0]} twice", "values that differ", "remove one of them")


class ViewsConfig(AxesConfig):
    """The views of a fit: every combination of values on the axes."""

    at: ClassVar[str] = "fit.views"

    def faults(self) -> Iterator[Conflict]:
        assigned = [*self.assigned()]
        if not assigned and not self.list:
            mend = "add 'grid: {scene.light.azimuth: [0, 90, 180]}'"
            yield (), fault("changes no key", "list, grid, files, zip, path, sun or qmc", mend)
        for path, key in assigned:
            if not any(key == start or key.startswith(f"{start}.") for start in _OF_A_VIEW):
                expected = "keys of scene or reference, or shadow_map.resolution"
                yield path, fault("is shared by all views", expected, "set it outside of the views")
        yield from super().faults()


class ValidationConfig(ViewsConfig):
    """Views that the fit does not use. Its result is measured on them."""

    at: ClassVar[str] = "fit.validation"
