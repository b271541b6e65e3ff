"""The tables of a sweep. The table of results depends only on the configuration, not on the history of the sweep.

Tables are written with pyarrow as Parquet, or else as CSV.
"""

import csv
import importlib.util
import itertools
import json
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ... import io
from ..._types import HostArray
from ...config import Sweep, SweepConfig
from ._work import WHOLE, read_outcome

RESULTS, TIMINGS = "results", "timings"
"""The names of the tables' files, without their suffix."""
PARQUET, CSV = ".parquet", ".csv"
MISSING = "missing"
"""The status of a run that has not been done yet."""
_OWN = ("run", "id", "status", "error")
# Far more than any sweep has. A table with more rows is damaged.
_MAX_RUNS = 1 << 24

Columns = Mapping[str, HostArray]
"""Columns by name: of float64 with NaN where there is no value, or of text, truth values or whole numbers with None
there."""


class Tables(NamedTuple):
    """The results and timings of a sweep's runs.

    - `results`: one row per run, in the sweep's order: its index, id, status, error, values and metrics. Values that
        are neither text nor numbers are written as JSON, and so are all values of an axis of mixed types.
    - `timings`: the seconds of each run's stages, in the same order.
    """

    results: Columns
    timings: Columns


def gather(sweep: Sweep, folder: Path, progress: Callable[[int], None] = lambda done: None) -> Tables:
    """Reads the outcome of each run of `sweep` from `folder`. `progress` is called with the number of runs read."""
    count = len(sweep.runs)
    own = {name: np.full(count, None, object) for name in _OWN}
    # Columns of numbers are added as rows need them.
    metrics, seconds = (defaultdict[str, HostArray](lambda: np.full(count, np.nan)) for _ in range(2))
    for row in range(count):
        id = sweep.runs.id(row)
        outcome = read_outcome(folder, id, sweep.settings, failed=True)
        status, error = (MISSING, None) if outcome is None else (outcome.status, outcome.error)
        for name, value in zip(_OWN, (row, id, status, error), strict=True):
            own[name][row] = value
        if outcome is not None:
            for columns, numbers in ((metrics, outcome.metrics), (seconds, outcome.seconds)):
                for name, value in numbers.items():
                    columns[name][row] = np.nan if value is None else value
        progress(row + 1)
    axes = {axis: _column(sweep.runs.column(axis)) for axis in sweep.settings.axes}
    results = {name: _whole(column) if name in WHOLE else column for name, column in metrics.items()}
    stages = {name: seconds[name] for name in sorted(seconds)}
    return Tables({**own, **axes, **results}, {"run": own["run"], "id": own["id"], **stages})


def metric_columns(settings: SweepConfig, columns: Sequence[str]) -> list[str]:
    """All `columns` of a table that are metrics."""
    return [name for name in columns if name not in (*_OWN, *settings.axes)]


def is_gap(value: Any) -> bool:
    """Whether a run has no value: none, or NaN."""
    return value is None or value != value


def values_of(column: HostArray) -> list[Any]:
    """The values of a column, with none where a run has no value."""
    return [None if is_gap(value) else value for value in column.tolist()]


