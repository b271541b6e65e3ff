"""Runs a fit: from its configuration to its folder."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32
from rich.console import Console

from ... import fit, shadow
from ..._misc import as_array, as_float
from ..._types import HostArray
from ...config import Config, FitPlan, build_fit, build_fittable
from .._drawn import Drawn
from ..files._run_folder import folder_of, write_whole
from ..files._stored import stored, to_bytes
from ..pages import _table as table
from ..remarks._fit import remarks
from ..remarks._layout import layout_remarks
from ..remarks._reference import reference_remarks
from ..remarks._verdict import Verdict, verdict
from . import _pose as poses
from . import _record as record
from ._engine import CODE, code_of
from ._explained import fitted_images, unexplained
from ._progress import Stages
from ._setup import load, visibility_of
from ._shade import Pictures, perceptual_error, shade
from ._shape import run_shape
from ._views import DrawnView, Views, draw_views

Images = list[Float32[HostArray, "h w"]]
# Of views, the worst have pictures.
_MAX_SHOWN = 8


class FittedRun(NamedTuple):
    """A finished fit, with its images and their errors under the hard compare, one for each view and light.

    - `views`: all that the fit sees, and its validation.
    - `seen`: the scenes before and after the fit, which may move lights and meshes; `drawn` is the truth.
    - `verdict`: what the fit comes to.
    """

    config: Config
    plan: FitPlan
    views: Views
    drawn: list[Drawn]
    result: fit.FitResult
    before: Images
    after: Images
    errors_before: list[dict[str, float]]
    errors_after: list[dict[str, float]]
    remarks: list[str]
    seen: tuple[list[Drawn], list[Drawn]]
    verdict: Verdict

    @property
    def mapped(self) -> list[Drawn]:
        """The scene with the stored maps: of the fitted technique, or of the true lights and meshes."""
        return self.seen[1] if self.plan.arrangement is None else self.drawn

    @property
    def has_views(self) -> bool:
        """Whether there are other views than the configuration's own scene."""
        return len(self.views.all) > 1 or bool(self.config.views)

    @property
    def code(self) -> dict[str, str]:
        """The code for the lights of an engine, by their keys; of several views, for the first."""
        first = self.views.fitted[0]
        return code_of(self.result.technique, first.config, self.mapped[: len(first.drawn)])

    @property
    def shown(self) -> list[int]:
        """The indices of the scenes and lights whose pictures are written: all, or only the worst views'."""
        if not self.has_views:
            return list(range(len(self.drawn)))
        errors = np.nan_to_num([errors["rmse"] for errors in self.errors_after])
        return np.argsort(-errors, kind="stable")[:_MAX_SHOWN].tolist()

    @property
    def errors(self) -> dict[str, dict[str, float]]:
        """The errors `before` and `after` the fit over all that it sees."""
        return self._errors(slice(self.views.seen))

    @property
    def validation(self) -> dict[str, dict[str, float]]:
        """The errors `before` and `after` the fit over the validation; empty if there is none."""
        return self._errors(slice(self.views.seen, None)) if self.views.validation else {}

    def _errors(self, part: slice) -> dict[str, dict[str, float]]:
        states = {"before": self.errors_before, "after": self.errors_after}
        return {state: record.combined(errors[part], self.drawn[part]) for state, errors in states.items()}


def run_fit(config: Config, *, console: Console) -> Path:
    """Fits the parameters or the shape of `config`, prints the result, and writes the run's folder.

    **Returns** the folder, `<output>/<name>`. An earlier run there is replaced only once everything is written.

    **Raises** `ValueError` for a mistake in the configuration, before any long computation.
    """
    if config.fit.shape is not None:
        return run_shape(config, console=console)
    folder = folder_of(config)
    with Stages(console) as stages:
        fitted = fit_technique(config, stages)
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
        if fitted.plan.prefer:
            chosen = "fit.prefer chose the fitted values among those with at most"
            table.print_lines(console, [f"{chosen} {100 * fitted.plan.tolerance:.3g} % more than the least error"])
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
        console, [f"errors are under the hard compare; {noise}", f"{steps} steps, {seconds:.1f} s in all"]
    )
    for key, code in fitted.code.items():
        table.print_code(console, f"{CODE}, for {key}:", code)
    table.print_lines(console, fitted.remarks, warn=True)
    return folder


def write_fit(folder: Path, fitted: FittedRun, seconds: dict[str, float]) -> dict[str, Any]:
    """Writes the run's folder; `seconds` are the times of its stages. **Returns** the metrics of its result."""
    shaded = _shaded(fitted)
    result = _result(folder, fitted, shaded, seconds)
    write_whole(folder, lambda draft: _write(draft, fitted, shaded, result))
    return result["metrics"]


