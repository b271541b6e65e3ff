"""Runs a fit of a shape: from its configuration to its folder."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ... import fit, geometry, io, metrics
from ..._types import HostArray
from ...config import Config, ConfigError, Mistake, Screen, ShapePlan, build_shape
from ..files._run_folder import folder_of, write_whole
from ..files._stored import SHAPE, add_files
from ..pages._table import print_lines
from ..remarks._shape import shape_remarks, shape_verdict
from ..remarks._verdict import Verdict
from . import _record as record
from ._checkpoint import Checkpoint
from ._progress import Stages
from ._setup import trace

Image = Float[HostArray, "h w"]
# Camera rays along a pixel's side, of targets and of the judge.
_RAYS = 4
MESH = "shape.ply"
"""The file of the fitted mesh."""
# Steps whose shapes are kept for the animation of the fit.
_KEPT = 36


class FittedShapeRun(NamedTuple):
    """A finished fit of a shape.

    - `targets`: what each light's shadow should be; `rays`: what rays see of the result; `unseen`: of the result and of
        the truth, under lights that the fit did not see.
    - `steps`: vertices and faces at some of the steps.
    """

    config: Config
    plan: ShapePlan
    result: fit.FittedShape
    targets: list[Image]
    rays: list[Image]
    unseen: list[tuple[Image, Image]]
    steps: list[tuple[HostArray, HostArray]]

    @property
    def remarks(self) -> list[str]:
        """Sentences on the images that are its targets, and on how the fit went."""
        return [*self.plan.remarks, *shape_remarks(self.result)]


def run_shape(config: Config, *, console: Console) -> Path:
    """Fits the shape of `config`, prints how close it is, and writes the run's folder.

    A fit that was stopped goes on from its checkpoint, if the configuration is the same.

    **Returns** the folder, `<output>/<name>`. An earlier run there is replaced only once everything is written.

    **Raises** `ConfigError` for a mistake in the configuration, before any long computation.
    """
    folder = folder_of(config)
    checkpoint = Checkpoint(config, folder)
    with Stages(console) as stages:
        fitted = fit_configured_shape(config, stages, checkpoint)
        with stages.stage("measuring"):
            measured = _measured(fitted)
            said = shape_verdict(fitted.result, measured)
        with stages.stage("writing"):
            result = _result(folder, fitted, measured, said, stages.seconds)
            write_whole(folder, lambda draft: _write(draft, fitted, result))
    checkpoint.remove()
    print_lines(console, [said.sentence, *said.remedies])
    _print(console, config.name, measured, sum(stages.seconds.values()))
    print_lines(console, fitted.remarks, warn=True)
    return folder


def shape_problem(config: Config, stages: Stages | None = None) -> tuple[ShapePlan, fit.ShapeProblem, list[Image]]:
    """The plan of `config`, whose section `fit.shape` is given, its problem, and the problem's targets.

    **Raises** `ConfigError` for a mesh, a light or an image that cannot be used.
    """
    if stages is None:
        with Stages(Console(quiet=True)) as quiet:
            return shape_problem(config, quiet)
    with stages.stage("loading"):
        plan = build_shape(config)
    with stages.stage("tracing targets"):
        targets = plan.images or [shadow_on(s, mesh) for s, mesh in zip(plan.seen, plan.targets, strict=True)]
    weights = plan.weights or [None] * len(targets)
    try:
        views = []
        for screen, target, weight, (moves, light) in zip(plan.seen, targets, weights, plan.starts, strict=True):
            views.append(fit.ShapeView(light, screen.surface(), target, weight, moves=moves))
        return plan, fit.ShapeProblem(plan.start, views, free=plan.free, symmetry=plan.symmetry), targets
    except ValueError as error:
        raise _error(config, str(error)) from error


def fit_configured_shape(config: Config, stages: Stages, checkpoint: Checkpoint) -> FittedShapeRun:
    """Fits the shape of `config`.

    **Raises** `ConfigError` for a mistake in the configuration; `FileError` if no space is left for the checkpoint.
    """
    plan, problem, targets = shape_problem(config, stages)
    kept: list[tuple[HostArray, HostArray]] = [(np.asarray(plan.start.vertices), np.asarray(plan.start.faces))]
    with stages.stage("fitting"):
        try:
            watch = _watch(stages, plan, checkpoint, kept)
            result = fit.fit_shape(problem, plan.phases, on_step=watch, resume=checkpoint.read())
        except io.FileError:
            # Of the checkpoint.
            raise
        except ValueError as error:
            raise _error(config, str(error)) from error
    with stages.stage("tracing result"):
        mesh = result.mesh
        lit = [screen._replace(light=light) for screen, light in zip(plan.seen, result.lights, strict=True)]
        rays = [shadow_on(screen, mesh) for screen in lit]
        pairs = [] if plan.truth is None else [(shadow_on(s, mesh), shadow_on(s, plan.truth)) for s in plan.unseen]
    kept.append((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    return FittedShapeRun(config, plan, result, targets, rays, pairs, kept)


def _watch(
    stages: Stages,
    plan: ShapePlan,
    checkpoint: Checkpoint,
    kept: list[tuple[HostArray, HostArray]],
) -> Callable[[fit.ShapeStep], None]:
    ends = list(itertools.accumulate((phase.steps for phase in plan.phases), initial=0))
    every = max(ends[-1] // _KEPT, 1)

    def show(step: fit.ShapeStep) -> None:
        done = ends[step.phase] + step.step
        detail = f"phase {step.phase + 1} of {len(plan.phases)}, step {step.step}, RMSE {step.loss**0.5:.5f}"
        stages.show("fitting", detail, done / ends[-1])
        checkpoint.at(step.state)
        if done % every == 0:
            kept.append((step.vertices, step.faces))

    return show


def shadow_on(screen: Screen, mesh: geometry.Mesh) -> Image:
    """The shadow of a mesh on a screen, by rays. One that was traced before is read from disk."""
    return np.asarray(trace(screen.scene(mesh), {"samples": 1, "supersampling": _RAYS}).visibility)


def _measured(fitted: FittedShapeRun) -> dict[str, Any]:
    """How close the shadows and the shape are."""
    overlap, plan, result = metrics.intersection_over_union, fitted.plan, fitted.result
    lights = [
        {"light": screen.key, "before": overlap(b, t), "map": overlap(m, t), "rays": overlap(r, t)}
        for screen, t, b, m, r in zip(
            plan.seen, fitted.targets, result.initial_images, result.images, fitted.rays, strict=True
        )
    ]
    found: dict[str, Any] = {"initial_loss": result.initial_loss, "loss": result.loss, "lights": lights}
    mesh = result.mesh
    found["self_intersections"] = metrics.count_self_intersections(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    if fitted.unseen:
        pairs = zip(plan.unseen, fitted.unseen, strict=True)
        found["unseen"] = [{"light": screen.key, "rays": overlap(*both)} for screen, both in pairs]
    if any(moves for moves, _ in plan.starts):
        middle = np.asarray(plan.start.bounds, np.float64).mean(axis=0)
        off = lambda screen, light: _degrees_between(screen.light, light, middle)
        found["moved"] = [
            {"light": screen.key, "before": off(screen, start), "after": off(screen, end)}
            for screen, (moves, start), end in zip(plan.seen, plan.starts, result.lights, strict=True)
            if moves
        ]
    if plan.truth is not None:
        triangles = lambda mesh: (np.asarray(mesh.vertices), np.asarray(mesh.faces))
        found["chamfer"] = metrics.chamfer_distance(triangles(result.mesh), triangles(plan.truth))
        found["size"] = float(np.ptp(np.asarray(plan.truth.bounds), axis=0).max())
    return found


def _degrees_between(
    light: geometry.AbstractLight, other: geometry.AbstractLight, middle: Float[HostArray, "3"]
) -> float:
    """The angle between the directions of two suns, or by which a lamp is displaced as a shape's `middle` sees it."""
    if light.is_directional:
        a, b = (np.asarray(each.direction, np.float64) for each in (light, other))  # type: ignore[attr-defined]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
    a, b = (np.asarray(each.pose().place, np.float64) for each in (light, other))
    return float(np.degrees(np.arctan2(np.linalg.norm(b - a), np.linalg.norm(a - middle))))


