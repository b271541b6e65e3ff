"""The choices of a sweep: the values on each axis, and where they were written."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .._errors import KeyPath
from ..sections._sweep import LABEL, QuasiRandomConfig, SweepConfig


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


def count_of(settings: SweepConfig) -> int:
    """How many runs a sweep makes."""
    lists = [*(settings.grid or {}).values(), *[*(settings.zip or {}).values()][:1], settings.list, settings.seeds]
    points = 1 if settings.qmc is None else settings.qmc.count
    return math.prod(len(values) for values in lists if values is not None) * points * (settings.repeats or 1)


def levels_of(settings: SweepConfig, seed: Any) -> list[list[Choice]]:
    """The choices on each axis, the slowest axis first.

    **Arguments:**

    - `settings`: the section `sweep`.
    - `seed`: the configuration's seed, from which `repeats` counts upwards.
    """
    levels = []
    if settings.list is not None:
        levels.append([_entry(i, entry) for i, entry in enumerate(settings.list)])
    for key, values in (settings.grid or {}).items():
        levels.append([Choice({key: v}, {key: ("sweep", "grid", key, i)}) for i, v in enumerate(values)])
    if settings.zip:
        rows = zip(*settings.zip.values(), strict=True)
        levels.append(
            [
                Choice(dict(zip(settings.zip, row, strict=True)), {k: ("sweep", "zip", k, i) for k in settings.zip})
                for i, row in enumerate(rows)
            ]
        )
    if settings.qmc is not None:
        paths = {key: ("sweep", "qmc", "axes", key) for key in settings.qmc.axes}
        levels.append([Choice(point, paths) for point in _points(settings.qmc)])
    if settings.repeats is not None and isinstance(seed, int):
        paths = {"seed": ("sweep", "repeats")}
        levels.append([Choice({"seed": seed + i}, paths) for i in range(settings.repeats)])
    if settings.seeds is not None:
        levels.append([Choice({"seed": s}, {"seed": ("sweep", "seeds", i)}) for i, s in enumerate(settings.seeds)])
    return _merged(levels)


def _entry(index: int, entry: Mapping[str, Any]) -> Choice:
    values = {key: value for key, value in entry.items() if key != LABEL}
    return Choice(values, {key: ("sweep", "list", index, key) for key in values}, entry.get(LABEL))


def _merged(levels: Sequence[list[Choice]]) -> list[list[Choice]]:
    """`levels`, with neighbours of a single choice merged, since there may be thousands of them."""
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
    # Imported here, since SciPy loads slowly and most sweeps do not need it.
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
