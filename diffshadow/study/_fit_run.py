"""A fit from its configuration to its folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float32
from rich.console import Console

from .. import fit
from .._types import HostArray
from ..config import Config, FitPlan, build_fit, build_technique
from . import _record as record
from . import _table as table
from ._progress import Stages
from ._remarks import remarks
from ._run_folder import folder_of, write_whole
from ._setup import Drawn, draw, load, visibility_of
from ._shade import shade


class Fitted(NamedTuple):
    """A finished fit, and its images and errors under the hard compare."""

    config: Config
    plan: FitPlan
    drawn: Drawn
    result: fit.FitResult
    before: Float32[HostArray, "h w"]
    after: Float32[HostArray, "h w"]
    errors_before: dict[str, float]
    errors_after: dict[str, float]
    remarks: list[str]


def run_fit(config: Config, *, console: Console) -> Path:
    """Fits the parameters of `config`, prints what came out, and writes the run's folder.

    **Returns** the folder, `<output>/<name>`. An earlier run there is replaced once all is written, not before.

    **Raises** `ValueError` for a mistake in the configuration, before any long work.
    """
    folder = folder_of(config)
    with Stages(console) as stages:
        fitted = _fit(config, stages)
        with stages.stage("writing"):
            write_whole(folder, lambda draft: _write(draft, folder, fitted, stages.seconds))
    table.print_fit(
        console, config.name, fitted.plan.parameters, fitted.result.fitted, fitted.errors_before, fitted.errors_after
    )
    steps, seconds = fitted.result.steps, sum(stages.seconds.values())
    noise = table.noise_text(fitted.drawn.noise_floor)
    table.print_lines(
        console, [f"errors are under the hard compare; {noise}", f"{steps} steps, {seconds:.1f} s in all"]
    )
    table.print_lines(console, fitted.remarks, warn=True)
    return folder


def _fit(config: Config, stages: Stages) -> Fitted:
    scene = load(config, stages)
    technique, plan = build_technique(config), build_fit(config)
    drawn = draw(config, scene, technique, stages)
    problem = fit.Problem(
        technique, drawn.shadow_map, drawn.surface, jnp.asarray(drawn.reference.visibility), jnp.asarray(drawn.mask)
    )
    stages.show("compiling")
    result = fit.fit(
        problem, plan.parameters, solver=plan.solver, anneal=plan.anneal, on_step=_watch(stages, plan.anneal.phases)
    )
    stages.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    with stages.stage("measuring"):
        start = fit.with_values(result.technique, list(result.initial), jnp.asarray(list(result.initial.values())))
        before, after = (visibility_of(t, drawn) for t in (start, result.technique))
        truth = drawn.reference.visibility
        errors_before, errors_after = (record.measured(image, truth, drawn.mask) for image in (before, after))
    said = remarks(config, plan.parameters, result)
    return Fitted(config, plan, drawn, result, before, after, errors_before, errors_after, said)


def _watch(stages: Stages, phases: int) -> Callable[[fit.Step], None]:
    def show(step: fit.Step) -> None:
        detail = f"phase {step.phase + 1} of {phases}, step {step.step}, RMSE {max(step.loss, 0) ** 0.5:.5f}"
        stages.show("fitting", detail, step.phase / phases)

    return show


def _write(draft: Path, folder: Path, fitted: Fitted, seconds: dict[str, float]) -> None:
    """Writes every file of the run to `draft`, which will be `folder`."""
    # Here, since only a run that got this far needs Matplotlib.
    from . import _figures as figures
    from ._report import write_report

    drawn, truth = fitted.drawn, fitted.drawn.reference.visibility
    rmse = [errors["rmse"] for errors in (fitted.errors_before, fitted.errors_after)]
    pairs = [("Before", fitted.before), ("After", fitted.after)]
    shaded = [(title, shade(drawn, image)) for title, image in pairs]
    compared = [(title, image, error) for (title, image), error in zip(pairs, rmse, strict=True)]
    record.write_config(draft, fitted.config)
    figures.write_comparison(draft / "comparison.png", truth, compared, ("After, shaded", shaded[1][1]), drawn.mask)
    figures.write_shaded(draft / "shaded.png", shaded)
    figures.write_shadow_map(draft / "shadow_map.png", drawn.shadow_map)
    figures.write_loss(draft / "loss.png", fitted.result, rmse[0])
    record.write_arrays(draft, _arrays(fitted))
    result = _result(folder, fitted, seconds)
    write_report(draft, result, fitted.config, fitted.plan.parameters)
    record.write_result(draft, result)


def _arrays(fitted: Fitted) -> dict[str, Any]:
    history = fitted.result.history
    return {
        "reference": fitted.drawn.reference.visibility,
        "before": fitted.before,
        "after": fitted.after,
        "mask": fitted.drawn.mask,
        "shadow_map_depth": fitted.drawn.shadow_map.depth,
        "history_phase": np.asarray([step.phase for step in history], np.int32),
        "history_step": np.asarray([step.step for step in history], np.int32),
        "history_width": np.asarray([step.width for step in history], np.float32),
        "history_loss": np.asarray([step.loss for step in history], np.float32),
        "history_values": np.asarray([step.values for step in history], np.float32),
    }


def _result(folder: Path, fitted: Fitted, seconds: dict[str, float]) -> dict[str, Any]:
    result, config = fitted.result, fitted.config
    outcome = result.phases[result.chosen]
    phases = [
        {**phase._asdict(), "values": dict(zip(result.fitted, phase.values, strict=True))} for phase in result.phases
    ]
    return {
        "name": config.name,
        "kind": "fit",
        "initial": result.initial,
        "fitted": result.fitted,
        "bounds": {p.name: {"lower": p.lower, "upper": p.upper, "unit": p.unit} for p in fitted.plan.parameters},
        "metrics": {
            "compare": "hard",
            "before": fitted.errors_before,
            "after": fitted.errors_after,
            "reference_noise_floor": fitted.drawn.noise_floor,
            "pixels": int(fitted.drawn.mask.sum()),
        },
        "solver": {
            "name": fitted.plan.solver.name,
            "steps": result.steps,
            "result": outcome.result,
            "gradient_norm": outcome.gradient_norm,
            "chosen_phase": result.chosen,
            "flat": result.flat,
            "seconds_compiling": result.seconds_compiling,
            "seconds_running": result.seconds_running,
            "phases": phases,
        },
        "warnings": fitted.remarks,
        "seconds": {name: round(s, 3) for name, s in seconds.items()},
        "versions": record.versions(),
        "seed": config.seed,
        "command": record.command("fit", folder),
    }