def _result(
    folder: Path, fitted: FittedShapeRun, measured: dict[str, Any], said: Verdict, seconds: dict[str, float]
) -> dict[str, Any]:
    result, config = fitted.result, fitted.config
    steps = [sum(phase == k for phase, _ in result.history) for k in range(len(fitted.plan.phases))]
    return {
        "verdict": said._asdict(),
        "name": config.name,
        "kind": SHAPE,
        "metrics": measured,
        "vertices": len(result.mesh.vertices),
        "chosen_phase": result.chosen,
        "phases": [{"steps": n, "loss": loss} for n, loss in zip(steps, result.losses, strict=True)],
        "warnings": fitted.remarks,
        "seconds": {name: round(s, 3) for name, s in seconds.items()},
        "versions": record.versions(),
        "seed": config.seed,
        "command": record.command("fit", folder),
    }


def _write(draft: Path, fitted: FittedShapeRun, result: dict[str, Any]) -> None:
    # Imported here, since only a run that gets this far needs Matplotlib.
    from ..pages._shape import PROGRESS, TURNTABLE, report_shape

    found = fitted.result
    record.write_config(draft, fitted.config)
    record.write_arrays(
        draft,
        {
            "reference": np.stack(fitted.targets).astype(np.float32),
            "before": np.stack(found.initial_images).astype(np.float32),
            "after": np.stack(found.images).astype(np.float32),
            "history_phase": np.asarray([phase for phase, _ in found.history], np.int32),
            "history_loss": np.asarray([loss for _, loss in found.history], np.float32),
        },
    )
    io.write_ply(draft / MESH, np.asarray(found.mesh.vertices), np.asarray(found.mesh.faces))
    from ._turntable import progress, turntable

    io.write_animation(draft / TURNTABLE, turntable(found.mesh), 80)
    io.write_animation(draft / PROGRESS, progress(fitted.steps), 120)
    record.write_result(draft, result)
    add_files(draft, [report_shape(draft).name])


