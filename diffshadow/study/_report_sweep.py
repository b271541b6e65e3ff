"""The report of a sweep: what came out for each combination of values, its figure, and what failed."""

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from .. import io
from ..config import PlotConfig, Row, describe, load_config
from ._stored import REPORT, read_result
from ._sweep_curves import curves_of, unit_of, with_unit
from ._sweep_table import MISSING, RESULTS
from ._sweep_work import FAILED, FIGURES, OK, RUNS

Runs = Any
"""A data frame with a row for each run; pandas' own types tell a checker too little."""
_SEED = "seed"
_OWN_COLUMNS = ("run", "id", "status", "error", _SEED)
# More combinations, pictures of runs and values of an axis than these are not shown.
_MOST_ROWS, _MOST_PICTURES, _MOST_VALUES = 2000, 24, 12
# What stands for a run among the figures that it wrote.
_RUN_PICTURES = ("comparison*.png", "difference*.png")


class Summary(NamedTuple):
    """The results by combination: names of axes and metrics, and for each combination their texts and its runs."""

    axes: list[str]
    metrics: list[str]
    rows: list[tuple[list[str], list[str], int]]


def report_sweep(folder: Path, form: str | None = None) -> Path:
    """Writes the page of the sweep in `folder`, and where `form` says so its figure. **Returns** the page.

    **Raises** `FileError` if the sweep's table is missing or damaged.
    """
    from ._page import file_pictures, write_page

    result = read_result(folder)
    runs = _read_table(folder)
    axes = [axis for axis in _axes(result["settings"]) if axis in runs.columns]
    settings = _settings(folder, runs)
    figure = _figure(folder, result, runs, settings, form)
    good = runs[runs["status"] == OK]
    summary = _summary(good, axes)
    loose = [path for path in _pictures(folder) if figure is None or path.stem != "plot"]
    write_page(
        folder / REPORT,
        "sweep.html.j2",
        name=result["name"],
        kind=result["settings"].get("run", "render"),
        total=len(runs),
        done=len(good),
        missing=int((runs["status"] == MISSING).sum()),
        axes=[(axis, _listed(runs[axis].dropna().unique().tolist()), unit_of(settings, axis)) for axis in axes],
        summary=summary._replace(rows=summary.rows[:_MOST_ROWS]),
        heads=[with_unit(settings, axis) for axis in axes],
        left_out=max(len(summary.rows) - _MOST_ROWS, 0),
        seeds=int(good[_SEED].nunique()) if _SEED in good else 1,
        figure=figure,
        pictures=[
            p._replace(title=title) for path, title in _of_runs(folder, runs, axes) for p in file_pictures([path])
        ],
        files=file_pictures(loose),
        failures=_failures(runs, axes),
        settings=settings,
        environment=[(name, value, "") for name, value in result.get("versions", {}).items()],
        command=result.get("command", ""),
    )
    return folder / REPORT


def _read_table(folder: Path) -> Runs:
    file = folder / RESULTS
    if not file.is_file():
        raise io.FileError(f"{folder} holds only a part of a sweep: it has no {RESULTS}; expected it: sweep again")
    try:
        runs = pd.read_parquet(file)
        return runs.assign(status=runs["status"], error=runs["error"], id=runs["id"])
    except Exception as error:  # Arrow raises what it likes
        raise io.FileError(f"{file} is damaged ({error}); expected a sweep's table: sweep again") from error


def _axes(settings: Mapping[str, Any]) -> list[str]:
    """The columns of what was swept, the seed apart."""
    entries = [key for entry in settings.get("list") or () for key in entry]
    ranges = (settings.get("qmc") or {}).get("axes", {})
    every = dict.fromkeys([*entries, *(settings.get("grid") or ()), *(settings.get("zip") or ()), *ranges])
    return [key for key in every if key != _SEED]


def _summary(good: Runs, axes: Sequence[str]) -> Summary:
    """Means over all runs of one combination, which differ in their seeds, and the standard errors of these means."""
    numbers = good.select_dtypes("number").columns
    metrics = [name for name in numbers if name not in (*_OWN_COLUMNS, *axes)]
    groups = good.groupby(list(axes), sort=False, dropna=False) if axes else [((), good)]
    rows = []
    for key, runs in groups:
        mean, error = runs[metrics].mean(), runs[metrics].sem()
        texts = [_mean(mean[name], error[name]) for name in metrics]
        rows.append(([_text(value) for value in key], texts, len(runs)))
    return Summary(list(axes), metrics, rows)


def _mean(mean: float, error: float) -> str:
    """A mean with its standard error, which has two digits, and the mean as many decimals."""
    if pd.isna(mean):
        return "–"
    if pd.isna(error) or error <= 0:
        return f"{mean:.4g}"
    decimals = max(1 - math.floor(math.log10(error)), 0)
    return f"{mean:.{decimals}f} ± {error:.{decimals}f}"


def _text(value: Any) -> str:
    if pd.isna(value):
        # An entry of the list leaves it as it is.
        return "–"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _listed(values: Sequence[Any]) -> str:
    more = f", … ({len(values)} values)" if len(values) > _MOST_VALUES else ""
    return ", ".join(map(_text, values[:_MOST_VALUES])) + more


def _failures(runs: Runs, axes: Sequence[str]) -> list[tuple[str, int, str]]:
    """Each error, how many runs it befell, and the first of these."""
    failed = runs[runs["status"] == FAILED]
    return [(str(error), len(each), _values(each.iloc[0], axes)) for error, each in failed.groupby("error", sort=False)]


def _values(run: Runs, axes: Sequence[str]) -> str:
    shown = [*axes, *([_SEED] if _SEED in run.index else [])]
    return ", ".join(f"{axis} = {_text(run[axis])}" for axis in shown if not pd.isna(run[axis]))


def _settings(folder: Path, runs: Runs) -> list[Row]:
    """The settings of the first run that has been done."""
    for id in runs["id"]:
        file = folder / RUNS / id / "config.yaml"
        if file.is_file():
            return describe(load_config(file, []))
    return []


def _figure(
    folder: Path, result: Mapping[str, Any], runs: Runs, settings: Sequence[Row], form: str | None
) -> str | None:
    """The sweep's figure for the page, if it has one; written to the folder, too, where `form` says so."""
    from . import style
    from ._sweep_figures import write_plot

    if result["settings"].get("plot") is None:
        return None
    plot = PlotConfig.model_validate(result["settings"]["plot"])
    columns = {name: [None if pd.isna(v) else v for v in runs[name].tolist()] for name in runs.columns}
    try:
        curves = curves_of(columns, plot)
    except ValueError:
        # No run has what is to be drawn; the failures say why.
        return None
    if form is not None:
        write_plot(folder / f"plot.{form}", curves, plot, settings)
    with tempfile.TemporaryDirectory() as scratch:
        write_plot(Path(scratch) / "plot.svg", curves, plot, settings)
        return style.themed((Path(scratch) / "plot.svg").read_text(encoding="utf-8"))


def _pictures(folder: Path) -> list[Path]:
    """All pictures that lie in the folder itself."""
    return sorted(path for path in folder.iterdir() if path.suffix in (".png", ".svg"))


def _of_runs(folder: Path, runs: Runs, axes: Sequence[str]) -> list[tuple[Path, str]]:
    """A picture of each run that wrote some, and the run's values."""
    found = []
    for _, run in runs.iterrows():
        for pattern in _RUN_PICTURES:
            found += [(path, _values(run, axes)) for path in sorted((folder / FIGURES).glob(f"{run['id']}*/{pattern}"))]
    return found[:_MOST_PICTURES]
