"""Does the runs of a sweep. An interrupted sweep can be resumed."""

import contextlib
import fcntl
import itertools
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ... import io
from ..._words import counted
from ...config import LABEL, Sweep, SweepRun, describe
from ...console import Command, print_table, source
from ..pages import _table as table
from ..record._files import RESULT, write_record
from ..record._folder import folder_of, remove, write_whole
from ..record._sweeps import AdviseRecord, SweepRecord
from ..remarks._layout import frames_remarks
from ..runs._progress import counting
from ..runs._write import versions
from ._curves import Curve, columns_for, curves_of
from ._pace import Pace
from ._pool import pool
from ._report import report_sweep
from ._table import MISSING, Columns, Tables, gather, metric_columns, table_of, write_tables
from ._work import FAILED, OK, RUNS, Batch, drawing_of, read_outcome, reference_of, shape_of

SUFFIX = "-sweep"
"""The suffix of a sweep's folder."""
PLOT = "plot.png"
_LOCK = ".lock"
# The most runs in a batch, which a worker does without progress reports in between.
_BATCH = 16
# The least number of batches per worker, so that all workers finish at about the same time.
_BATCHES_PER_WORKER = 8
# The keys of so many references are looked up before their runs. It takes about 20 ms for each.
_FEW_REFERENCES = 256
# Configurations of runs that are made at a time.
_MAX_AT_ONCE = 4096
_MAX_SHOWN = 8
MAX_LISTED = 4096
"""The most runs for which a plan looks up whether each is done."""


def run_sweep(
    sweep: Sweep,
    *,
    console: Console,
    scheduler: str | None = None,
    workers: int | None = None,
    limit: int | None = None,
) -> Path:
    """Does every run of `sweep` that is not done yet, prints the results, and writes tables and a figure.

    A run that fails is recorded with its error, and tried again next time. A run whose folder is damaged is also done
    again. Runs that share compiled programs and drawings are done by the same worker, one after another.

    **Arguments:**

    - `sweep`: the sweep.
    - `console`: where results are printed.
    - `scheduler`: address of a Dask scheduler, whose workers have this code of the package. Workers need not share a
        file system with the command. By default local workers are started. They import the calling script, which must
        do its work under `if __name__ == "__main__"`.
    - `workers`: number of local worker processes; by default one per core. With 0, the runs are done in this process.
    - `limit`: the most runs to do, starting with the first missing one.

    **Returns** the folder, `<output>/<name>-sweep`.

    **Raises** `ValueError` if another process is doing the sweep in this folder, or the scheduler cannot be reached;
    `ConfigError` if the folder cannot be written; `FileError` if no space is left on its disk.
    """
    folder = folder_of(sweep.runs[0].config, SUFFIX).absolute()
    with doing(folder, sweep, SweepRecord, console, scheduler, workers, limit) as (tables, tried):
        curves, remarks = _plotted(folder, sweep, tables.results)
        remarks += _remarks_on_frames(sweep)
        counts = counts_of(tables.results)
        record = SweepRecord(**about(sweep, SweepRecord, counts))
        write_record(folder, record)
        report_sweep(folder, record)
    _print(console, sweep, tables.results, curves)
    table.print_lines(console, _summary(sweep, counts, tried, table_of(folder).name))
    table.print_lines(console, [*remarks, *failures(tables.results)], warn=True)
    return folder


@contextlib.contextmanager
def doing(
    folder: Path,
    sweep: Sweep,
    kind: type[SweepRecord | AdviseRecord],
    console: Console,
    scheduler: str | None,
    workers: int | None,
    limit: int | None = None,
    pace: Pace | None = None,
) -> Iterator[tuple[Tables, int]]:
    """Does the missing runs of `sweep` in `folder`, and writes its tables, like `run_sweep`.

    **Arguments:**

    - `kind`: the kind of the folder's record: a sweep, or what is made from one.
    - `pace`: prints how long the runs take.

    **Yields** the tables, and the number of runs that were tried now. Until the end of the block, no other process can
    do the sweep.
    """
    _begin(folder, sweep, kind)
    with _alone(folder), _saying_what_is_kept(folder, sweep):
        _remove_drafts(folder)
        with counting(console, "looking for results", len(sweep.runs)) as progress:
            todo = missing_runs(sweep, folder, progress)[:limit]
        if todo:
            try:
                _work(folder, sweep, todo, console, scheduler, workers, pace)
            finally:
                # Drafts of workers that have died.
                _remove_drafts(folder)
        with counting(console, "collecting results", len(sweep.runs)) as progress:
            tables = gather(sweep, folder, progress)
        write_tables(folder, sweep, tables)
        yield tables, len(todo)


