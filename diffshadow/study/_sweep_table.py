"""The tables of a sweep. That of results depends on the configuration alone, whatever happened meanwhile."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import csv, parquet

from .. import io
from ..config import Sweep
from ._sweep_work import Outcome

RESULTS, RESULTS_CSV, TIMINGS = "results.parquet", "results.csv", "timings.parquet"
MISSING = "missing"
"""The status of a run that has not been done yet."""

Outcomes = Mapping[str, Outcome]
Columns = Mapping[str, Sequence[Any]]


def results_of(sweep: Sweep, outcomes: Outcomes) -> pa.Table:
    """A row for each run, in the sweep's order: its number, id, status and error, its values, its metrics.

    A value that is neither text nor a number is text in JSON, and so are all values of an axis of several kinds.
    """
    found = [outcomes.get(run.id) for run in sweep.runs]
    metrics = dict.fromkeys(name for outcome in found if outcome for name in outcome.metrics)
    return _table(
        {
            "run": range(len(sweep.runs)),
            "id": [run.id for run in sweep.runs],
            "status": [outcome.status if outcome else MISSING for outcome in found],
            "error": [outcome.error if outcome else None for outcome in found],
            **{axis: [run.values[axis] for run in sweep.runs] for axis in sweep.settings.axes},
            **{name: [outcome.metrics.get(name) if outcome else None for outcome in found] for name in metrics},
        }
    )


def timings_of(sweep: Sweep, outcomes: Outcomes) -> pa.Table:
    """Seconds of each run's stages, in the sweep's order."""
    found = [outcomes.get(run.id) for run in sweep.runs]
    stages = sorted({name for outcome in found if outcome for name in outcome.seconds})
    seconds = {name: [outcome.seconds.get(name) if outcome else None for outcome in found] for name in stages}
    return _table({"run": range(len(sweep.runs)), "id": [run.id for run in sweep.runs], **seconds})


def write_tables(folder: Path, sweep: Sweep, outcomes: Outcomes) -> pa.Table:
    """Writes all tables to `folder`. **Returns** that of results."""
    results = results_of(sweep, outcomes)
    for name, table in ((RESULTS, results), (TIMINGS, timings_of(sweep, outcomes))):
        with io.atomic_path(folder / name) as temporary:
            parquet.write_table(table, temporary)
    if sweep.settings.csv:
        with io.atomic_path(folder / RESULTS_CSV) as temporary:
            csv.write_csv(results, temporary)
    return results


def _table(columns: Mapping[str, Iterable[Any]]) -> pa.Table:
    return pa.table({name: _column(list(values)) for name, values in columns.items()})


def _column(values: Sequence[Any]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float}:
        # Where nothing is known of a column, it is one of numbers.
        return pa.array(values, pa.int64() if kinds == {int} else pa.float64())
    if kinds in ({str}, {bool}):
        return pa.array(values)
    return pa.array([None if v is None else json.dumps(v, ensure_ascii=False) for v in values], pa.string())