def rows_of(columns: Columns) -> list[dict[str, Any]]:
    """The rows of a table, with none where a run has no value."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*map(values_of, columns.values()), strict=True)]


def write_tables(folder: Path, sweep: Sweep, tables: Tables) -> None:
    """Writes all tables to `folder`."""
    has_arrow = _has_arrow()
    for name, columns in zip((RESULTS, TIMINGS), tables, strict=True):
        if has_arrow:
            _write_parquet(folder / f"{name}{PARQUET}", columns)
        else:
            # What an earlier sweep left would be read instead.
            (folder / f"{name}{PARQUET}").unlink(missing_ok=True)
        if not has_arrow or (sweep.settings.csv and name == RESULTS):
            _write_csv(folder / f"{name}{CSV}", columns)


def table_of(folder: Path) -> Path:
    """The file with the results of the sweep in `folder`.

    **Raises** `FileError` if there is none that can be read here.
    """
    parquet, text = (folder / f"{RESULTS}{suffix}" for suffix in (PARQUET, CSV))
    if parquet.is_file() and _has_arrow():
        return parquet
    if text.is_file():
        return text
    if parquet.is_file():
        raise io.FileError(
            f"{parquet} needs the package pyarrow, which is not installed; expected it: pip install pyarrow, or sweep "
            f"again, which then writes {text.name}"
        )
    raise io.FileError(
        f"{folder} holds an incomplete sweep: it has no {parquet.name} or {text.name}; expected a table of results: "
        "sweep again"
    )


def read_columns(file: Path) -> Columns:
    """The columns of a table.

    **Raises** `FileError` if it is damaged.
    """
    try:
        columns = _read_parquet(file) if file.suffix == PARQUET else _read_csv(file)
        rows = max(map(len, columns.values()), default=0)
        if rows > _MAX_RUNS:
            raise ValueError(f"it has more than {_MAX_RUNS:,} rows; expected no more")
        return columns
    except Exception as error:  # Arrow raises many types
        reason = " ".join(str(error).split()) or type(error).__name__
        raise io.FileError(f"{file} is damaged ({reason}); expected a sweep's table: sweep again") from error


def _has_arrow() -> bool:
    return importlib.util.find_spec("pyarrow") is not None


def _column(values: Sequence[Any]) -> HostArray:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int} and all(value is None or abs(value) < 2**63 for value in values):
        return _objects(values)
    if kinds <= {int, float}:
        # A column without values counts as numbers.
        return np.asarray([math.nan if value is None else float(value) for value in values], np.float64)
    if kinds in ({str}, {bool}):
        return _objects(values)
    return _objects([None if v is None else json.dumps(v, ensure_ascii=False) for v in values])


def _whole(numbers: HostArray) -> HostArray:
    return _objects([None if math.isnan(number) else int(number) for number in numbers.tolist()])


def _objects(values: Sequence[Any]) -> HostArray:
    column = np.empty(len(values), object)
    column[:] = values
    return column


def _write_parquet(file: Path, columns: Columns) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    # Where no run has failed, nothing else says that the errors are text.
    kind = lambda name: pa.string() if name in ("id", "status", "error") else None
    arrays = {name: pa.array(column, kind(name), from_pandas=True) for name, column in columns.items()}
    # A stream, since Arrow takes paths as text, and some paths are not valid text.
    with io.atomic_path(file) as temporary, temporary.open("wb") as stream:
        parquet.write_table(pa.table(arrays), stream)


def _read_parquet(file: Path) -> Columns:
    import pyarrow as pa
    from pyarrow import parquet

    with file.open("rb") as stream, parquet.ParquetFile(stream) as stored:
        if stored.metadata.num_rows > _MAX_RUNS:
            raise ValueError(f"it has {stored.metadata.num_rows:,} rows; expected at most {_MAX_RUNS:,}")
        names = stored.schema_arrow.names
        if len(set(names)) < len(names):
            raise ValueError("it has two columns with the same name")
        found = stored.read()
    is_number = lambda kind: pa.types.is_floating(kind)
    return {
        name: column.to_numpy().astype(np.float64) if is_number(column.type) else _objects(column.to_pylist())
        for name, column in zip(names, found.columns, strict=True)
    }


def _write_csv(file: Path, columns: Columns) -> None:
    """Numbers are written as they are, with `nan` where there is none, and text in quotation marks."""
    with io.atomic_path(file) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(zip(*map(_cells, columns.values()), strict=True))


def _cells(column: HostArray) -> list[float | int | str]:
    values = column.tolist()
    if all(value is None or isinstance(value, str | bool) for value in values):
        return ["" if value is None else str(value) for value in values]
    return [math.nan if value is None else value for value in values]


def _read_csv(file: Path) -> Columns:
    with file.open(encoding="utf-8", newline="") as stream:
        rows = csv.reader(stream, quoting=csv.QUOTE_NONNUMERIC, strict=True)
        names: list[Any] = next(rows, [])
        if len(set(names)) < len(names):
            raise ValueError("it has two columns with the same name")
        cells = list(itertools.islice(rows, _MAX_RUNS + 1))
    if any(len(row) != len(names) for row in cells):
        raise ValueError("its rows differ in length")
    columns = zip(*cells, strict=True) if cells else [()] * len(names)
    return {name: _read_cells(name, column) for name, column in zip(names, columns, strict=True)}


def _read_cells(name: str, cells: Sequence[Any]) -> HostArray:
    kinds = set(map(type, cells))
    if len(kinds) > 1:
        raise ValueError(f"its column {name} holds text and numbers; expected one of them")
    if kinds == {str}:
        return _objects([cell or None for cell in cells])
    numbers = np.asarray(cells, np.float64)
    is_whole = len(numbers) and (np.trunc(numbers) == numbers).all() and (np.abs(numbers) < 2**53).all()
    return _objects([int(number) for number in cells]) if is_whole else numbers
