"""Writes the folder of a fit."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ... import fit
from ..files._run_folder import write_whole
from ..files._stored import stored, to_bytes
from . import _pose as poses
from . import _record as record
from ._engine import CODE
from ._fitted import FittedRun
from ._shade import Pictures, perceptual_error, shade
from ._views import DrawnView

# ꟻLIP takes far longer than all other errors of a view. Of more views, it is of so many, evenly spaced among them.
_MAX_PERCEIVED = 32


def write_fit(folder: Path, fitted: FittedRun, seconds: dict[str, float]) -> dict[str, Any]:
    """Writes the run's folder; `seconds` are the times of its stages. **Returns** the metrics of its result."""
    shaded = _shaded(fitted)
    result = _result(folder, fitted, shaded, seconds)
    write_whole(folder, lambda draft: _write(draft, fitted, shaded, result))
    return result["metrics"]


def _shaded(fitted: FittedRun) -> list[Pictures]:
    """The shaded pictures of views by the names of their arrays: of the worst, and of those whose ꟻLIP is measured. Of
    the others there is none, nor where the scene is not known."""
    views = fitted.views
    if not fitted.has_pictures:
        return [{} for _ in views.all]
    chosen = {views.of(fitted.shown[0]), *_spaced(0, len(views.fitted)), *_spaced(len(views.fitted), len(views.all))}
    (before, after), truth = fitted.seen, [each.reference.visibility for each in fitted.drawn]
    states = [("reference", fitted.drawn, truth), ("before", before, fitted.before), ("after", after, fitted.after)]
    return [
        {f"shaded_{name}": to_bytes(shade(view.config, seen[part], images[part])) for name, seen, images in states}
        if i in chosen
        else {}
        for i, (view, part) in enumerate(views.parts)
    ]


def _spaced(start: int, end: int) -> list[int]:
    """Whole numbers from `start` up to `end`, evenly spaced: all of them, or as many as ꟻLIP is measured of."""
    count = min(end - start, _MAX_PERCEIVED)
    return np.linspace(start, end - 1, count).round().astype(int).tolist()


def _with_flip(
    errors: dict[str, dict[str, float]], views: Sequence[DrawnView], shaded: Sequence[Pictures]
) -> dict[str, dict[str, float | None]]:
    """`errors` of the states of `views`, with the mean of ꟻLIP over spaced ones; `None` without its package."""

    def flip(state: str) -> float | None:
        name, truth = f"shaded_{state}", "shaded_reference"
        pictured = [(views[i], shaded[i]) for i in _spaced(0, len(views)) if shaded[i]]
        found = (perceptual_error(each[name], each[truth], view.drawn) for view, each in pictured)
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
    if fitted.config is not None:
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
        "name": fitted.name,
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
            **({"resolution": list(fitted.drawn[0].mask.shape)} if config is None else {}),
        },
        "solver": {
            "name": fitted.plan.solver.title,
            "steps": result.steps,
            "chosen_phase": result.chosen,
            "flat": result.flat,
            **({"is_own_loss": True} if result.is_own_loss else {}),
            # For poses, it is of blurred images, unlike the hard losses of the phases.
            **({"initial_loss": result.errors[0] ** 2} if result.is_own_loss and result.arrangement is None else {}),
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
        **({} if config is None else {"seed": config.seed, "command": record.command("fit", folder)}),
    }
