"""The section of a sweep, which makes many runs from one configuration."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from ...settings import Form, Limits, Unit
from ...settings.patterns import PatternSamples
from .._errors import KeyPath, did_you_mean, dotted, listing, show
from ._axes import LABEL, AxesConfig, PathConfig, settings_of
from ._section import Conflict, Section, exclusive, fault, value_at

_FIXED = ("name", "output", "sweep")
_ERRORS = ("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate")
LIMIT_ERROR = "rmse_to_limit"
"""The name of the RMSE against the filter's limit of many samples."""
FLICKER = "flicker"
"""The name of `metrics.flicker` over a path."""
# What moves along that path.
_MOVES = ("scene.camera", "scene.light", "scene.lights")


class PlotConfig(Section):
    """The figure of a sweep: a metric against an axis. Results are averaged over all axes not named here."""

    x: Annotated[str, "axis of the horizontal scale"]
    y: Annotated[str, "metric of the vertical scale"] = "rmse"
    lines: Annotated[str | None, "axis with one curve per value"] = None
    panels: Annotated[str | None, "axis with one panel per value"] = None
    log: Annotated[bool, "whether both scales are logarithmic, with fitted slopes"] = True


class FlickerConfig(PathConfig):
    """A short path of camera and lights. Its frames measure how much the shadow shimmers: `metrics.flicker`."""

    count: Annotated[int, Unit("frames"), Limits(2, 256), "number of frames, both ends included; each traces rays"]

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from super().conflicts(data)
        for key in data.get("through") or () if isinstance(data.get("through"), Mapping) else ():
            if isinstance(key, str) and ".".join(key.split(".")[:2]) not in _MOVES:
                given = "is neither the camera's nor a light's"
                mend = "take another key, such as scene.light.azimuth"
                yield ("through", key), fault(given, f"keys within {listing(_MOVES)}", mend)


class SweepConfig(AxesConfig):
    """Many runs: every combination of values on the axes, and of a seed, which varies fastest."""

    run: Annotated[Literal["render", "fit"], "what each run does"] = "render"
    repeats: Annotated[
        int | None, Limits(1, 65536), "seeds for each combination, from the configuration's own upwards"
    ] = None
    seeds: Annotated[
        Annotated[tuple[int, ...], Form("a list of whole numbers")] | None, "explicit seeds, instead of repeats"
    ] = None
    limit_samples: Annotated[
        PatternSamples | None,
        f"taps of the converged random disk that {LIMIT_ERROR} is measured against; default: not measured",
    ] = None
    flicker: Annotated[
        FlickerConfig | None, f"frames of a moving camera or light, over which {FLICKER} is measured; default: none"
    ] = None
    plot: Annotated[PlotConfig | None, "a figure of the results; default: none"] = None
    figures: Annotated[bool, "whether each run also writes its own figures"] = False
    csv: Annotated[bool, "whether the table is also written as CSV where it is Parquet"] = False

    @property
    def axes(self) -> tuple[str, ...]:
        """The swept keys, once each, from slowest to fastest. The seed is always last, even if it is not swept."""
        return tuple(dict.fromkeys([*(key for key in super().axes if key != "seed"), "seed"]))

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        settings = [*settings_of(data)]
        if not settings and not data.get("list"):
            mend = "add 'grid: {filter.radius: [1, 2, 4]}'"
            expected = "list, grid, files, zip, path, sun, qmc, repeats or seeds"
            yield (), fault("sweeps no key", expected, mend)
        yield from exclusive(data, "repeats", "seeds")
        yield from super().conflicts(data)
        yield from _bad_plot(data, settings)
        if data.get("run") == "fit":
            what = fault("is given with run: fit", "run: render, where nothing is fitted", "remove one of them")
            yield from (((key,), what) for key in ("limit_samples", "flicker") if data.get(key) is not None)
        yield from _moved_and_swept(data, settings)

    @classmethod
    def fixed(cls, settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
        for path, key in settings:
            if key.split(".")[0] in _FIXED:
                what = fault("is the same for all runs", "keys that affect a run's results", "set it outside of sweep")
                yield path, what


def _bad_plot(data: Mapping[str, Any], settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
    axes = dict.fromkeys(key for _, key in settings)
    entries = data.get("list")
    if isinstance(entries, list | tuple) and any(isinstance(entry, Mapping) and LABEL in entry for entry in entries):
        axes[LABEL] = None
    for key in ("x", "lines", "panels"):
        axis = value_at(data, "plot", key)
        if isinstance(axis, str) and axes and axis not in axes:
            mend = did_you_mean(axis, axes, "name one of these")
            yield ("plot", key), fault(f"is {show(axis)}, which is not swept", listing(axes), mend)
    y, metrics = value_at(data, "plot", "y", default="rmse"), _metrics(data)
    if isinstance(data.get("plot"), Mapping) and isinstance(y, str) and data.get("run") != "fit" and y not in metrics:
        yield ("plot", "y"), fault(f"is {show(y)}", listing(metrics), did_you_mean(y, metrics, "name one of these"))


def _moved_and_swept(data: Mapping[str, Any], settings: Sequence[tuple[KeyPath, str]]) -> Iterator[Conflict]:
    """Faults of keys of `flicker` that an axis sets."""
    through = value_at(data, "flicker", "through")
    for key in through if isinstance(through, Mapping) else ():
        axis = next((path for path, swept in settings if f"{key}.".startswith(f"{swept}.")), None)
        if axis is not None:
            message = f"moves {key}, and {dotted(('sweep', *axis))} sets it"
            yield ("flicker", "through", key), fault(message, "keys that no axis sets", "remove one of them")


def _metrics(data: Mapping[str, Any]) -> list[str]:
    """The metrics of a render."""
    optional = {"limit_samples": LIMIT_ERROR, "flicker": FLICKER}
    return [*_ERRORS, *(name for key, name in optional.items() if data.get(key) is not None)]