def fit_technique(config: Config, stages: Stages) -> FittedRun:
    """Fits the parameters of `config`, and measures the images before and after."""
    loaded = load(config, stages)
    plan, technique = build_fit(config, loaded.scene), build_fittable(config)
    views = draw_views(config, loaded, technique, stages)
    drawn = views.drawn
    if plan.arrangement is None:
        problems: list[Any] = [_problem(technique, each) for each in drawn]
    else:
        problems = poses.problems_of(plan, loaded.scene, drawn)
        drawn = poses.with_references_of(problems, drawn)
    stages.show("compiling")
    result = fit.fit(
        problems[: views.seen],
        plan.parameters,
        solver=plan.solver,
        anneal=plan.anneal,
        loss=plan.loss,
        search=fit.Search(plan.starts, config.seed, plan.blurs, plan.evaluations),
        sureness=fit.Sureness(plan.within, plan.prefer, plan.tolerance, plan.front),
        on_step=_watch(stages, plan),
    )
    stages.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    with stages.stage("measuring"):
        start = list(result.initial.values())
        if result.arrangement is None:
            techniques = fit.with_parameters(result.technique, plan.parameters, start), result.technique
            laid_out = [*result.problems, *problems[views.seen :]]
            seen_before, seen_after = (_seen_with(technique, laid_out, drawn) for technique in techniques)
            seen = seen_before, seen_after
            before, after = (
                [visibility_of(technique, each) for each in shown]
                for technique, shown in zip(techniques, seen, strict=True)
            )
        else:
            subjects = fit.with_parameters(result.arrangement, plan.parameters, start), result.arrangement
            (before, *seen_before), (after, *seen_after) = (
                poses.images_at(result.problems, drawn, s) for s in subjects
            )
            seen = seen_before[0], seen_after[0]
        errors_before, errors_after = (list(map(record.measured, images, drawn)) for images in (before, after))
        left = unexplained(fitted_images(views, drawn, after, seen[1], result.arrangement))
    of_seen = lambda errors: record.combined(errors[: views.seen], drawn[: views.seen])
    said = verdict(config, plan, result, of_seen(errors_before)["rmse"], of_seen(errors_after)["rmse"], left)
    messages = [
        *views.remarks,
        *layout_remarks(technique, drawn),
        *(reference_remarks(config, drawn) if len(views.all) == 1 else []),
        *remarks(config, plan, result, said.kind),
    ]
    errors = errors_before, errors_after
    return FittedRun(config, plan, views, drawn, result, before, after, *errors, messages, seen, said)


def _problem(technique: shadow.FittableTechnique, drawn: Drawn) -> fit.TechniqueProblem:
    truth, mask = as_float(drawn.reference.visibility), as_array(drawn.mask)
    return fit.TechniqueProblem(technique, drawn.state, drawn.surface, truth, mask, drawn.scene)


def _seen_with(
    technique: shadow.FittableTechnique, problems: Sequence[fit.AbstractProblem], drawn: list[Drawn]
) -> list[Drawn]:
    """`drawn`, with maps laid out as the technique says."""
    laid_out: Any = [problem.laid_out(technique) for problem in problems]
    return [each._replace(state=problem.shadow_map) for each, problem in zip(drawn, laid_out, strict=True)]


def _watch(stages: Stages, plan: FitPlan) -> Callable[[fit.Step], None]:
    phases = None if plan.arrangement is not None or plan.searches else plan.anneal.phases

    def show(step: fit.Step) -> None:
        at = f"phase {step.phase + 1}" + (f" of {phases}" if phases else "")
        start = f"start {step.start + 1} of {plan.starts}, " if plan.starts > 1 else ""
        detail = f"{start}{at}, step {step.step}, RMSE {max(step.loss, 0) ** 0.5:.5f}"
        fraction = step.phase / phases if phases else (step.start / plan.starts if plan.starts > 1 else None)
        stages.show("fitting", detail, fraction)

    return show


def _shaded(fitted: FittedRun) -> list[Pictures]:
    """The shaded pictures of each view by the names of their arrays."""
    (before, after), truth = fitted.seen, [each.reference.visibility for each in fitted.drawn]
    states = [("reference", fitted.drawn, truth), ("before", before, fitted.before), ("after", after, fitted.after)]
    return [
        {f"shaded_{name}": to_bytes(shade(view.config, seen[part], images[part])) for name, seen, images in states}
        for view, part in fitted.views.parts
    ]


def _with_flip(
    errors: dict[str, dict[str, float]], views: Sequence[DrawnView], shaded: Sequence[Pictures]
) -> dict[str, dict[str, float | None]]:
    """`errors` of the states of `views`, with the mean of ꟻLIP; this is `None` without the package for it."""

    def flip(state: str) -> float | None:
        name, truth = f"shaded_{state}", "shaded_reference"
        found = (
            perceptual_error(each[name], each[truth], view.drawn) for view, each in zip(views, shaded, strict=True)
        )
        known = [error for error in found if error is not None]
        return float(np.mean(known)) if known else None

    return {state: {**of_state, "flip": flip(state)} for state, of_state in errors.items()}


