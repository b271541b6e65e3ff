"""The choices on axes: values, and the places where they were written."""

import copy
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .._errors import ConfigError, KeyPath, Mistake, Origin, dotted
from ..sections._axes import LABEL, SUN, AxesConfig, PathConfig, QuasiRandomConfig, SunConfig
from ..sections._sweep import FlickerConfig, SweepConfig
from ._draft import Draft
from ._overrides import words_of, write_value


class Choice(NamedTuple):
    """One value of an axis, or one combination of values of several axes that change together.

    - `values`: the values by key; `paths`: the paths of these keys in the file.
    - `label`: the label of an entry of `list`.
    """

    values: Mapping[str, Any]
    paths: Mapping[str, KeyPath]
    label: str | None = None

    @property
    def shown(self) -> Mapping[str, Any]:
        """The values by axis, including the label."""
        return self.values if self.label is None else {LABEL: self.label, **self.values}


def levels_of(settings: AxesConfig, draft: Draft) -> list[list[Choice]]:
    """The choices on each axis, with the slowest axis first.

    **Arguments:**

    - `settings`: a section of axes; `draft`: the draft of the configuration that contains the section. A sweep's
      `repeats` count upwards from its seed.

    **Raises** `ConfigError` if no file matches a pattern, or if the sun is below the horizon.
    """
    at = tuple(settings.at.split("."))
    single = lambda key, values, kind: [Choice({key: v}, {key: (*at, kind, key, i)}) for i, v in enumerate(values)]
    levels = []
    if settings.list is not None:
        levels.append([_entry(at, i, entry) for i, entry in enumerate(settings.list)])
    levels += [single(key, values, "grid") for key, values in (settings.grid or {}).items()]
    for key, pattern in (settings.files or {}).items():
        place = (*at, "files", key)
        levels.append([Choice({key: file}, {key: place}) for file in _matching(pattern, place, draft)])
    if settings.zip:
        rows = zip(*settings.zip.values(), strict=True)
        levels.append(
            [
                Choice(dict(zip(settings.zip, row, strict=True)), {k: (*at, "zip", k, i) for k in settings.zip})
                for i, row in enumerate(rows)
            ]
        )
    if settings.path is not None:
        paths = {key: (*at, "path", "through", key) for key in settings.path.through}
        levels.append([Choice(point, paths) for point in _along(settings.path)])
    if settings.sun is not None:
        place = (*at, "sun")
        levels.append([Choice(hour, dict.fromkeys(SUN, place)) for hour in _hours(settings.sun, place, draft)])
    if settings.qmc is not None:
        paths = {key: (*at, "qmc", "axes", key) for key in settings.qmc.axes}
        levels.append([Choice(point, paths) for point in _points(settings.qmc)])
    return _merged([*levels, *(_seeds(settings, draft) if isinstance(settings, SweepConfig) else ())])


def steps_of(flicker: FlickerConfig | None) -> list[Choice]:
    """The points along the path for the measurement of flicker. Empty without such a path."""
    if flicker is None:
        return []
    paths = {key: ("sweep", "flicker", "through", key) for key in flicker.through}
    return [Choice(point, paths) for point in _along(flicker)]


def _seeds(settings: SweepConfig, draft: Draft) -> list[list[Choice]]:
    levels, seed = [], draft.data.get("seed", 0)
    if settings.repeats is not None and isinstance(seed, int):
        paths = {"seed": ("sweep", "repeats")}
        levels.append([Choice({"seed": seed + i}, paths) for i in range(settings.repeats)])
    if settings.seeds is not None:
        levels.append([Choice({"seed": s}, {"seed": ("sweep", "seeds", i)}) for i, s in enumerate(settings.seeds)])
    return levels


def written(draft: Draft, choice: Choice, origin: Origin) -> Draft:
    """`draft` with the values of `choice`. Their places in the file are the places of the axes, from `origin`."""
    data, places, mistakes = copy.deepcopy(draft.data), dict(draft.origin.places), list(draft.mistakes)
    for key, value in choice.values.items():
        place = origin.place(choice.paths[key])
        try:
            write_value(data, places, words_of(key, place), copy.deepcopy(value), place)
        except ConfigError as error:
            mistakes += error.mistakes
    return Draft(data, Origin(draft.origin.source, places), draft.folder, mistakes)


