"""Runs a fit: from its configuration to its folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from rich.console import Console

from ... import fit, shadow
from ..._arithmetic import as_array, as_float
from ..._words import counted
from ...config import Config, build_fittable
from .._drawn import Drawn
from ..files._run_folder import folder_of
from ..pages import _table as table
from ..remarks._fit import remarks
from ..remarks._layout import layout_remarks
from ..remarks._reference import reference_remarks
from ..remarks._verdict import verdict
from . import _pose as poses
from . import _record as record
from ._engine import CODE
from ._explained import fitted_images, unexplained
from ._fitted import FittedRun, states_of
from ._picture import run_picture
from ._progress import Stages
from ._setup import load
from ._shape import run_shape
from ._solve import check_processes, plan_fit, solve
from ._views import draw_views
from ._write_fit import write_fit


def run_fit(config: Config, *, console: Console) -> Path:
    """Fits the parameters or the shape of `config`, prints the result, and writes the run's folder.

    Where JAX has several processes, each of them calls this, and the first prints and writes.

    **Returns** the folder, `<output>/<name>`. An earlier run there is replaced only once everything is written.

    **Raises** `ValueError` for a mistake in the configuration, before any long computation.
    """
    check_processes(config)
    if config.fit.shape is not None:
        return run_shape(config, console=console)
    if config.reference.type == "picture":
        return run_picture(config, console=console)
    folder = folder_of(config)
    with Stages(console) as stages:
        fitted = fit_technique(config, stages)
        if jax.process_index() > 0:
            return folder
        with stages.stage("writing"):
            measured = write_fit(folder, fitted, stages.seconds)
    said = fitted.verdict
    table.print_lines(console, [said.sentence, *said.remedies], warn=said.kind == table.UNEXPLAINED)
    table.print_fit(
        console,
        config.name,
        fitted.plan.parameters,
        fitted.result.fitted,
        measured["before"],
        measured["after"],
    )
    if fitted.result.profiles:
        table.print_profiles(console, fitted.result.profiles, fitted.result.fitted)
        if fitted.result.sureness.prefer:
            chosen = "fit.prefer chose the fitted values among those with at most"
            table.print_lines(
                console, [f"{chosen} {100 * fitted.result.sureness.tolerance:.3g} % more than the least error"]
            )
    if fitted.result.front:
        table.print_front(console, list(fitted.result.fitted), fitted.result.front)
    if fitted.validation:
        unseen = measured["validation"]
        table.print_validation(console, len(fitted.views.validation), unseen["before"], unseen["after"])
    steps, seconds = fitted.result.steps, sum(stages.seconds.values())
    noise = table.noise_text(record.noise(fitted.drawn))
    if fitted.plan.arrangement is not None:
        poses.print_poses(console, fitted.plan, fitted.result)
    table.print_lines(
        console, [f"errors are under the hard compare; {noise}", f"{counted(steps, 'step')}, {seconds:.1f} s in all"]
    )
    for key, code in fitted.code.items():
        table.print_code(console, f"{CODE}, for {key}:", code)
    table.print_lines(console, fitted.remarks, warn=True)
    return folder


def fit_technique(config: Config, stages: Stages, on_step: Callable[[fit.Step], None] | None = None) -> FittedRun:
    """Fits the parameters of `config`, and measures the images before and after; `on_step` as in `fit.fit`."""
    loaded = load(config, stages)
    plan, technique = plan_fit(config, loaded.scene), build_fittable(config)
    views = draw_views(config, loaded, technique, stages)
    drawn = views.drawn
    if plan.arrangement is None:
        problems: list[Any] = [_problem(technique, each) for each in drawn]
    else:
        problems = poses.problems_of(plan, loaded.scene, drawn)
        drawn = poses.with_references_of(problems, drawn)
    result = solve(problems[: views.seen], plan, stages, on_step)
    with stages.stage("measuring"):
        (before, after), seen = states_of(plan, result, problems, drawn, stages)
        pairs = lambda images: stages.counted("errors of image", list(zip(images, drawn, strict=True)))
        errors_before, errors_after = ([record.measured(*pair) for pair in pairs(each)] for each in (before, after))
        left = unexplained(fitted_images(views, drawn, after, seen[1], result))
    of_seen = lambda errors: record.combined(errors[: views.seen], drawn[: views.seen])
    said = verdict(config, result, of_seen(errors_before)["rmse"], of_seen(errors_after)["rmse"], left)
    messages = [
        *views.remarks,
        *layout_remarks(technique, [each.key for each in drawn], [each.state for each in drawn]),
        *(reference_remarks(config, drawn) if len(views.all) == 1 else []),
        *remarks(config, result, said.kind),
    ]
    errors = errors_before, errors_after
    return FittedRun(config.name, config, plan, views, drawn, result, before, after, *errors, messages, seen, said)


def _problem(technique: shadow.FittableTechnique, drawn: Drawn) -> fit.TechniqueProblem:
    truth, mask = as_float(drawn.reference.visibility), as_array(drawn.mask)
    return fit.TechniqueProblem(technique, drawn.state, drawn.surface, truth, mask, drawn.scene)
