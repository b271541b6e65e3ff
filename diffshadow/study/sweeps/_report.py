"""The report of a sweep: the results of each combination of values, the figure, and the failures."""

import contextlib
import itertools
import math
import re
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ... import io
from ..._types import HostArray
from ...config import ConfigError, PlotConfig, Row, SweepConfig, describe, load_config
from ...console import Command
from ..pages._next import after_sweep
from ..record._stored import CONFIG, REPORT
from ..record._sweeps import SweepRecord
from ._curves import columns_for, curves_of, unit_of, with_unit
from ._table import MISSING, Columns, is_gap, metric_columns, read_columns, table_of
from ._work import FAILED, FIGURES, OK, RUNS

_SEED = "seed"
# The name of a run's folder.
_ID = re.compile("[0-9a-f]{16}")
# The greatest float32.
_MOST = float(np.finfo(np.float32).max)
# The most combinations, pictures of runs, values of an axis, and errors that are shown.
_MAX_ROWS, _MAX_PICTURES, _MAX_VALUES, _MAX_ERRORS = 2000, 24, 12, 50
# The figures that represent a run.
_RUN_PICTURES = ("comparison*.png", "difference*.png")


class Summary(NamedTuple):
    """The results by combination.

    - `axes`, `metrics`: the names of the columns.
    - `rows`: for each combination, the texts of its axes and metrics, and the number of its runs.
    - `total`: the number of combinations, which may exceed the number of rows.
    """

    axes: list[str]
    metrics: list[str]
    rows: list[tuple[list[str], list[str], int]]
    total: int


def report_sweep(folder: Path, record: SweepRecord, form: str | None = None) -> Path:
    """Writes the page of the sweep in `folder`, and its figure if a format `form` is given. **Returns** the page.

    **Raises** `FileError` if the sweep's table is missing, damaged, or another sweep's.
    """
    from ..pages._page import file_pictures, write_page

    sweep = record.settings
    runs = _read_table(folder, sweep)
    axes = [axis for axis in sweep.axes if axis != _SEED]
    settings = _settings(folder, runs)
    figure = _figure(folder, sweep.plot, runs, settings, form)
    good = {name: column[runs["status"] == OK] for name, column in runs.items()}
    summary = _summary(good, axes, metric_columns(sweep, list(runs)))
    failures, more_failures = _failures(runs, axes)
    pictures = sorted(path for path in folder.iterdir() if path.suffix in (".png", ".svg") and path.is_file())
    loose = [path for path in pictures if figure is None or path.stem != "plot"]
    write_page(
        folder / REPORT,
        "sweep.html.j2",
        name=record.name,
        kind=sweep.run,
        total=len(runs["id"]),
        done=len(good["id"]),
        failed=int((runs["status"] == FAILED).sum()),
        missing=int((runs["status"] == MISSING).sum()),
        axes=[(axis, _listed(_distinct(runs[axis])), unit_of(settings, axis)) for axis in axes],
        summary=summary,
        heads=[with_unit(settings, axis) for axis in axes],
        left_out=summary.total - len(summary.rows),
        seeds=len(_distinct(good[_SEED])),
        figure=figure,
        pictures=[
            p._replace(title=title) for path, title in _of_runs(folder, runs, axes) for p in file_pictures([path])
        ],
        files=file_pictures(loose),
        failures=failures,
        more_failures=more_failures,
        settings=settings,
        environment=[(name, value, "") for name, value in record.versions.items()],
        commands=after_sweep(folder, sweep.run, _best(folder, good), record.command),
    )
    return folder / REPORT


def _read_table(folder: Path, sweep: SweepConfig) -> Columns:
    file = table_of(folder)
    runs = read_columns(file)
    try:
        _check(runs, sweep)
    except ValueError as error:
        raise io.FileError(f"{file} is damaged ({error}); expected a sweep's table: sweep again") from error
    return runs


def _check(runs: Columns, sweep: SweepConfig) -> None:
    """**Raises** `ValueError` unless a table has the columns of a sweep, with valid values."""
    for name in ("id", "status", "error", *sweep.axes):
        if name not in runs:
            raise ValueError(f"it has no column {name}")
    for name, column in runs.items():
        given = [value for value in column.tolist() if not is_gap(value)]
        is_text = name in ("id", "status", "error")
        kinds = str if is_text else str | int | float if name in sweep.axes else int | float
        odd = next((value for value in given if not isinstance(value, kinds)), None)
        if odd is not None or (name in ("id", "status") and len(given) < len(column)):
            raise ValueError(f"its column {name} holds {odd!r}; expected {'text' if is_text else 'numbers'}")
        most = max((abs(value) for value in given if not isinstance(value, str)), default=0)
        if most > _MOST:
            raise ValueError(f"its column {name} holds {most:g}; expected numbers up to {_MOST:g}")
    if not all(map(_ID.fullmatch, runs["id"])):
        raise ValueError("its column id holds values that are not identifiers of runs")


def _distinct(column: HostArray) -> list[Any]:
    """The values of a column, each once, in their order."""
    return [value for value in dict.fromkeys(column.tolist()) if not is_gap(value)]


