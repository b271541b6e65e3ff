"""Curves of a sweep: a metric against an axis, and its slope."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..._types import HostArray
from ...config import PlotConfig, Row
from ._table import values_of


def unit_of(settings: Sequence[Row], key: str) -> str:
    """The unit of a setting; empty if it has none."""
    return next((row.unit for row in settings if row.key == key), "")


def with_unit(settings: Sequence[Row], key: str) -> str:
    """The key of a setting, followed by its unit if it has one."""
    unit = unit_of(settings, key)
    return f"{key} [{unit}]" if unit else key


class Curve(NamedTuple):
    """A metric along an axis.

    - `panel`, `line`: the values of these axes of the plot; the pair is unique to the curve.
    - `x`, `y`: (n,). If the values on the axis are not numbers, `x` holds their indices.
    - `ticks`: the values on the axis, if they are not numbers.
    - `slope`: the slope of log `y` against log `x`, by least squares; `None` if there is none.
    - `error`: the standard error of the slope, from one slope per seed; `None` for a single seed.
    """

    panel: str
    line: str
    x: HostArray
    y: HostArray
    ticks: list[str] | None
    slope: float | None
    error: float | None


def columns_for(plot: PlotConfig, table: Mapping[str, HostArray]) -> dict[str, list[Any]]:
    """The columns of a table of results that `plot` needs, as far as they exist, with none where a run has no value."""
    needed = {plot.x, plot.y, plot.lines, plot.panels, "seed"}
    return {name: values_of(column) for name, column in table.items() if name in needed}


def curves_of(columns: Mapping[str, Sequence[Any]], plot: PlotConfig) -> list[Curve]:
    """The curves of `plot`, from the columns of a table of results. Failed runs are left out.

    Results are averaged over all axes that the plot does not name. RMSEs are averaged as squares.

    **Raises** `ValueError` if no run has the metric.
    """
    every = columns.get(plot.y, ())
    rows = [i for i, value in enumerate(every) if value is not None and columns[plot.x][i] is not None]
    if not rows:
        raise ValueError(f"no run has the metric {plot.y!r} of sweep.plot.y; expected a metric of the table")
    of = lambda axis, i: "" if axis is None else _text(columns[axis][i])
    groups: dict[tuple[str, str], list[int]] = {}
    for i in rows:
        groups.setdefault((of(plot.panels, i), of(plot.lines, i)), []).append(i)
    values = dict.fromkeys(columns[plot.x][i] for i in rows)
    numbers = all(isinstance(value, int | float) for value in values)
    place = {value: float(value if numbers else number) for number, value in enumerate(values)}
    ticks = None if numbers else [_text(value) for value in values]
    curves = []
    for (panel, line), group in groups.items():
        x, y = _mean(columns, plot, group, place)
        slope = _slope(x, y) if numbers and plot.log else None
        error = _error_of_slope(columns, plot, group, place) if slope is not None else None
        curves.append(Curve(panel, line, x, y, ticks, slope, error))
    return curves


def _mean(
    columns: Mapping[str, Sequence[Any]], plot: PlotConfig, rows: Sequence[int], place: Mapping[Any, float]
) -> tuple[HostArray, HostArray]:
    """The metric's mean over `rows` at each value of the axis, in ascending order."""
    squared = "rmse" in plot.y.rpartition(".")[2]
    at: dict[float, list[float]] = {}
    for i in rows:
        at.setdefault(place[columns[plot.x][i]], []).append(columns[plot.y][i])
    x = sorted(at)
    y = [np.sqrt(np.mean(np.square(at[key]))) if squared else np.mean(at[key]) for key in x]
    return np.asarray(x, np.float64), np.asarray(y, np.float64)


def _slope(x: HostArray, y: HostArray) -> float | None:
    if len(x) < 2 or min(x.min(), y.min()) <= 0:
        return None
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _error_of_slope(
    columns: Mapping[str, Sequence[Any]], plot: PlotConfig, rows: Sequence[int], place: Mapping[Any, float]
) -> float | None:
    of_seed: dict[Any, list[int]] = {}
    for i in rows:
        of_seed.setdefault(columns["seed"][i], []).append(i)
    each = [_slope(*_mean(columns, plot, of_one, place)) for of_one in of_seed.values()]
    slopes = [slope for slope in each if slope is not None]
    return float(np.std(slopes, ddof=1) / np.sqrt(len(slopes))) if len(slopes) > 1 else None


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
