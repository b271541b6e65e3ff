"""The section of a sweep, which makes many runs from one configuration."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from ...settings import Form, Limits, Unit
from ...settings.patterns import PatternSamples
from .._errors import KeyPath, did_you_mean, dotted, listing, show
from ._axes import LABEL, AxesConfig, PathConfig, bad_list
from ._section import Conflict, Section, fault

_FIXED = ("name", "output", "sweep")
_ERRORS = ("rmse", "mae", "ssim", "false_shadow_rate", "false_light_rate")
LIMIT_ERROR = "rmse_to_limit"
"""The name of the RMSE against the filter's limit of many samples."""
FLICKER = "flicker"
"""The name of `metrics.flicker` over a path."""
# The keys that change along the path.
_MOVES = ("scene.camera", "scene.light", "scene.lights")


class PlotConfig(Section):
    """The figure of a sweep: a metric against an axis. Results are averaged over all axes that are not named here."""

    x: Annotated[str, "axis of the horizontal scale"]
    y: Annotated[str, "metric of the vertical scale"] = "rmse"
    lines: Annotated[str | None, "axis with one curve per value"] = None
    panels: Annotated[str | None, "axis with one panel per value"] = None
    log: Annotated[bool, "whether both scales are logarithmic, with fitted slopes"] = True


class FlickerConfig(PathConfig):
    """A short path of the camera and the lights. Its frames measure how much the shadow shimmers: `metrics.flicker`."""

    count: Annotated[int, Unit("frames"), Limits(2, 256), "number of frames, both ends included; each traces rays"]

    def faults(self) -> Iterator[Conflict]:
        yield from super().faults()
        for key in self.through:
            if ".".join(key.split(".")[:2]) not in _MOVES:
                given = "is neither the camera's nor a light's"
                mend = "use another key, such as scene.light.azimuth"
                yield ("through", key), fault(given, f"keys within {listing(_MOVES)}", mend)


class SweepConfig(AxesConfig):
    """Many runs: every combination of values on the axes, and of a seed, which varies fastest."""

    run: Annotated[Literal["render", "fit"], "the command of each run"] = "render"
    repeats: Annotated[
        int | None, Limits(1, 65536), "number of seeds for each combination, starting at the configuration's own seed"
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
    csv: Annotated[bool, "whether the table is also written as CSV if it is Parquet"] = False
    exclusive = (("repeats", "seeds"),)

    @property
    def axes(self) -> tuple[str, ...]:
        """The distinct swept keys, from slowest to fastest. The seed is always last, even if it is not swept."""
        return tuple(dict.fromkeys([*(key for key in super().axes if key != "seed"), "seed"]))

    def assigned(self) -> Iterator[tuple[KeyPath, str]]:
        yield from super().assigned()
        yield from (((key,), "seed") for key in ("repeats", "seeds") if getattr(self, key) is not None)

    def faults(self) -> Iterator[Conflict]:
        assigned = [*self.assigned()]
        if not assigned and not self.list:
            mend = "add 'grid: {filter.radius: [1, 2, 4]}'"
            yield (), fault("sweeps no key", "list, grid, files, zip, path, sun, qmc, repeats or seeds", mend)
        for path, key in assigned:
            if key.split(".")[0] in _FIXED:
                what = fault("is the same for all runs", "keys that affect a run's results", "set it outside of sweep")
                yield path, what
        yield from super().faults()
        if self.seeds is not None:
            yield from bad_list(("seeds",), self.seeds)
        yield from self._bad_plot([*dict.fromkeys(key for _, key in assigned)])
        for key in ("limit_samples", "flicker"):
            if self.run == "fit" and getattr(self, key) is not None:
                what = "is given with run: fit", "run: render, where nothing is fitted", "remove one of them"
                yield (key,), fault(*what)
        # Keys of `flicker` that an axis sets.
        for key in self.flicker.through if self.flicker else ():
            axis = next((path for path, swept in assigned if f"{key}.".startswith(f"{swept}.")), None)
            if axis is not None:
                message = f"moves {key}, and {dotted(('sweep', *axis))} sets it"
                yield ("flicker", "through", key), fault(message, "keys that no axis sets", "remove one of them")

    def _bad_plot(self, axes: Sequence[str]) -> Iterator[Conflict]:
        if self.plot is None:
            return
        axes = [*axes, *([LABEL] if any(LABEL in entry for entry in self.list or ()) else [])]
        for key, axis in (("x", self.plot.x), ("lines", self.plot.lines), ("panels", self.plot.panels)):
            if axis is not None and axes and axis not in axes:
                mend = did_you_mean(axis, axes, "name one of these")
                yield ("plot", key), fault(f"is {show(axis)}, which is not swept", listing(axes), mend)
        y, optional = self.plot.y, {LIMIT_ERROR: self.limit_samples, FLICKER: self.flicker}
        metrics = [*_ERRORS, *(name for name, given in optional.items() if given is not None)]
        if self.run != "fit" and y not in metrics:
            mend = did_you_mean(y, metrics, "name one of these")
            yield ("plot", "y"), fault(f"is {show(y)}", listing(metrics), mend)
