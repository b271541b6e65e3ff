"""The tables of a sweep. The table of results depends only on the configuration, not on the history of the sweep."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from ... import io
from ..._types import HostArray
from ...config import Sweep, SweepConfig
from ._work import WHOLE, read_outcome

RESULTS, RESULTS_CSV, TIMINGS = "results.parquet", "results.csv", "timings.parquet"
_OWN = ("run", "id", "status", "error")
MISSING = "missing"
"""The status of a run that has not been done yet."""


class Tables(NamedTuple):
    """The results and timings of a sweep's runs.

    - `results`: one row per run, in the sweep's order: its index, id, status, error, values and metrics. Values that
        are neither text nor numbers are written as JSON, and so are all values of an axis of mixed types.
    - `timings`: the seconds of each run's stages, in the same order.
    """

    results: pa.Table
    timings: pa.Table


class _Numbers:
    """Columns of numbers, added as rows need them, with gaps; eight bytes per number."""

    def __init__(self, rows: int):
        self._rows = rows
        self._columns: dict[str, HostArray] = {}

    def put(self, row: int, name: str, value: float | int | None) -> None:
        column = self._columns.setdefault(name, np.full(self._rows, np.nan))
        column[row] = np.nan if value is None else value

    def arrays(self) -> dict[str, pa.Array]:
        found = {name: pa.array(column, from_pandas=True) for name, column in self._columns.items()}
        return {name: array.cast(pa.int64()) if name in WHOLE else array for name, array in found.items()}


def gather(sweep: Sweep, folder: Path, progress: Callable[[int], None] = lambda done: None) -> Tables:
    """Reads the outcome of each run of `sweep` from `folder`. `progress` is called with the number of runs read."""
    count = len(sweep.runs)
    ids, status, errors = [], [], []
    metrics, seconds = _Numbers(count), _Numbers(count)
    for row in range(count):
        ids.append(sweep.runs.id(row))
        outcome = read_outcome(folder, ids[row], sweep.settings, failed=True)
        status.append(MISSING if outcome is None else outcome.status)
        errors.append(None if outcome is None else outcome.error)
        if outcome is not None:
            for name, value in outcome.metrics.items():
                metrics.put(row, name, value)
            for name, value in outcome.seconds.items():
                seconds.put(row, name, value)
        progress(row + 1)
    own = {"run": pa.array(np.arange(count)), "id": pa.array(ids, pa.string())}
    axes = {axis: _column(sweep.runs.column(axis)) for axis in sweep.settings.axes}
    outcomes = {"status": pa.array(status, pa.string()), "error": pa.array(errors, pa.string())}
    stages = seconds.arrays()
    return Tables(
        pa.table({**own, **outcomes, **axes, **metrics.arrays()}),
        pa.table({**own, **{name: stages[name] for name in sorted(stages)}}),
    )


def metric_columns(settings: SweepConfig, columns: Sequence[str]) -> list[str]:
    """All `columns` of a table that are metrics."""
    return [name for name in columns if name not in (*_OWN, *settings.axes)]


def write_tables(folder: Path, sweep: Sweep, tables: Tables) -> None:
    """Writes all tables to `folder`."""
    for name, table in ((RESULTS, tables.results), (TIMINGS, tables.timings)):
        # A stream, since Arrow takes paths as text, and some paths are not valid text.
        with io.atomic_path(folder / name) as temporary, temporary.open("wb") as stream:
            parquet.write_table(table, stream)
    if sweep.settings.csv:
        with io.atomic_path(folder / RESULTS_CSV) as temporary, temporary.open("wb") as stream:
            csv.write_csv(tables.results, stream)


def _column(values: Sequence[Any]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int} and all(value is None or abs(value) < 2**63 for value in values):
        return pa.array(values, pa.int64())
    if kinds <= {int, float}:
        # A column without values counts as numbers.
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if kinds in ({str}, {bool}):
        return pa.array(values)
    return pa.array([None if v is None else json.dumps(v, ensure_ascii=False) for v in values], pa.string())
