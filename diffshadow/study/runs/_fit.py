"""Runs a fit: builds it, fits, measures, says what it comes to, and writes its folder."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
from rich.console import Console

from ... import fit
from ..._arithmetic import as_array, as_float
from ...config import Config, ConfigError, FitPlan, Mistake, build_fittable
from ..pages._console import print_run
from ..record._folder import folder_of
from ._checkpoint import Checkpoint
from ._picture import FittedPicture, picture_problem
from ._progress import Progress
from ._setup import load, plan_fit
from ._shape import fit_shape
from ._views import draw_views
from ._visibility import FittedRun, problems_of, states_of, with_references_of
from ._write import write_run


def run_fit(config: Config, *, console: Console) -> Path:
    """Fits the parameters or the shape of `config`, prints the result, and writes the run's folder.

    If JAX has several processes, each calls this function, and the first prints and writes.

    **Returns** the folder, `<output>/<name>`. An earlier run there is replaced only once everything is written.

    **Raises** `ValueError` for a mistake in the configuration, before any long computation.
    """
    _check_processes(config)
    folder = folder_of(config)
    with Progress(console) as progress:
        if config.fit.shape is not None:
            run, result = fit_shape(config, progress), None
        else:
            run = (fit_picture if config.reference.type == "picture" else fit_technique)(config, progress)
            result = run.result
        if jax.process_index() > 0:
            return folder
        with progress.stage("writing"):
            record = write_run(folder, run, progress.seconds)
    if config.fit.shape is not None:
        Checkpoint(config, folder).remove()
    print_run(console, record, sum(progress.seconds.values()), result)
    return folder


def fit_technique(config: Config, progress: Progress, on_step: Callable[[fit.Step], None] | None = None) -> FittedRun:
    """Fits the parameters of `config` to visibility, and measures the images before and after; `on_step` as in
    `fit.fit`."""
    loaded = load(config, progress)
    plan, technique = plan_fit(config, loaded.scene), build_fittable(config)
    views = draw_views(config, loaded, technique, progress)
    drawn = views.drawn
    if plan.arrangement is None:
        problems: list[Any] = [
            fit.TechniqueProblem(
                technique,
                each.stored,
                each.surface,
                as_float(each.reference.visibility),
                as_array(each.mask),
                each.scene,
            )
            for each in drawn
        ]
    else:
        problems = problems_of(plan, loaded.scene, drawn)
        drawn = with_references_of(problems, drawn)
    result = _solved(problems[: views.seen], plan, progress, on_step)
    with progress.stage("measuring"):
        states = states_of(result, problems, drawn, progress)
        return FittedRun(config.name, config, result, plan.truth, views, drawn, *states)


def fit_picture(config: Config, progress: Progress) -> FittedPicture:
    """Fits the parameters of `config` to a picture, and measures the pictures before and after."""
    problem, planned = picture_problem(config, progress)
    result = _solved([problem], planned.fit, progress)
    with progress.stage("measuring"):
        return FittedPicture.of(config.name, config, result, planned.fit.truth, planned.remarks)


def _solved(
    problems: Sequence[fit.AbstractProblem],
    plan: FitPlan,
    progress: Progress,
    on_step: Callable[[fit.Step], None] | None = None,
) -> fit.FitResult:
    """Fits the parameters of `plan`. Its times are added to `progress`."""
    progress.show("compiling")
    result = fit.fit(
        problems,
        plan.parameters,
        solver=plan.solver,
        anneal=plan.anneal,
        loss=plan.loss,
        search=plan.search,
        sureness=plan.sureness,
        on_step=on_step,
        progress=lambda detail, done: progress.show("fitting", detail, done),
    )
    progress.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    return result


def _check_processes(config: Config) -> None:
    """**Raises** `ConfigError` where JAX has several processes, and these cannot share the fit of `config`."""
    processes = jax.process_count()
    if processes == 1:
        return
    if config.moves or config.fit.shape is not None or config.reference.type == "picture":
        place, said = ("fit",), "expected one: they can share only the fit of a technique to images of its shadows"
    elif config.fit.devices == 1:
        place, said = ("fit", "devices"), "expected devices: 0, so that all of them share the fit"
    else:
        return
    message = f"JAX has {processes} processes; {said}"
    raise ConfigError([Mistake(config.origin.place(place), ".".join(place), message)])