def missing_runs(sweep: Sweep, folder: Path, progress: Callable[[int], None] = lambda done: None) -> list[int]:
    """The indices of the runs without a valid result in `folder`. If runs are equal, only the first is listed.

    **Arguments:**

    - `sweep`, `folder`: the sweep and its folder.
    - `progress`: called with the number of runs checked so far.
    """
    seen, missing = set(), []
    for index in range(len(sweep.runs)):
        id = sweep.runs.id(index)
        if id not in seen and read_outcome(folder, id, sweep.settings) is None:
            missing.append(index)
        seen.add(id)
        progress(index + 1)
    return missing


def print_plan(console: Console, sweep: Sweep, limit: int | None = None, suffix: str = SUFFIX) -> None:
    """Prints what `run_sweep` would do: the axes, and the first missing runs. Writes no files.

    For a large sweep, runs are not checked and results not looked up, since that would take minutes.

    **Arguments:**

    - `suffix`: suffix of the folder's name.
    """
    folder = sweep.runs[0].config.output_folder / f"{sweep.name}{suffix}"
    axes = Table("axis", "values", "", title=table.words(sweep.name), title_justify="left")
    axes.columns[1].justify = "right"
    choices = {axis: sweep.runs.choices(axis) for axis in sweep.settings.axes}
    # A label stands for the sections of its entry.
    labelled = {axis for entry in sweep.settings.list or () if LABEL in entry for axis in entry}
    has_sections = lambda axis: any(isinstance(value, Mapping | list) for value in choices[axis])
    choices = {axis: values for axis, values in choices.items() if not (axis in labelled and has_sections(axis))}
    for axis, chosen in choices.items():
        values = [_shown(value) for value in chosen]
        some = values[:_MAX_SHOWN] + ["…"] * (len(values) > _MAX_SHOWN)
        between = "; " if axis == LABEL else ", "
        axes.add_row(table.words(axis), f"{len(values)}", table.words(between.join(some)))
    print_table(console, axes)
    count, shown = len(sweep.runs), min(limit or _MAX_SHOWN, _MAX_SHOWN)
    if count <= MAX_LISTED:
        with counting(console, "checking", count) as progress:
            sweep.runs.check(lambda done, _: progress(done))
        missing = missing_runs(sweep, folder)
        unique = len({sweep.runs.id(index) for index in range(count)})
        number = len(missing[:limit])
        message = f"{counted(count, 'run')}; {unique - len(missing):,} are done; {number:,} would be done now"
    else:
        missing = range(count)
        message = f"{count:,} runs, too many to check each of them here; {_results_in(folder)}"
    for run in sweep.runs.at(missing[:shown]):
        values = ", ".join(
            f"{axis} = {_shown(run.values[axis])}" for axis in choices if run.values.get(axis) is not None
        )
        console.print(table.words(f"{run.id}  {values}"), soft_wrap=True)
    listed = ". The first are listed above" if len(missing[:limit]) > shown else ""
    console.print(table.words(message + listed), soft_wrap=True)


def _results_in(folder: Path) -> str:
    runs = folder / RUNS
    count = sum(not entry.name.startswith(".") for entry in os.scandir(runs)) if runs.is_dir() else 0
    return f"{folder} has {counted(count, 'folder')} of runs"


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 32 else f"{text[:32]}…"


def _begin(folder: Path, sweep: Sweep, kind: type[SweepRecord | AdviseRecord]) -> None:
    """Creates the sweep's folder if it does not exist.

    **Raises** `FileError` if the folder of the runs cannot be created in it.
    """
    if not (folder / RESULT).exists():
        record = kind(**about(sweep, kind, {}))
        write_whole(folder, lambda draft: write_record(draft, record))
    io.check_writable(folder / RUNS)
    (folder / RUNS).mkdir(exist_ok=True)


