"""Many runs from one file, to a folder of results that can be taken up again wherever it was left."""

import contextlib
import fcntl
import itertools
import json
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import pyarrow as pa
import pyarrow.compute as pc
from rich.console import Console
from rich.table import Table

from ... import io
from ...config import Sweep, SweepRun, describe
from ..files._run_folder import RESULT, folder_of, remove, write_whole
from ..files._schema import write_json
from ..pages import _table as table
from ..runs import _record as record
from ..runs._progress import counting
from ._curves import Curve, columns_for, curves_of
from ._pool import pool
from ._report import report_sweep
from ._table import MISSING, RESULTS, gather, metric_columns, write_tables
from ._work import FAILED, OK, RUNS, Batch, drawing_of, read_outcome, shape_of

SUFFIX = "-sweep"
"""Ends the name of a sweep's folder."""
PLOT = "plot.png"
_LOCK = ".lock"
# Runs of a batch at most: what a worker does in one go, and for how long the bar may stand still.
_BATCH = 16
# Batches for each worker at least, so that none is left with much to do when the others have ended.
_BATCHES_A_WORKER = 8
# Runs that are made at a time, to be shared out among the workers.
_MOST_AT_ONCE = 4096
_MOST_SHOWN = 8
MOST_LISTED = 4096
"""Runs of a sweep whose plan says of each whether it is done."""


def run_sweep(
    sweep: Sweep,
    *,
    console: Console,
    scheduler: str | None = None,
    workers: int | None = None,
    limit: int | None = None,
) -> Path:
    """Does every run of `sweep` that is not done yet, prints what came out, and writes tables and a figure.

    A run that fails is recorded with its error, and tried again next time; so is one whose folder is damaged. Runs that
    share programs and drawings are done by the same worker, one after another.

    **Arguments:**

    - `scheduler`: address of a Dask scheduler, whose workers have this package and see the same files; by default local
        workers are started. They import the calling script, which must do its work under `if __name__ == "__main__"`.
    - `workers`: local worker processes; by default one for each core. With 0, the runs are done in this process.
    - `limit`: runs to do at most, the first that are missing.

    **Returns** the folder, `<output>/<name>-sweep`.

    **Raises** `ValueError` if the folder is another sweep's that is under way, or the scheduler cannot be reached;
    `ConfigError` if the folder cannot be written.
    """
    folder = folder_of(sweep.runs[0].config, SUFFIX).absolute()
    _begin(folder, sweep)
    with _alone(folder):
        _remove_drafts(folder)
        with counting(console, "looking for results", len(sweep.runs)) as progress:
            todo = missing_runs(sweep, folder, progress)[:limit]
        if todo:
            try:
                _work(folder, sweep, todo, console, scheduler, workers)
            finally:
                # Those of workers that have died.
                _remove_drafts(folder)
        with counting(console, "gathering results", len(sweep.runs)) as progress:
            tables = gather(sweep, folder, progress)
        write_tables(folder, sweep, tables)
        curves, remarks = _plotted(folder, sweep, tables.results)
        counts = _counts_of(tables.results)
        _write_record(folder, sweep, counts)
        report_sweep(folder)
    _print(console, sweep, tables.results, curves)
    table.print_lines(console, _said(sweep, counts, len(todo)))
    table.print_lines(console, [*remarks, *_failures(tables.results)], warn=True)
    return folder


def missing_runs(sweep: Sweep, folder: Path, progress: Callable[[int], None] = lambda done: None) -> list[int]:
    """The numbers of the runs that have no good result in `folder`; of equal runs, the first.

    **Arguments:**

    - `progress`: called with how many runs have been looked for.
    """
    seen, missing = set(), []
    for index in range(len(sweep.runs)):
        id = sweep.runs.id(index)
        if id not in seen and read_outcome(folder, id, sweep.settings) is None:
            missing.append(index)
        seen.add(id)
        progress(index + 1)
    return missing