def _matching(pattern: str, path: KeyPath, draft: Draft) -> list[str]:
    """The files that match a pattern, in order."""
    place = draft.origin.place(path)
    # Patterns in overrides are relative to the current folder, like paths.
    folder = (draft.folder if place.line is not None else Path()) / Path(pattern).parent
    files = sorted(str(file.absolute()) for file in folder.glob(Path(pattern).name) if file.is_file())
    if not files:
        message = f"is {pattern!r}, and no file in {folder.absolute()} matches it; expected one or more; change it"
        raise ConfigError([Mistake(place, dotted(path), message)])
    return files


def _along(settings: PathConfig) -> list[dict[str, Any]]:
    """The points along the paths."""

    def at(values: Sequence[Any], time: float) -> Any:
        first = min(int(time * (len(values) - 1)), len(values) - 2)
        part = time * (len(values) - 1) - first
        between = lambda a, b: a + (b - a) * part
        start, end = values[first], values[first + 1]
        if isinstance(start, list | tuple):
            return [between(a, b) for a, b in zip(start, end, strict=True)]
        return between(start, end)

    times = [i / (settings.count - 1) for i in range(settings.count)]
    return [{key: at(values, time) for key, values in settings.through.items()} for time in times]


def _hours(settings: SunConfig, path: KeyPath, draft: Draft) -> list[dict[str, Any]]:
    """The sun's azimuth and elevation at each hour, in degrees.

    With the declination δ = -23.44° cos(360° (day + 10) / 365), the hour angle H and the latitude φ (Meeus,
    "Astronomical Algorithms", 1998, chapter 13): sin h = sin φ sin δ + cos φ cos δ cos H, and west of south
    tan A = sin H / (cos H sin φ - tan δ cos φ).
    """
    step = (settings.last - settings.first) / max(settings.count - 1, 1)
    declination = math.radians(-23.44) * math.cos(math.tau * (settings.day + 10) / 365)
    latitude, found = math.radians(settings.latitude), []
    for i in range(settings.count):
        hour = settings.first + i * step
        angle = math.radians(15 * (hour - 12))
        high = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(angle)
        if high <= 0:
            message = (
                f"has the sun below the horizon at {hour:.4g} hours, at latitude {settings.latitude:g} on day "
                f"{settings.day}; expected hours of daylight; change first or last"
            )
            raise ConfigError([Mistake(draft.origin.place(path), dotted(path), message)])
        across = math.cos(angle) * math.sin(latitude) - math.tan(declination) * math.cos(latitude)
        azimuth = settings.turn - math.degrees(math.atan2(math.sin(angle), across))
        found.append(dict(zip(SUN, (azimuth, math.degrees(math.asin(high))), strict=True)))
    return found


def _entry(at: KeyPath, index: int, entry: Mapping[str, Any]) -> Choice:
    values = {key: value for key, value in entry.items() if key != LABEL}
    return Choice(values, {key: (*at, "list", index, key) for key in values}, entry.get(LABEL))


def _merged(levels: Sequence[list[Choice]]) -> list[list[Choice]]:
    """`levels`, with neighbours of a single choice merged, because there may be thousands of them."""
    merged: list[list[Choice]] = []
    for level in levels:
        if len(level) == 1 and merged and len(merged[-1]) == 1:
            (above,), (below,) = merged[-1], level
            merged[-1] = [Choice({**above.values, **below.values}, {**above.paths, **below.paths}, above.label)]
        else:
            merged.append(level)
    return merged


def _points(settings: QuasiRandomConfig) -> list[dict[str, Any]]:
    """The points of the sequence, scaled to the axes' ranges."""
    # Imported here, because SciPy is slow to load and most sweeps do not need it.
    from scipy.stats import qmc

    make = {"sobol": qmc.Sobol, "halton": qmc.Halton}[settings.sequence]
    sequence = make(len(settings.axes), scramble=True, rng=settings.seed)
    if settings.sequence == "sobol":
        # SciPy warns about numbers that are not a power of two.
        unit = sequence.random_base2(math.ceil(math.log2(settings.count)))[: settings.count]
    else:
        unit = sequence.random(settings.count)
    points = []
    for row in unit.tolist():
        point = {}
        for fraction, (key, axis) in zip(row, settings.axes.items(), strict=True):
            if axis.log:
                value = axis.lower * (axis.upper / axis.lower) ** fraction
            else:
                value = axis.lower + (axis.upper - axis.lower) * fraction
            value = min(max(value, axis.lower), axis.upper)
            point[key] = round(value) if axis.integer else value
        points.append(point)
    return points