@contextlib.contextmanager
def _saying_what_is_kept(folder: Path, sweep: Sweep) -> Iterator[None]:
    """**Raises** `FullDiskError` that says how many runs are kept if no space is left."""
    try:
        yield
    except Exception as error:
        if not io.is_full_disk(error):
            raise
        # Drafts and programs that could not be written are gone.
        unique = len({sweep.runs.id(index) for index in range(len(sweep.runs))})
        kept = unique - len(missing_runs(sweep, folder))
        # Something other than a run's folder may have been full, such as the folder for temporary files.
        said = str(error) if isinstance(error, io.FileError) else f"cannot write for the sweep in {folder}: {error}"
        raise io.FullDiskError(
            f"{said}; {kept:,} of {counted(unique, 'run')} {'is' if kept == 1 else 'are'} kept in {folder}, and not "
            "done again"
        ) from error


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keeps two processes from doing the same sweep. The system releases the lock of a process that dies."""
    with (folder / _LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"another process is doing the sweep in {folder}; expected none: wait for it to finish, or change "
                "output or name"
            ) from None
        yield


def _remove_drafts(folder: Path) -> None:
    """Removes the drafts of runs that were killed."""
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
    pace: Pace | None,
) -> None:
    """Does the runs with the indices `todo`."""
    failed = 0
    # Compilation dominates the first batches, and every worker would repeat it, so start no more workers than batches.
    useful = len(todo) if sweep.settings.run == "fit" else -(-len(todo) // _BATCH)
    with (
        counting(console, sweep.name, len(todo)) as progress,
        pool(scheduler, workers, useful, lambda text: table.print_lines(console, [text])) as where,
    ):
        if pace is not None:
            pace.begin(len(todo), where.workers)
        outcomes = where.outcomes(_batches(folder, sweep, todo, where.workers, where.programs))
        for done, outcome in enumerate(outcomes, start=1):
            failed += outcome.status == FAILED
            progress(done, f"{failed} failed" if failed else "")
            if pace is not None:
                pace.done(done, outcome.seconds)


def _batches(folder: Path, sweep: Sweep, todo: Sequence[int], workers: int, programs: str | None) -> Iterator[Batch]:
    """The runs with the indices `todo`, in batches that share programs and drawings. Made `_MAX_AT_ONCE` at a time."""
    size = max(1, min(_BATCH, len(todo) // (_BATCHES_PER_WORKER * workers)))
    # Workers do not need the lists of values, which may be long.
    settings = sweep.settings.model_copy(update=dict.fromkeys(("list", "grid", "zip", "qmc", "seeds", "plot")))
    batch = Batch(str(folder), settings, (), programs)
    for start in range(0, len(todo), _MAX_AT_ONCE):
        runs = list(sweep.runs.at(todo[start : start + _MAX_AT_ONCE]))
        batches = [batch._replace(runs=runs, shape=shape) for shape, runs in _together(runs, size, workers)]
        references = [{reference_of(run.config) for run in each.runs} for each in batches]
        uses = Counter(text for texts in references for text in texts)
        for each, texts in zip(batches, references, strict=True):
            shares = len(uses) <= _FEW_REFERENCES or any(uses[text] > 1 for text in texts)
            yield each._replace(shares=shares)


def _together(runs: Sequence[SweepRun], size: int, workers: int) -> Iterator[tuple[str, tuple[SweepRun, ...]]]:
    """Batches of up to `size` runs with their shape, which share programs, and drawings if possible. The slowest come
    first.

    Workers start with different programs, so that each program is compiled once and then found in the cache.
    """
    shapes: dict[str, list[SweepRun]] = {}
    for run in runs:
        shapes.setdefault(shape_of(run.config), []).append(run)
    groups = []
    taps = lambda item: getattr(item[1][0].config.filter, "samples", 0)
    for shape, alike in sorted(shapes.items(), key=taps, reverse=True):
        alike = sorted(alike, key=lambda run: drawing_of(run.config))
        groups.append([(shape, tuple(alike[start : start + size])) for start in range(0, len(alike), size)])
    beside = [groups[start : start + workers] for start in range(0, len(groups), workers)]
    layers = [layer for some in beside for layer in itertools.zip_longest(*some)]
    return (together for layer in layers for together in layer if together is not None)


def _plotted(folder: Path, sweep: Sweep, results: Columns) -> tuple[list[Curve], list[str]]:
    """Writes the sweep's figure. **Returns** its curves, and a remark if there is no figure."""
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