def print_plan(console: Console, sweep: Sweep, limit: int | None = None) -> None:
    """What `run_sweep` would do: the axes, and the first of the runs that are missing. Writes nothing.

    Of a large sweep, neither all runs are checked nor their results looked for, which would take minutes.
    """
    folder = sweep.runs[0].config.output_folder / f"{sweep.name}{SUFFIX}"
    axes = Table("axis", "values", "", title=table.words(sweep.name), title_justify="left")
    axes.columns[1].justify = "right"
    for axis in sweep.settings.axes:
        values = [_shown(value) for value in sweep.runs.choices(axis)]
        more = ", …" if len(values) > _MOST_SHOWN else ""
        axes.add_row(table.words(axis), f"{len(values)}", table.words(", ".join(values[:_MOST_SHOWN]) + more))
    console.print(axes)
    count, shown = len(sweep.runs), min(limit or _MOST_SHOWN, _MOST_SHOWN)
    if count <= MOST_LISTED:
        with counting(console, "checking", count) as progress:
            sweep.runs.check(lambda done, _: progress(done))
        missing = missing_runs(sweep, folder)
        unique = len({sweep.runs.id(index) for index in range(count)})
        number = len(missing[:limit])
        said = f"{count:,} runs, of which {unique - len(missing):,} are done; {number:,} would be done now"
    else:
        missing = range(count)
        said = f"{count:,} runs, too many to look at each of them here; {_results_in(folder)}"
    for run in sweep.runs.at(missing[:shown]):
        values = ", ".join(f"{axis} = {_shown(value)}" for axis, value in run.values.items() if value is not None)
        console.print(table.words(f"{run.id}  {values}"), soft_wrap=True)
    console.print(table.words(said), soft_wrap=True)


def _results_in(folder: Path) -> str:
    runs = folder / RUNS
    there = sum(not entry.name.startswith(".") for entry in os.scandir(runs)) if runs.is_dir() else 0
    return f"{folder} has {there:,} folders of runs"


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 32 else f"{text[:32]}…"


def _begin(folder: Path, sweep: Sweep) -> None:
    """Makes the sweep's folder, if it is not there yet.

    **Raises** `FileError` if the folder of the runs cannot be made in it.
    """
    if not (folder / RESULT).exists():
        write_whole(folder, lambda draft: _write_record(draft, sweep, {}))
    io.check_writable(folder / RUNS)
    (folder / RUNS).mkdir(exist_ok=True)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keeps two processes from doing one sweep. The system takes the lock from a process that dies."""
    with (folder / _LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"another process is doing the sweep in {folder}; expected none: wait for its end, or set output or "
                "name"
            ) from None
        yield


def _remove_drafts(folder: Path) -> None:
    """Removes what runs that were killed left half written."""
    for entry in (folder / RUNS).iterdir():
        if entry.name.startswith("."):
            remove(entry)


def _work(
    folder: Path,
    sweep: Sweep,
    todo: Sequence[int],
    console: Console,
    scheduler: str | None,
    workers: int | None,
) -> None:
    """Does the runs of the numbers `todo`."""
    failed = 0
    # Of one batch or two, compiling is most of the work: several workers would do it twice.
    useful = len(todo) if sweep.settings.run == "fit" else -(-len(todo) // _BATCH)
    with (
        counting(console, sweep.name, len(todo)) as progress,
        pool(scheduler, workers, useful) as where,
    ):
        outcomes = where.outcomes(_batches(folder, sweep, todo, where.workers))
        for done, outcome in enumerate(outcomes, start=1):
            failed += outcome.status == FAILED
            progress(done, f"{failed} failed" if failed else "")


def _batches(folder: Path, sweep: Sweep, todo: Sequence[int], workers: int) -> Iterator[Batch]:
    """The runs of the numbers `todo`, by what they share; as many at a time as there is memory for."""
    size = max(1, min(_BATCH, len(todo) // (_BATCHES_A_WORKER * workers)))
    # What a worker need not know may be long.
    settings = sweep.settings.model_copy(update=dict.fromkeys(("list", "grid", "zip", "qmc", "seeds", "plot")))
    batch = Batch(str(folder), settings, (), jax.config.jax_compilation_cache_dir)
    for start in range(0, len(todo), _MOST_AT_ONCE):
        runs = list(sweep.runs.at(todo[start : start + _MOST_AT_ONCE]))
        yield from (batch._replace(runs=together) for together in _together(runs, size, workers))


def _together(runs: Sequence[SweepRun], size: int, workers: int) -> Iterator[tuple[SweepRun, ...]]:
    """Up to `size` runs each that share programs, then drawings. Those that are likely to take longest come first.

    Workers that start together begin with different programs: what one has compiled, the others find in the cache.
    """
    shapes: dict[str, list[SweepRun]] = {}
    for run in runs:
        shapes.setdefault(shape_of(run.config), []).append(run)
    groups = []
    for alike in sorted(shapes.values(), key=lambda alike: -getattr(alike[0].config.filter, "samples", 0)):
        alike = sorted(alike, key=lambda run: drawing_of(run.config))
        groups.append([tuple(alike[start : start + size]) for start in range(0, len(alike), size)])
    beside = [groups[start : start + workers] for start in range(0, len(groups), workers)]
    layers = [layer for some in beside for layer in itertools.zip_longest(*some)]
    return (together for layer in layers for together in layer if together is not None)


def _plotted(folder: Path, sweep: Sweep, results: pa.Table) -> tuple[list[Curve], list[str]]:
    """The curves of the sweep's figure, which is written; and what is to be said where it cannot be."""
    plot = sweep.settings.plot
    if plot is None:
        return [], []
    try:
        curves = curves_of(columns_for(plot, results), plot)
    except ValueError as error:
        return [], [f"there is no figure: {error}"]
    from ._figures import write_plot

    with io.atomic_path(folder / PLOT) as temporary:
        write_plot(temporary, curves, plot, describe(sweep.runs[0].config))
    return curves, []


