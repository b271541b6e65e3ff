"""The parts of a run that only fits of lights and meshes need."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float32
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ... import fit
from ..._checks import text_within
from ..._types import HostArray
from ...config import Config, FitPlan, build_shadow_mapping
from ...geometry import Scene
from .._drawn import Drawn
from ..pages._table import words
from ._progress import Stages
from ._setup import Loaded, draw


def with_references_of(problems: Sequence[fit.PoseProblem], drawn: Sequence[Drawn]) -> list[Drawn]:
    """With the references of the problems, which are dark outside a spot light's cone."""
    visibility = [np.asarray(problem.reference) for problem in problems]
    return [
        each._replace(reference=dataclasses.replace(each.reference, visibility=image))
        for each, image in zip(drawn, visibility, strict=True)
    ]


def pose_problems(config: Config, plan: FitPlan, scene: Scene) -> list[fit.PoseProblem]:
    """The problems of a fit of `plan`, which fits lights and meshes of `config`: one for each light.

    **Raises** `ConfigError` if no pixel counts, or the reference does not match the scene.
    """
    with Stages(Console(quiet=True)) as stages:
        drawn = draw(config, Loaded(scene), build_shadow_mapping(config), stages)
    return problems_of(plan, scene, drawn)


def problems_of(plan: FitPlan, scene: Scene, drawn: Sequence[Drawn]) -> list[fit.PoseProblem]:
    """A problem for each light."""
    assert plan.arrangement is not None
    moves = any(p.where.startswith("meshes.") for p in plan.parameters)
    return [
        fit.PoseProblem.of(
            scene,
            plan.arrangement.technique,
            each.reference,
            light=i,
            arrangement=plan.arrangement,
            surface=None if moves else each.surface,
        )
        for i, each in enumerate(drawn)
    ]


def images_at(
    problems: Sequence[Any], drawn: Sequence[Drawn], arrangement: fit.Arrangement
) -> tuple[list[Float32[HostArray, "h w"]], list[Drawn]]:
    """The image of an arrangement that is compared with each reference, and the scene as light and camera see it."""
    images, seen = [], []
    for problem, each in zip(problems, drawn, strict=True):
        shadow_map, surface = problem.draw(arrangement)
        image = problem.image(shadow_map, surface, arrangement.technique)
        images.append(np.asarray(image, np.float32))
        scene = dataclasses.replace(each.scene, lights=shadow_map.light)
        seen.append(each._replace(scene=scene, state=shadow_map, surface=surface))
    return images, seen


def errors_of(plan: FitPlan, result: fit.FitResult) -> dict[str, float]:
    """The error of each fitted value whose truth is known."""
    return {name: result.fitted[name] - truth for name, truth in plan.truth.items()}


def as_record(plan: FitPlan, result: fit.FitResult) -> dict[str, Any]:
    """The part of `result.json` on poses: truth and error by name, precision, and the outcomes of several starts."""
    names = list(result.fitted)
    values = lambda numbers: dict(zip(names, numbers, strict=True))
    return {
        "truth": plan.truth,
        "error": errors_of(plan, result),
        "precision": None if result.precision is None else result.precision._asdict(),
        "starts": [
            {"initial": values(start.initial), "end": values(start.end), "loss": start.loss} for start in result.starts
        ],
        "enlargements": result.enlargements,
    }


def print_poses(console: Console, plan: FitPlan, result: fit.FitResult) -> None:
    """Prints truth, fitted value, error and standard deviation of each parameter, and the losses of several starts."""
    table = Table("", "truth", "fitted", "error", "std. dev.")
    table.columns[0].no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    errors = errors_of(plan, result)
    deviations: Mapping[str, float] = {} if result.precision is None else result.precision.deviations
    text = lambda value, form: "" if value is None else format(value, form)
    for p in plan.parameters:
        truth = plan.truth.get(p.name)
        table.add_row(
            words(p.name),
            "" if truth is None else text_within(truth, p.lower, p.upper, 5),
            text_within(result.fitted[p.name], p.lower, p.upper, 5),
            text(errors.get(p.name), "+.2g"),
            text(deviations.get(p.name), ".2g"),
        )
    console.print(table)
    if result.starts:
        losses = sorted(start.loss for start in result.starts)
        shown = losses[:8] if result.is_own_loss else [loss**0.5 for loss in losses[:8]]
        listed = ", ".join(f"{loss:.4f}" for loss in shown) + (", …" if len(losses) > 8 else "")
        name = "loss" if result.is_own_loss else "RMSE"
        console.print(Text(f"blurred {name} of {len(losses)} starts after the first phases, best first: {listed}"))