def _summary(good: Columns, axes: Sequence[str], metrics: Sequence[str]) -> Summary:
    """Means over the seeds of each combination, and their standard errors."""
    # Without axes, all runs belong to one combination.
    groups: dict[tuple[Any, ...], list[int]] = {}
    for row in range(len(good["id"])):
        values = (good[axis][row] for axis in axes)
        groups.setdefault(tuple(None if is_gap(value) else value for value in values), []).append(row)
    numbers = {name: good[name].astype(np.float64) for name in metrics}
    rows = [
        ([_text(value) for value in key], [_mean(numbers[name][group]) for name in metrics], len(group))
        for key, group in itertools.islice(groups.items(), _MAX_ROWS)
    ]
    return Summary(list(axes), list(metrics), rows, len(groups))


def _mean(values: Float[HostArray, " n"]) -> str:
    """A mean and its standard error. The error has two digits, and the mean has the same number of decimals."""
    known = values[~np.isnan(values)]
    if not len(known):
        return "–"
    mean, error = known.mean(), known.std(ddof=1) / len(known) ** 0.5 if len(known) > 1 else 0.0
    if error <= 0:
        return f"{mean:.4g}"
    decimals = max(1 - math.floor(math.log10(error)), 0)
    return f"{mean:.{decimals}f} ± {error:.{decimals}f}"


def _text(value: Any) -> str:
    if is_gap(value):
        # An entry of the list that does not set this key.
        return "–"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _listed(values: Sequence[Any]) -> str:
    more = f", … ({len(values)} values)" if len(values) > _MAX_VALUES else ""
    return ", ".join(map(_text, values[:_MAX_VALUES])) + more


def _failures(runs: Columns, axes: Sequence[str]) -> tuple[list[tuple[str, int, str]], int]:
    """Each error with its number of runs and the first of these; and the number of errors not shown."""
    failed = np.flatnonzero(runs["status"] == FAILED).tolist()
    counts = Counter(error for row in failed if (error := runs["error"][row]) is not None)
    firsts = {runs["error"][row]: row for row in reversed(failed)}
    shown = [
        ("; ".join(error.splitlines()), count, _values(runs, firsts[error], axes))
        for error, count in itertools.islice(counts.items(), _MAX_ERRORS)
    ]
    return shown, len(counts) - len(shown)


def _values(runs: Columns, row: int, axes: Sequence[str]) -> str:
    values = {axis: runs[axis][row] for axis in (*axes, _SEED)}
    return ", ".join(f"{axis} = {_text(value)}" for axis, value in values.items() if not is_gap(value))


def _settings(folder: Path, runs: Columns) -> list[Row]:
    """The settings of the first run whose configuration can be read."""
    for id in runs["id"]:
        file = folder / RUNS / id / CONFIG
        if file.is_file():
            with contextlib.suppress(ConfigError):
                return describe(load_config(file, [], files=False))
    return []


def _figure(
    folder: Path, plot: PlotConfig | None, runs: Columns, settings: Sequence[Row], form: str | None
) -> str | None:
    """The sweep's figure for the page, if it has one. Also written to the folder if a format `form` is given."""
    from .. import style
    from ._figures import write_plot

    if plot is None:
        return None
    try:
        curves = curves_of(columns_for(plot, runs), plot)
    except ValueError:
        # No run has the metric; the failures explain why.
        return None
    if form is not None:
        write_plot(folder / f"plot.{form}", curves, plot, settings)
    with tempfile.TemporaryDirectory() as scratch:
        write_plot(Path(scratch) / "plot.svg", curves, plot, settings)
        return style.themed((Path(scratch) / "plot.svg").read_text(encoding="utf-8"))


def commands_after(folder: Path, record: SweepRecord) -> list[Command]:
    """What to do after the sweep in `folder`. **Raises** as `report_sweep`."""
    runs = _read_table(folder, record.settings)
    good = {name: column[runs["status"] == OK] for name, column in runs.items()}
    return after_sweep(folder, record.settings.run, _best(folder, good), record.command)


def _best(folder: Path, good: Columns) -> Path | None:
    """The folder of the run with the least RMSE; none if no run has both."""
    errors = good.get("rmse", np.zeros(0))
    if not len(errors) or np.isnan(errors).all():
        return None
    found = folder / RUNS / good["id"][np.nanargmin(errors)]
    return found if (found / CONFIG).is_file() else None


def _of_runs(folder: Path, runs: Columns, axes: Sequence[str]) -> list[tuple[Path, str]]:
    """Pictures of the runs, with the runs' values; at most `_MAX_PICTURES`."""
    found = []
    for row, id in enumerate(runs["id"] if (folder / FIGURES).is_dir() else ()):
        for pattern in _RUN_PICTURES:
            paths = sorted((folder / FIGURES).glob(f"{id}*/{pattern}"))
            found += [(path, _values(runs, row, axes)) for path in paths if path.is_file()]
        if len(found) >= _MAX_PICTURES:
            break
    return found[:_MAX_PICTURES]