def _counts_of(results: pa.Table) -> dict[str, int]:
    """How many runs have each status."""
    found = results["status"].value_counts().to_pylist()
    return {each["values"]: each["counts"] for each in found}


def _write_record(folder: Path, sweep: Sweep, counts: Mapping[str, int]) -> None:
    whole = {
        "schema_version": record.SCHEMA_VERSION,
        "name": sweep.name,
        "kind": "sweep",
        "source": sweep.source,
        "runs": len(sweep.runs),
        "done": counts.get(OK, 0),
        "failed": counts.get(FAILED, 0),
        "settings": sweep.settings.model_dump(mode="json"),
        "versions": record.versions(),
        "command": shlex.join(["diffshadow", "sweep", sweep.source, *sweep.overrides]),
    }
    with io.atomic_path(folder / RESULT) as temporary:
        write_json(temporary, whole)


def _print(console: Console, sweep: Sweep, results: pa.Table, curves: Sequence[Curve]) -> None:
    """What the sweep's figure shows, in numbers; where there is none, the range of each metric."""
    plot = sweep.settings.plot
    if plot is not None and curves:
        shown = Table(title=table.words(f"{sweep.name}: {plot.y} against {plot.x}"), title_justify="left")
        for head in (plot.panels or "", plot.lines or ""):
            shown.add_column(table.words(head))
        ends = [f"at {curves[0].ticks[int(x)] if curves[0].ticks else f'{x:g}'}" for x in curves[0].x[[0, -1]]]
        for head in (*ends, "slope", "±"):
            shown.add_column(table.words(head), justify="right")
        for i, curve in enumerate(curves):
            panel = "" if i > 0 and curves[i - 1].panel == curve.panel else curve.panel
            slope, error = ("" if v is None else f"{v:.3f}" for v in (curve.slope, curve.error))
            shown.add_row(
                table.words(panel), table.words(curve.line), f"{curve.y[0]:.4g}", f"{curve.y[-1]:.4g}", slope, error
            )
    else:
        shown = Table("metric", "least", "mean", "greatest", title=table.words(sweep.name), title_justify="left")
        for name in metric_columns(sweep.settings, results.column_names):
            values = results[name].drop_null().to_numpy()
            if values.size:
                shown.add_row(
                    table.words(name), *(f"{number:.4g}" for number in (values.min(), values.mean(), values.max()))
                )
    console.print(shown)


def _said(sweep: Sweep, counts: Mapping[str, int], tried: int) -> list[str]:
    lines = [
        f"{counts.get(OK, 0):,} of {len(sweep.runs):,} runs are done, {tried:,} of them tried now; all are in {RESULTS}"
    ]
    if counts.get(MISSING, 0):
        lines.append("the same command does the rest")
    return lines


def _failures(results: pa.Table) -> list[str]:
    errors = results.filter(pc.field("status") == FAILED)["error"]
    if not len(errors):
        return []
    first, kinds = errors[0].as_py(), len(errors.unique())
    more = f", and {kinds - 1} other errors" if kinds > 1 else ""
    first = "; ".join(first.splitlines())
    return [f"{len(errors):,} runs failed, and are tried again by the same command: {first}{more}"]
