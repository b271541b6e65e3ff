"""A fit from its configuration to its folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float32
from rich.console import Console

from .. import fit, shadow
from .._types import HostArray
from ..config import Config, FitPlan, build_fit, build_shadow_mapping
from . import _record as record
from . import _table as table
from ._progress import Stages
from ._remarks import remarks
from ._run_folder import folder_of, write_whole
from ._setup import Drawn, draw, load, visibility_of
from ._shade import shade

Images = list[Float32[HostArray, "h w"]]


class Fitted(NamedTuple):
    """A finished fit, and its images, one for each light, and errors under the hard compare."""

    config: Config
    plan: FitPlan
    drawn: list[Drawn]
    result: fit.FitResult
    before: Images
    after: Images
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
    noise = table.noise_text(record.noise(fitted.drawn))
    table.print_lines(
        console, [f"errors are under the hard compare; {noise}", f"{steps} steps, {seconds:.1f} s in all"]
    )
    table.print_lines(console, fitted.remarks, warn=True)
    return folder


def _fit(config: Config, stages: Stages) -> Fitted:
    plan = build_fit(config)
    casting, technique = load(config, stages), build_shadow_mapping(config)
    drawn = draw(config, casting, technique, stages)
    stages.show("compiling")
    result = fit.fit(
        [_problem(technique, each) for each in drawn],
        plan.parameters,
        solver=plan.solver,
        anneal=plan.anneal,
        on_step=_watch(stages, plan.anneal.phases),
    )
    stages.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    with stages.stage("measuring"):
        paths, start = [p.where for p in plan.parameters], jnp.asarray(list(result.initial.values()))
        techniques = fit.with_values(result.technique, paths, start), result.technique
        before, after = ([visibility_of(t, each) for each in drawn] for t in techniques)
        errors_before, errors_after = (_errors(images, drawn) for images in (before, after))
    said = remarks(config, plan.parameters, result)
    return Fitted(config, plan, drawn, result, before, after, errors_before, errors_after, said)


def _problem(technique: shadow.ShadowMapping, drawn: Drawn) -> fit.Problem:
    assert isinstance(drawn.from_light, shadow.ShadowMap)
    truth, mask = jnp.asarray(drawn.reference.visibility), jnp.asarray(drawn.mask)
    return fit.Problem(technique, drawn.from_light, drawn.surface, truth, mask)


def _errors(images: Images, drawn: list[Drawn]) -> dict[str, float]:
    return record.combined([record.measured(image, each) for image, each in zip(images, drawn, strict=True)], drawn)


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

    drawn = fitted.drawn
    shaded = [(title, shade(fitted.config, drawn, images)) for title, images in _pairs(fitted)]
    record.write_config(draft, fitted.config)
    for i, each in enumerate(drawn):
        end, truth = record.suffix(i, drawn), each.reference.visibility
        compared = [(title, images[i], record.measured(images[i], each)["rmse"]) for title, images in _pairs(fitted)]
        picture = ("After, shaded", shaded[1][1])
        figures.write_comparison(draft / f"comparison{end}.png", truth, compared, picture, each.mask)
        figures.write_from_light(draft, end, each.from_light)
    figures.write_shaded(draft / "shaded.png", shaded)
    figures.write_loss(draft / "loss.png", fitted.result, fitted.errors_before["rmse"])
    record.write_arrays(draft, _arrays(fitted))
    result = _result(folder, fitted, seconds)
    write_report(draft, result, fitted.config, fitted.plan.parameters)
    record.write_result(draft, result)


def _pairs(fitted: Fitted) -> list[tuple[str, Images]]:
    return [("Before", fitted.before), ("After", fitted.after)]


def _arrays(fitted: Fitted) -> dict[str, Any]:
    history = fitted.result.history
    return {
        "reference": record.stacked([each.reference.visibility for each in fitted.drawn]),
        "before": record.stacked(fitted.before),
        "after": record.stacked(fitted.after),
        "mask": record.stacked([each.mask for each in fitted.drawn]),
        **record.light_arrays(fitted.drawn),
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
            "reference_noise_floor": record.noise(fitted.drawn),
            "pixels": sum(each.pixels for each in fitted.drawn),
            "lights": [
                {"light": each.key, "before": record.measured(before, each), "after": record.measured(after, each)}
                for each, before, after in zip(fitted.drawn, fitted.before, fitted.after, strict=True)
            ],
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
