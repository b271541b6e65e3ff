"""Many runs from one file, to a folder of results that can be taken up again wherever it was left."""

import contextlib
import fcntl
import itertools
import json
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from .. import io
from ..config import Sweep, SweepRun, describe
from . import _record as record
from . import _table as table
from ._report_sweep import report_sweep
from ._run_folder import RESULT, folder_of, write_whole
from ._sweep_curves import Curve, curves_of
from ._sweep_pool import pool
from ._sweep_table import RESULTS, write_tables
from ._sweep_work import FAILED, OK, RUNS, Batch, Outcome, drawing_of, read_outcome, shape_of

SUFFIX = "-sweep"
"""Ends the name of a sweep's folder."""
PLOT = "plot.png"
_LOCK = ".lock"
# Runs of a batch at most: what a worker does in one go, and for how long the bar may stand still.
_BATCH = 16
# Batches for each worker at least, so that none is left with much to do when the others have ended.
_BATCHES_A_WORKER = 8
_MOST_SHOWN = 8


def run_sweep(
    sweep: Sweep,
    *,
    console: Console,
    scheduler: str | None = None,
    workers: int | None = None,
    limit: int | None = None,
) -> Path:
    """Does every run of `sweep` that is not done yet, prints what came out, and writes tables and a figure.

    A run that fails is recorded with its error, and tried again next time. Runs that share programs and drawings are
    done by the same worker, one after another.

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
        missing = missing_runs(sweep, folder)
        todo = missing[:limit]
        if todo:
            _work(folder, sweep, todo, console, scheduler, workers)
            # Those of workers that died meanwhile.
            _remove_drafts(folder)
        found = ((run.id, read_outcome(folder, run.id, failed=True)) for run in sweep.runs)
        outcomes = {id: outcome for id, outcome in found if outcome is not None}
        results = write_tables(folder, sweep, outcomes)
        curves, remarks = _plotted(folder, sweep, results.to_pydict())
        _write_record(folder, sweep, outcomes)
        report_sweep(folder)
    _print(console, sweep, outcomes, curves)
    table.print_lines(console, _counts(sweep, outcomes, todo))
    table.print_lines(console, [*remarks, *_failures(sweep, outcomes)], warn=True)
    return folder


def missing_runs(sweep: Sweep, folder: Path) -> list[SweepRun]:
    """The runs that have no good result in `folder`, each once."""
    return [run for run in {run.id: run for run in sweep.runs}.values() if read_outcome(folder, run.id) is None]


def print_plan(console: Console, sweep: Sweep, limit: int | None = None) -> None:
    """What `run_sweep` would do: the axes, and the first of the runs that are missing. Writes nothing."""
    folder = sweep.runs[0].config.output_folder / f"{sweep.name}{SUFFIX}"
    missing = missing_runs(sweep, folder)
    axes = Table("axis", "values", "", title=Text(sweep.name), title_justify="left")
    axes.columns[1].justify = "right"
    for axis in sweep.settings.axes:
        values = list(dict.fromkeys(_shown(run.values[axis]) for run in sweep.runs))
        more = ", …" if len(values) > _MOST_SHOWN else ""
        axes.add_row(Text(axis), f"{len(values)}", Text(", ".join(values[:_MOST_SHOWN]) + more))
    console.print(axes)
    for run in missing[: min(limit or _MOST_SHOWN, _MOST_SHOWN)]:
        shown = ", ".join(f"{axis} = {_shown(value)}" for axis, value in run.values.items() if value is not None)
        console.print(Text(f"{run.id}  {shown}"), soft_wrap=True)
    unique = len({run.id for run in sweep.runs})
    number = len(missing[:limit])
    console.print(
        Text(f"{len(sweep.runs):,} runs, of which {unique - len(missing):,} are done; {number:,} would be done now"),
        soft_wrap=True,
    )


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 32 else f"{text[:32]}…"


def _begin(folder: Path, sweep: Sweep) -> None:
    """Makes the sweep's folder, if it is not there yet."""
    if not (folder / RESULT).exists():
        write_whole(folder, lambda draft: _write_record(draft, sweep, {}))
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
            shutil.rmtree(entry, ignore_errors=True)