def _write(draft: Path, fitted: FittedRun, shaded: list[Pictures], result: dict[str, Any]) -> None:
    """Writes every file of the run to `draft`, which becomes `folder`."""
    # Imported here, since only a run that gets this far needs Matplotlib.
    from ..pages import _figures as figures
    from ..pages._report import write_report

    # Only the worst of several views has a shaded picture.
    worst = fitted.views.of(fitted.shown[0])
    drawn, arrays = fitted.drawn, {**_arrays(fitted), **shaded[worst]}
    run = stored(draft, result, arrays, fitted.config)
    record.write_config(draft, fitted.config.with_layout_of_fit())
    record.write_fitted(draft, fitted.config, fitted.result.fitted)
    record.write_arrays(draft, arrays)
    figures.write_figures(run, draft)
    for i in fitted.shown:
        figures.write_from_light(draft, record.suffix(i, drawn), fitted.result.technique, fitted.mapped[i].state)
    if fitted.plan.arrangement is not None:
        from ..pages._pose_figures import write_paths

        write_paths(draft / "paths.png", fitted.plan, drawn[0].scene, fitted.result)
    write_report(run)
    if "code" in result:
        (draft / CODE).write_text("\n".join(result["code"].values()))
    record.write_result(draft, result)


def _arrays(fitted: FittedRun) -> dict[str, Any]:
    history = fitted.result.history
    return {
        "reference": record.stacked([each.reference.visibility for each in fitted.drawn]),
        "before": record.stacked(fitted.before),
        "after": record.stacked(fitted.after),
        "mask": record.stacked([each.mask for each in fitted.drawn]),
        **({} if fitted.has_views else record.light_arrays(fitted.mapped)),
        "history_start": np.asarray([step.start for step in history], np.int32),
        "history_phase": np.asarray([step.phase for step in history], np.int32),
        "history_step": np.asarray([step.step for step in history], np.int32),
        "history_width": np.asarray([step.width for step in history], np.float32),
        "history_loss": np.asarray([step.loss for step in history], np.float32),
        "history_values": np.asarray([step.values for step in history], np.float64),
    }


def _profiles(result: fit.FitResult) -> dict[str, Any]:
    """The error along each parameter."""
    return {
        profile.name: {
            "best": {"value": profile.best[0], "error": profile.best[1]},
            "points": [list(point) for point in profile.points],
            "intervals": [
                {"within": each.within, "lower": each.lower._asdict(), "upper": each.upper._asdict()}
                for each in profile.intervals
            ],
        }
        for profile in result.profiles
    }


def _front_point(result: fit.FitResult, point: fit.FrontPoint) -> dict[str, Any]:
    return {**point._asdict(), "values": dict(zip(result.fitted, point.values, strict=True))}


def _result(folder: Path, fitted: FittedRun, shaded: list[Pictures], seconds: dict[str, float]) -> dict[str, Any]:
    result, config = fitted.result, fitted.config
    views = fitted.views
    seen = len(views.fitted)
    phases = [
        {**phase._asdict(), "values": dict(zip(result.fitted, phase.values, strict=True))} for phase in result.phases
    ]
    return {
        "verdict": fitted.verdict._asdict(),
        "name": config.name,
        "kind": "fit",
        "initial": result.initial,
        "fitted": result.fitted,
        "bounds": {p.name: {"lower": p.lower, "upper": p.upper, "unit": p.unit} for p in fitted.plan.parameters},
        "metrics": {
            "compare": "hard",
            **_with_flip(fitted.errors, views.fitted, shaded[:seen]),
            "reference_noise_floor": record.noise(fitted.drawn),
            "pixels": sum(each.pixels for each in fitted.drawn),
            "lights": [
                {
                    "light": each.key,
                    "before": before,
                    "after": after,
                    **({"validation": i >= views.seen} if views.validation else {}),
                }
                for i, (each, before, after) in enumerate(
                    zip(fitted.drawn, fitted.errors_before, fitted.errors_after, strict=True)
                )
            ],
            **(
                {"validation": _with_flip(fitted.validation, views.validation, shaded[seen:])}
                if views.validation
                else {}
            ),
            **({"shown": fitted.shown} if fitted.has_views else {}),
        },
        "solver": {
            "name": fitted.plan.solver.name,
            "steps": result.steps,
            "chosen_phase": result.chosen,
            "flat": result.flat,
            "seconds_compiling": result.seconds_compiling,
            "seconds_running": result.seconds_running,
            "phases": phases,
        },
        **({"profiles": _profiles(result)} if result.profiles else {}),
        **({"front": [_front_point(result, point) for point in result.front]} if result.front else {}),
        **({"code": fitted.code} if fitted.code else {}),
        **({} if fitted.plan.arrangement is None else {"poses": poses.as_record(fitted.plan, result)}),
        "warnings": fitted.remarks,
        "seconds": {name: round(s, 3) for name, s in seconds.items()},
        "versions": record.versions(),
        "seed": config.seed,
        "command": record.command("fit", folder),
    }