def _print(console: Console, name: str, measured: dict[str, Any], seconds: float) -> None:
    table = Table("intersection over union", "before", "after, map", "after, rays", title=name, title_justify="left")
    for column in table.columns[1:]:
        column.justify = "right"
    for light in measured["lights"]:
        table.add_row(Text(light["light"]), *(f"{light[key]:.4f}" for key in ("before", "map", "rays")))
    for light in measured.get("unseen", ()):
        table.add_row(Text(light["light"]), "", "", f"{light['rays']:.4f}")
    console.print(table)
    lines = [f"mean square error {measured['initial_loss']:.3g} before, {measured['loss']:.3g} after"]
    if "chamfer" in measured:
        share = measured["chamfer"] / measured["size"]
        lines.append(f"Chamfer distance {measured['chamfer']:.4g} world units, {share:.2%} of the shape's size")
    for light in measured.get("moved", ()):
        lines.append(
            f"{light['light']} is {light['after']:.3f}° from its place in the scene, {light['before']:.3f}° before"
        )
    for line in (*lines, f"{seconds:.1f} s in all"):
        console.print(Text(line), soft_wrap=True)


def _error(config: Config, what: str) -> ConfigError:
    path = ("fit", "shape")
    return ConfigError([Mistake(config.origin.place(path), ".".join(path), what)])