def _work(
    folder: Path,
    sweep: Sweep,
    todo: Sequence[SweepRun],
    console: Console,
    scheduler: str | None,
    workers: int | None,
) -> None:
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TextColumn("{task.fields[detail]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    total = len({run.id for run in sweep.runs})
    failed = 0
    # Of one batch or two, compiling is most of the work: several workers would do it twice.
    useful = len(todo) if sweep.settings.run == "fit" else -(-len(todo) // _BATCH)
    with bar, pool(scheduler, workers, useful) as where:
        task = bar.add_task(sweep.name, total=total, completed=total - len(todo), detail="")
        for outcome in where.outcomes(_batches(folder, sweep, todo, where.workers)):
            failed += outcome.status == FAILED
            bar.update(task, advance=1, detail=f"{failed} failed" if failed else "")


def _batches(folder: Path, sweep: Sweep, todo: Sequence[SweepRun], workers: int) -> list[Batch]:
    """The runs by what they share: programs first, then drawings. Those that are likely to take longest come first.

    Workers that start together begin with different programs: what one has compiled, the others find in the cache.
    """
    shapes: dict[str, list[SweepRun]] = {}
    for run in todo:
        shapes.setdefault(shape_of(run.config), []).append(run)
    size = max(1, min(_BATCH, len(todo) // (_BATCHES_A_WORKER * workers)))
    programs = jax.config.jax_compilation_cache_dir
    groups = []
    for runs in sorted(shapes.values(), key=lambda runs: -getattr(runs[0].config.filter, "samples", 0)):
        runs = sorted(runs, key=lambda run: drawing_of(run.config))
        parts = [tuple(runs[start : start + size]) for start in range(0, len(runs), size)]
        groups.append([Batch(str(folder), sweep.settings, part, programs) for part in parts])
    together = [groups[start : start + workers] for start in range(0, len(groups), workers)]
    layers = [layer for some in together for layer in itertools.zip_longest(*some)]
    return [batch for layer in layers for batch in layer if batch is not None]


def _plotted(folder: Path, sweep: Sweep, columns: Mapping[str, list[Any]]) -> tuple[list[Curve], list[str]]:
    """The curves of the sweep's figure, which is written; and what is to be said where it cannot be."""
    plot = sweep.settings.plot
    if plot is None:
        return [], []
    try:
        curves = curves_of(columns, plot)
    except ValueError as error:
        return [], [f"there is no figure: {error}"]
    from ._sweep_figures import write_plot

    with io.atomic_path(folder / PLOT) as temporary:
        write_plot(temporary, curves, plot, describe(sweep.runs[0].config))
    return curves, []


def _write_record(folder: Path, sweep: Sweep, outcomes: Mapping[str, Outcome]) -> None:
    whole = {
        "schema_version": record.SCHEMA_VERSION,
        "name": sweep.name,
        "kind": "sweep",
        "source": sweep.source,
        "runs": len(sweep.runs),
        "done": sum(outcome.status == OK for outcome in outcomes.values()),
        "failed": sum(outcome.status == FAILED for outcome in outcomes.values()),
        "settings": sweep.settings.model_dump(mode="json"),
        "versions": record.versions(),
        "command": shlex.join(["diffshadow", "sweep", sweep.source, *sweep.overrides]),
    }
    with io.atomic_path(folder / RESULT) as temporary:
        temporary.write_text(
            json.dumps(whole, indent=2, ensure_ascii=False) + "\n", encoding="utf-8", errors="backslashreplace"
        )


def _print(console: Console, sweep: Sweep, outcomes: Mapping[str, Outcome], curves: Sequence[Curve]) -> None:
    """What the sweep's figure shows, in numbers; where there is none, the range of each metric."""
    plot = sweep.settings.plot
    if plot is not None and curves:
        shown = Table(title=Text(f"{sweep.name}: {plot.y} against {plot.x}"), title_justify="left")
        for head in (plot.panels or "", plot.lines or ""):
            shown.add_column(Text(head))
        ends = [f"at {curves[0].ticks[int(x)] if curves[0].ticks else f'{x:g}'}" for x in curves[0].x[[0, -1]]]
        for head in (*ends, "slope", "±"):
            shown.add_column(Text(head), justify="right")
        for i, curve in enumerate(curves):
            panel = "" if i > 0 and curves[i - 1].panel == curve.panel else curve.panel
            slope, error = ("" if v is None else f"{v:.3f}" for v in (curve.slope, curve.error))
            shown.add_row(Text(panel), Text(curve.line), f"{curve.y[0]:.4g}", f"{curve.y[-1]:.4g}", slope, error)
    else:
        shown = Table("metric", "least", "mean", "greatest", title=Text(sweep.name), title_justify="left")
        every = [outcome.metrics for outcome in outcomes.values()]
        for name in dict.fromkeys(name for metrics in every for name in metrics):
            values = [v for metrics in every if (v := metrics.get(name)) is not None]
            if values:
                numbers = min(values), sum(values) / len(values), max(values)
                shown.add_row(Text(name), *(f"{number:.4g}" for number in numbers))
    console.print(shown)


def _counts(sweep: Sweep, outcomes: Mapping[str, Outcome], todo: Sequence[SweepRun]) -> list[str]:
    done = [outcomes.get(run.id) for run in sweep.runs]
    good = sum(outcome is not None and outcome.status == OK for outcome in done)
    lines = [f"{good:,} of {len(sweep.runs):,} runs are done, {len(todo):,} of them tried now; all are in {RESULTS}"]
    if any(outcome is None for outcome in done):
        lines.append("the same command does the rest")
    return lines


def _failures(sweep: Sweep, outcomes: Mapping[str, Outcome]) -> list[str]:
    failed = [o for run in sweep.runs if (o := outcomes.get(run.id)) is not None and o.status == FAILED]
    errors = dict.fromkeys(outcome.error for outcome in failed)
    if not failed:
        return []
    first = next(iter(errors))
    more = f", and {len(errors) - 1} other errors" if len(errors) > 1 else ""
    return [f"{len(failed):,} runs failed, and are tried again by the same command: {first}{more}"]