def _remarks_on_frames(sweep: Sweep) -> list[str]:
    """Remarks on the frames of runs that measure flicker, of the first runs."""
    if sweep.settings.flicker is None:
        return []
    some = sweep.runs.at(range(min(len(sweep.runs), _MAX_SHOWN)))
    return list(dict.fromkeys(remark for run in some if run.frames for remark in frames_remarks(run.frames)))


def counts_of(results: Columns) -> dict[str, int]:
    """The number of runs with each status."""
    return Counter(results["status"].tolist())


def about(sweep: Sweep, kind: type[SweepRecord | AdviseRecord], counts: Mapping[str, int]) -> dict[str, Any]:
    """The record of a sweep, of this `kind`, with the number of runs for each status."""
    verb = kind.model_fields["kind"].default
    return {
        "name": sweep.name,
        "source": sweep.source,
        "runs": len(sweep.runs),
        "done": counts.get(OK, 0),
        "failed": counts.get(FAILED, 0),
        "settings": sweep.settings,
        "versions": versions(),
        # Its page cannot know the folder in which it is pasted.
        "command": Command("", [verb, source(Path(sweep.source)), *sweep.overrides]).anywhere().text,
    }


def _print(console: Console, sweep: Sweep, results: Columns, curves: Sequence[Curve]) -> None:
    """Prints the sweep's figure in numbers; if there is none, the range of each metric."""
    plot = sweep.settings.plot
    if plot is not None and curves:
        shown = Table(title=table.words(f"{sweep.name}: {plot.y} against {plot.x}"), title_justify="left")
        x, ticks = curves[0].x, curves[0].ticks
        end = lambda i: f"at {x[i]:g}" if ticks is None else f"at {ticks[int(x[i])]}"
        three_digits = lambda value: "" if value is None else f"{value:.3f}"
        previous = ["", *(curve.panel for curve in curves)]
        columns = {
            plot.panels or "": ["" if c.panel == p else c.panel for c, p in zip(curves, previous, strict=False)],
            plot.lines or "": [curve.line for curve in curves],
            end(0): [f"{curve.y[0]:.4g}" for curve in curves],
            end(-1): [f"{curve.y[-1]:.4g}" for curve in curves],
            "slope": [three_digits(curve.slope) for curve in curves],
            "±": [three_digits(curve.error) for curve in curves],
        }
        columns = {head: texts for head, texts in columns.items() if any(texts)}
        for head in columns:
            justify: Any = "left" if head in (plot.panels, plot.lines) else "right"
            shown.add_column(table.words(head), justify=justify)
        for row in zip(*columns.values(), strict=True):
            shown.add_row(*map(table.words, row))
    else:
        shown = Table("metric", "least", "mean", "greatest", title=table.words(sweep.name), title_justify="left")
        for name in metric_columns(sweep.settings, list(results)):
            values = results[name].astype(np.float64)
            if (values := values[~np.isnan(values)]).size:
                shown.add_row(
                    table.words(name), *(f"{number:.4g}" for number in (values.min(), values.mean(), values.max()))
                )
    print_table(console, shown)


def _summary(sweep: Sweep, counts: Mapping[str, int], tried: int, table: str) -> list[str]:
    lines = [
        f"{counts.get(OK, 0):,} of {counted(len(sweep.runs), 'run')} {'is' if len(sweep.runs) == 1 else 'are'} done, "
        f"{tried:,} of them tried now; all are in {table}"
    ]
    if counts.get(MISSING, 0):
        lines.append("run the same command again to do the rest")
    return lines


def failures(results: Columns) -> list[str]:
    """A sentence on the runs that failed, if there are any."""
    errors = results["error"][results["status"] == FAILED].tolist()
    if not errors:
        return []
    first, kinds = errors[0], len(set(errors))
    more = f", and {counted(kinds - 1, 'other error')}" if kinds > 1 else ""
    first = "; ".join(first.splitlines())
    return [f"{counted(len(errors), 'run')} failed; the same command tries them again: {first}{more}"]
