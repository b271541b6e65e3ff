"""The report of a sweep: the results of each combination of values, the figure, and the failures."""

import contextlib
import math
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from ... import io
from ...config import ConfigError, PlotConfig, Row, SweepConfig, describe, load_config
from ..record._stored import CONFIG, REPORT
from ..record._sweeps import SweepRecord
from ._curves import curves_of, unit_of, with_unit
from ._table import MISSING, RESULTS, metric_columns
from ._work import FAILED, FIGURES, OK, RUNS

Runs = Any
"""A data frame with one row per run. Pandas' types are too vague for type checkers."""
_SEED = "seed"
# The name of a run's folder.
_ID = re.compile("[0-9a-f]{16}")
# Far more than any sweep has. A table with more rows is damaged.
_MAX_RUNS = 1 << 24
# So many rows are read at a time.
_ROWS_AT_ONCE = 1 << 16
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
    from ..pages._next import after_sweep
    from ..pages._page import file_pictures, write_page

    sweep = record.settings
    runs = _read_table(folder, sweep)
    axes = [axis for axis in sweep.axes if axis != _SEED]
    settings = _settings(folder, runs)
    figure = _figure(folder, sweep.plot, runs, settings, form)
    good = runs[runs["status"] == OK]
    summary = _summary(good, axes, metric_columns(sweep, list(runs.columns)))
    failures, more_failures = _failures(runs, axes)
    loose = [path for path in _pictures(folder) if figure is None or path.stem != "plot"]
    write_page(
        folder / REPORT,
        "sweep.html.j2",
        name=record.name,
        kind=sweep.run,
        total=len(runs),
        done=len(good),
        failed=int((runs["status"] == FAILED).sum()),
        missing=int((runs["status"] == MISSING).sum()),
        axes=[(axis, _listed(runs[axis].dropna().unique().tolist()), unit_of(settings, axis)) for axis in axes],
        summary=summary,
        heads=[with_unit(settings, axis) for axis in axes],
        left_out=summary.total - len(summary.rows),
        seeds=int(good[_SEED].nunique()),
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


def _read_table(folder: Path, sweep: SweepConfig) -> Runs:
    file = folder / RESULTS
    if not file.is_file():
        raise io.FileError(
            f"{folder} holds an incomplete sweep: it has no {RESULTS}; expected a table of results: sweep again"
        )
    try:
        with file.open("rb") as stream, parquet.ParquetFile(stream) as stored:
            if stored.metadata.num_rows > _MAX_RUNS:
                raise ValueError(f"it has {stored.metadata.num_rows:,} rows; expected at most {_MAX_RUNS:,}")
            _check_columns(stored.schema_arrow, sweep)
            parts = [_checked(part) for part in stored.iter_batches(_ROWS_AT_ONCE)]
            return pd.concat(parts or [stored.schema_arrow.empty_table().to_pandas()], ignore_index=True)
    except Exception as error:  # Arrow raises many types
        reason = " ".join(str(error).split()) or type(error).__name__
        raise io.FileError(f"{file} is damaged ({reason}); expected a sweep's table: sweep again") from error


def _check_columns(schema: pa.Schema, sweep: SweepConfig) -> None:
    """**Raises** `ValueError` unless a table has the columns of a sweep."""
    if len(set(schema.names)) < len(schema.names):
        raise ValueError("it has two columns with the same name")
    for name in ("id", "status", "error", *sweep.axes):
        if name not in schema.names:
            raise ValueError(f"it has no column {name}")
    numbers = lambda kind: pa.types.is_floating(kind) or pa.types.is_integer(kind)
    for name in schema.names:
        kind = schema.field(name).type
        if name in ("id", "status", "error"):
            # If no run has failed, the column may have any type.
            if not pa.types.is_string(kind) and name != "error":
                raise ValueError(f"its column {name} holds {kind}; expected text")
        elif not (numbers(kind) or (name in sweep.axes and (pa.types.is_string(kind) or pa.types.is_boolean(kind)))):
            raise ValueError(f"its column {name} holds {kind}; expected numbers")


def _checked(part: pa.RecordBatch) -> Runs:
    """A part of the rows. **Raises** `ValueError` as `_check_values` does."""
    runs = part.to_pandas()
    _check_values(runs)
    return runs


def _check_values(runs: Runs) -> None:
    """**Raises** `ValueError` unless the identifiers, errors and numbers of a table are valid."""
    if not all(_ID.fullmatch(id) for id in runs["id"]):
        raise ValueError("its column id holds values that are not identifiers of runs")
    if not all(isinstance(error, str) or pd.isna(error) for error in runs["error"]):
        raise ValueError("its column error holds values that are not text")
    for name in runs.select_dtypes("number").columns:
        if (runs[name].abs() > _MOST).any():
            raise ValueError(f"its column {name} holds {runs[name].abs().max():g}; expected numbers up to {_MOST:g}")


def _summary(good: Runs, axes: Sequence[str], metrics: Sequence[str]) -> Summary:
    """Means over the seeds of each combination, and their standard errors."""
    # Without axes, all runs belong to one combination.
    by = list(axes) or [np.zeros(len(good))]
    groups = good.groupby(by, sort=False, dropna=False)
    runs = groups.size()
    means, deviations = groups[list(metrics)].mean(), groups[list(metrics)].sem()
    rows = []
    for i in range(min(len(runs), _MAX_ROWS)):
        key = runs.index[i] if len(axes) > 1 else (runs.index[i],)
        texts = [_mean(means[name].iloc[i], deviations[name].iloc[i]) for name in metrics]
        rows.append(([_text(value) for value in key] if axes else [], texts, int(runs.iloc[i])))
    return Summary(list(axes), list(metrics), rows, len(runs))


def _mean(mean: float, error: float) -> str:
    """A mean and its standard error. The error has two digits, and the mean has the same number of decimals."""
    if pd.isna(mean):
        return "–"
    if pd.isna(error) or error <= 0:
        return f"{mean:.4g}"
    decimals = max(1 - math.floor(math.log10(error)), 0)
    return f"{mean:.{decimals}f} ± {error:.{decimals}f}"


def _text(value: Any) -> str:
    if pd.isna(value):
        # An entry of the list that does not set this key.
        return "–"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _listed(values: Sequence[Any]) -> str:
    more = f", … ({len(values)} values)" if len(values) > _MAX_VALUES else ""
    return ", ".join(map(_text, values[:_MAX_VALUES])) + more


def _failures(runs: Runs, axes: Sequence[str]) -> tuple[list[tuple[str, int, str]], int]:
    """Each error with its number of runs and the first of these; and the number of errors not shown."""
    failed = runs[runs["status"] == FAILED]
    counts = failed["error"].value_counts(sort=False)
    firsts = failed.drop_duplicates("error").dropna(subset="error").head(_MAX_ERRORS)
    shown = [
        ("; ".join(run["error"].splitlines()), int(counts[run["error"]]), _values(run, axes))
        for _, run in firsts.iterrows()
    ]
    return shown, len(counts) - len(shown)


def _values(run: Runs, axes: Sequence[str]) -> str:
    return ", ".join(f"{axis} = {_text(run[axis])}" for axis in (*axes, _SEED) if not pd.isna(run[axis]))


def _settings(folder: Path, runs: Runs) -> list[Row]:
    """The settings of the first run whose configuration can be read."""
    for id in runs["id"]:
        file = folder / RUNS / id / CONFIG
        if file.is_file():
            with contextlib.suppress(ConfigError):
                return describe(load_config(file, [], files=False))
    return []


def _figure(folder: Path, plot: PlotConfig | None, runs: Runs, settings: Sequence[Row], form: str | None) -> str | None:
    """The sweep's figure for the page, if it has one. Also written to the folder if a format `form` is given."""
    from .. import style
    from ._figures import write_plot

    if plot is None:
        return None
    needed = [str(name) for name in runs.columns if name in (plot.x, plot.y, plot.lines, plot.panels, _SEED)]
    columns = {name: [None if pd.isna(value) else value for value in runs[name].tolist()] for name in needed}
    try:
        curves = curves_of(columns, plot)
    except ValueError:
        # No run has the metric; the failures explain why.
        return None
    if form is not None:
        write_plot(folder / f"plot.{form}", curves, plot, settings)
    with tempfile.TemporaryDirectory() as scratch:
        write_plot(Path(scratch) / "plot.svg", curves, plot, settings)
        return style.themed((Path(scratch) / "plot.svg").read_text(encoding="utf-8"))


def _pictures(folder: Path) -> list[Path]:
    """All pictures directly in the folder."""
    return sorted(path for path in folder.iterdir() if path.suffix in (".png", ".svg") and path.is_file())


def _best(folder: Path, good: Runs) -> Path | None:
    """The folder of the run with the least RMSE; none if no run has both."""
    if "rmse" not in good.columns or not good["rmse"].notna().any():
        return None
    found = folder / RUNS / str(good["id"][good["rmse"].idxmin()])
    return found if (found / CONFIG).is_file() else None


def _of_runs(folder: Path, runs: Runs, axes: Sequence[str]) -> list[tuple[Path, str]]:
    """Pictures of the runs, with the runs' values; at most `_MAX_PICTURES`."""
    found = []
    for number in range(len(runs) if (folder / FIGURES).is_dir() else 0):
        run = runs.iloc[number]
        for pattern in _RUN_PICTURES:
            paths = sorted((folder / FIGURES).glob(f"{run['id']}*/{pattern}"))
            found += [(path, _values(run, axes)) for path in paths if path.is_file()]
        if len(found) >= _MAX_PICTURES:
            break
    return found[:_MAX_PICTURES]
