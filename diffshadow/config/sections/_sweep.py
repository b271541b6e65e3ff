"""Sections of a sweep, which makes many runs from one configuration."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from .._errors import KeyPath, did_you_mean, dotted, listing, show
from ._section import Conflict, Form, Section, Unit, as_list, exclusive, fault, is_number, look, ordered

LABEL = "label"
"""The key in an entry of `list` that names the entry; all others are set in the run."""
_FIXED = ("name", "output", "sweep")
_ERRORS = ("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate")
LIMIT_ERROR = "rmse_to_limit"
"""The name of the RMSE against the filter's limit of many samples."""

Values = Annotated[tuple[Any, ...], as_list, Form("a list of values")]


class QuasiRandomAxisConfig(Section):
    """The range of a key whose values come from a quasi-random sequence."""

    lower: float = Field(description="least value")
    upper: float = Field(description="greatest value")
    log: bool = Field(default=False, description="whether values are spread evenly on a logarithmic scale")
    integer: bool = Field(default=False, description="whether values are rounded to whole numbers")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from ordered(cls, data, "lower", "upper")
        lower = data.get("lower")
        if data.get("log") is True and is_number(lower) and lower <= 0:
            yield ("lower",), fault(f"is {lower} on a logarithmic scale", "a number greater than 0", "raise it")


class QuasiRandomConfig(Section):
    """Quasi-random points in the box of several ranges."""

    sequence: Literal["sobol", "halton"] = Field(default="sobol", description="the sequence, scrambled")
    count: Annotated[int, Unit("points")] = Field(ge=1, le=65536, description="number of points")
    seed: int = Field(default=0, ge=0, lt=2**32, description="seed of the scrambling")
    axes: dict[str, QuasiRandomAxisConfig] = Field(description="ranges, by dotted key")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        if data.get("axes") == {}:
            yield ("axes",), fault("is empty", "at least one key", "add 'bias.constant: {lower: 0, upper: 2}'")


class PlotConfig(Section):
    """The figure of a sweep: a metric against an axis. Results are averaged over all axes not named here."""

    x: str = Field(description="axis of the horizontal scale")
    y: str = Field(default="rmse", description="metric of the vertical scale")
    lines: str | None = Field(default=None, description="axis with one curve per value")
    panels: str | None = Field(default=None, description="axis with one panel per value")
    log: bool = Field(default=True, description="whether both scales are logarithmic, with fitted slopes")


class SweepConfig(Section):
    """Many runs: every combination of an entry of `list`, a value of each key of `grid`, a row of `zip`, a point of
    `qmc` and a seed. They are nested in this order, and the seed varies fastest."""

    run: Literal["render", "fit"] = Field(default="render", description="what each run does")
    list: Annotated[tuple[dict[str, Any], ...], as_list, Form("a list of sections of dotted keys")] | None = Field(
        default=None, description="sections of dotted keys to set together; label names one"
    )
    grid: dict[str, Values] | None = Field(default=None, description="values to combine, by dotted key")
    zip: dict[str, Values] | None = Field(
        default=None, description="values to step through together, by dotted key; lists of equal length"
    )
    qmc: QuasiRandomConfig | None = Field(default=None, description="quasi-random points")
    repeats: int | None = Field(
        default=None, ge=1, le=65536, description="seeds for each combination, from the configuration's own upwards"
    )
    seeds: Annotated[tuple[int, ...], as_list, Form("a list of whole numbers")] | None = Field(
        default=None, description="explicit seeds, instead of repeats"
    )
    limit_samples: Annotated[int | None, Unit("taps a pixel")] = Field(
        default=None,
        ge=1,
        le=2**20,
        description=f"taps of the converged random disk that {LIMIT_ERROR} is measured against; default: not measured",
    )
    plot: PlotConfig | None = Field(default=None, description="a figure of the results; default: none")
    figures: bool = Field(default=False, description="whether each run also writes its own figures")
    csv: bool = Field(default=False, description="whether the table is also written as CSV")

    @property
    def axes(self) -> tuple[str, ...]:
        """The swept keys, once each, from slowest to fastest. The seed is always last, even if it is not swept."""
        labels = any(LABEL in entry for entry in self.list or ())
        found = [key for _, key in _settings(self.model_dump()) if key != "seed"]
        return tuple(dict.fromkeys([*([LABEL] if labels else []), *found, "seed"]))

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        settings = [*_settings(data)]
        if not settings and not data.get("list"):
            mend = "add 'grid: {filter.radius: [1, 2, 4]}'"
            yield (), fault("sweeps no key", "list, grid, zip, qmc, repeats or seeds", mend)
        yield from exclusive(data, "repeats", "seeds")
        yield from _fixed(settings)
        yield from _set_twice(settings)
        yield from _bad_lists(data)
        yield from _bad_labels(data)
        yield from _bad_plot(data, settings)
        if data.get("limit_samples") is not None and data.get("run") == "fit":
            what = fault("is given with run: fit", "run: render, where the radius is fixed", "remove one of them")
            yield ("limit_samples",), what


def _settings(data: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Every swept key in the order in which runs set them, after its path in the section."""
    entries = data.get("list")
    for i, entry in enumerate(entries if isinstance(entries, list | tuple) else ()):
        yield from ((("list", i, key), key) for key in _keys(entry) if key != LABEL)
    for path in (("grid",), ("zip",), ("qmc", "axes")):
        yield from (((*path, key), key) for key in _keys(look(data, *path)))
    yield from (((key,), "seed") for key in ("repeats", "seeds") if data.get(key) is not None)


def _keys(section: Any) -> list[str]:
    return [key for key in section if isinstance(key, str)] if isinstance(section, Mapping) else []


def _fixed(settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
    for path, key in settings:
        if key.split(".")[0] in _FIXED:
            what = fault("is the same for all runs", "keys that affect a run's results", "set it outside of sweep")
            yield path, what


def _set_twice(settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
    """Faults of keys that would overwrite what an earlier key sets."""
    for i, (path, key) in enumerate(settings):
        for earlier, other in settings[:i]:
            # A run uses only one entry of the list, and `exclusive` reports repeats together with seeds.
            apart = path[0] == earlier[0] == "list" and path[1] != earlier[1]
            if apart or {path[0], earlier[0]} == {"repeats", "seeds"}:
                continue
            if other == key or other.startswith(f"{key}."):
                message = f"sets {key}, and {dotted(('sweep', *earlier))} sets {other}"
                yield path, fault(message, "every value set once", "remove one of them")
                break


def _bad_lists(data: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of lists that are empty, repeat a value or differ in length."""
    rows: dict[KeyPath, Any] = {("list",): data.get("list"), ("seeds",): data.get("seeds")}
    for kind in ("grid", "zip"):
        rows |= {(kind, key): look(data, kind, key) for key in _keys(data.get(kind))}
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


def _bad_plot(data: Mapping[str, Any], settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
    axes = dict.fromkeys(key for _, key in settings)
    entries = data.get("list")
    if isinstance(entries, list | tuple) and any(LABEL in _keys(entry) for entry in entries):
        axes[LABEL] = None
    for key in ("x", "lines", "panels"):
        axis = look(data, "plot", key)
        if isinstance(axis, str) and axes and axis not in axes:
            mend = did_you_mean(axis, axes, "name one of these")
            yield ("plot", key), fault(f"is {show(axis)}, which is not swept", listing(axes), mend)
    y, metrics = look(data, "plot", "y", default="rmse"), _metrics(data)
    if isinstance(data.get("plot"), Mapping) and isinstance(y, str) and data.get("run") != "fit" and y not in metrics:
        yield ("plot", "y"), fault(f"is {show(y)}", listing(metrics), did_you_mean(y, metrics, "name one of these"))


def _metrics(data: Mapping[str, Any]) -> list[str]:
    """The metrics of a render."""
    return [*_ERRORS, *([LIMIT_ERROR] if data.get("limit_samples") is not None else [])]
