"""Fits of a shape: the problem, and the silhouettes before and after, how they are measured, their arrays and files."""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ... import fit, geometry, io, metrics
from ..._types import HostArray
from ...config import CONFIG_FILE, Config, ConfigError, Mistake, Screen, ShapePlan, build_free, build_shape
from ..record import _runs as records
from ..record._folder import folder_of
from ..record._stored import StoredRun
from ..remarks._fit import shape_remarks
from ..remarks._verdict import shape_verdict
from ._checkpoint import Checkpoint
from ._progress import Progress
from ._setup import trace

Image = Float[HostArray, "h w"]
# Camera rays along a pixel's side, of targets and of the judge.
_RAYS = 4
MESH = "shape.ply"
"""The file of the fitted mesh."""
# Steps whose shapes are kept for the animation of the fit.
_KEPT = 36


@dataclasses.dataclass(frozen=True)
class FittedShapeRun:
    """A finished fit of a shape.

    - `targets`: what each light's shadow should be; `rays`: what rays see of the result.
    - `steps`: vertices and faces at some of the steps.
    """

    config: Config
    plan: ShapePlan
    result: fit.FittedShape
    targets: list[Image]
    rays: list[Image]
    steps: list[tuple[HostArray, HostArray]]
    metrics: records.ShapeMetrics
    verdict: records.Verdict

    def record(self, **about: Any) -> records.ShapeRecord:
        """Its record."""
        result = self.result
        steps = [sum(phase == k for phase, _ in result.history) for k in range(len(self.plan.phases))]
        return records.ShapeRecord(
            verdict=self.verdict,
            name=self.config.name,
            metrics=self.metrics,
            vertices=len(result.mesh.vertices),
            chosen_phase=result.chosen,
            phases=[records.ShapePhase(steps=n, loss=loss) for n, loss in zip(steps, result.losses, strict=True)],
            warnings=[*self.plan.remarks, *shape_remarks(result)],
            **about,
        )

    def arrays(self) -> dict[str, Any]:
        """The images that the fit compares, and its history."""
        found = self.result
        return {
            "reference": np.stack(self.targets).astype(np.float32),
            "before": np.stack(found.initial_images).astype(np.float32),
            "after": np.stack(found.images).astype(np.float32),
            "history_phase": np.asarray([phase for phase, _ in found.history], np.int32),
            "history_loss": np.asarray([loss for _, loss in found.history], np.float32),
        }

    @property
    def stored_configs(self) -> dict[str, Config]:
        """The configuration that its folder holds, by the name of its file."""
        return {CONFIG_FILE: self.config}

    def write(self, draft: Path, run: StoredRun[Any]) -> None:
        """Writes the mesh, and animations of it."""
        from ..pages._report import PROGRESS, TURNTABLE
        from ._turntable import progress, turntable

        mesh = self.result.mesh
        io.write_ply(draft / MESH, np.asarray(mesh.vertices), np.asarray(mesh.faces))
        io.write_animation(draft / TURNTABLE, turntable(mesh), 80)
        io.write_animation(draft / PROGRESS, progress(self.steps), 120)


def shape_problem(config: Config, progress: Progress | None = None) -> tuple[ShapePlan, fit.ShapeProblem, list[Image]]:
    """The plan of `config`, whose section `fit.shape` is given, its problem, and the problem's targets.

    **Raises** `ConfigError` for a mesh, a light or an image that cannot be used.
    """
    progress = Progress.quiet() if progress is None else progress
    with progress.stage("loading"):
        plan = build_shape(config)
    with progress.stage("tracing targets"):
        targets = plan.images or [shadow_on(s, mesh) for s, mesh in zip(plan.seen, plan.targets, strict=True)]
    weights = plan.weights or [None] * len(targets)
    try:
        views = []
        for screen, target, weight, (moves, light) in zip(plan.seen, targets, weights, plan.starts, strict=True):
            views.append(fit.ShapeView(light, screen.surface(), target, weight, moves=moves))
        start = fit.hull_start(views, symmetry=plan.symmetry) if plan.start is None else plan.start
        free = build_free(config, start)
        return plan, fit.ShapeProblem(start, views, free=free, symmetry=plan.symmetry), targets
    except ConfigError:
        raise
    except ValueError as error:
        raise _error(config, str(error)) from error


def fit_shape(config: Config, progress: Progress) -> FittedShapeRun:
    """Fits the shape of `config`. A stopped fit continues from its checkpoint if the configuration is the same.

    **Raises** `ConfigError` for a mistake in the configuration; `FileError` if no space is left for the checkpoint.
    """
    checkpoint = Checkpoint(config, folder_of(config))
    plan, problem, targets = shape_problem(config, progress)
    start = problem.mesh
    kept: list[tuple[HostArray, HostArray]] = [(np.asarray(start.vertices), np.asarray(start.faces))]
    with progress.stage("fitting"):
        try:
            watch = _watch(progress, plan, checkpoint, kept)
            result = fit.fit_shape(problem, plan.phases, on_step=watch, resume=checkpoint.read())
        except io.FileError:
            # Of the checkpoint.
            raise
        except ValueError as error:
            raise _error(config, str(error)) from error
    with progress.stage("tracing result"):
        mesh = result.mesh
        lit = [screen._replace(light=light) for screen, light in zip(plan.seen, result.lights, strict=True)]
        rays = [shadow_on(screen, mesh) for screen in lit]
        pairs = [] if plan.truth is None else [(shadow_on(s, mesh), shadow_on(s, plan.truth)) for s in plan.unseen]
    kept.append((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    with progress.stage("measuring"):
        measured = _measured(plan, start, result, targets, rays, pairs)
        said = shape_verdict(result, measured)
    return FittedShapeRun(config, plan, result, targets, rays, kept, measured, said)


def _watch(
    progress: Progress,
    plan: ShapePlan,
    checkpoint: Checkpoint,
    kept: list[tuple[HostArray, HostArray]],
) -> Callable[[fit.ShapeStep], None]:
    ends = list(itertools.accumulate((phase.steps for phase in plan.phases), initial=0))
    every = max(ends[-1] // _KEPT, 1)

    def show(step: fit.ShapeStep) -> None:
        done = ends[step.phase] + step.step
        detail = f"phase {step.phase + 1} of {len(plan.phases)}, step {step.step}, RMSE {step.loss**0.5:.5f}"
        progress.show("fitting", detail, done / ends[-1])
        checkpoint.at(step.state)
        if done % every == 0:
            kept.append((step.vertices, step.faces))

    return show


def shadow_on(screen: Screen, mesh: geometry.Mesh) -> Image:
    """The shadow of a mesh on a screen, by rays. A reference that was traced before is read from disk."""
    return np.asarray(trace(screen.scene(mesh), {"samples": 1, "supersampling": _RAYS}).visibility)


def _measured(
    plan: ShapePlan,
    start: geometry.Mesh,
    result: fit.FittedShape,
    targets: list[Image],
    rays: list[Image],
    unseen: list[tuple[Image, Image]],
) -> records.ShapeMetrics:
    """How close the shadows and the shape are. `unseen`: shadows of the result and of the truth, under lights that the
    fit did not see."""
    overlap, triangles = (
        metrics.intersection_over_union,
        (np.asarray(result.mesh.vertices), np.asarray(result.mesh.faces)),
    )
    images = zip(plan.seen, targets, result.initial_images, result.images, rays, strict=True)
    middle = np.asarray(start.bounds, np.float64).mean(axis=0)
    lights = zip(plan.seen, plan.starts, result.lights, strict=True)
    chamfer = size = None
    if plan.truth is not None:
        truth = (np.asarray(plan.truth.vertices), np.asarray(plan.truth.faces))
        chamfer = metrics.chamfer_distance(triangles, truth)
        size = float(np.ptp(np.asarray(plan.truth.bounds), axis=0).max())
    return records.ShapeMetrics(
        initial_loss=result.initial_loss,
        loss=result.loss,
        lights=[
            records.Overlap(light=screen.key, before=overlap(b, t), map=overlap(m, t), rays=overlap(r, t))
            for screen, t, b, m, r in images
        ],
        # None without images of unseen lights.
        unseen=[
            records.UnseenOverlap(light=s.key, rays=overlap(*both))
            for s, both in zip(plan.unseen, unseen, strict=False)
        ],
        moved=[
            records.MovedLight(
                light=screen.key,
                before=_degrees_between(screen.light, start, middle),
                after=_degrees_between(screen.light, end, middle),
            )
            for screen, (moves, start), end in lights
            if moves
        ],
        self_intersections=metrics.count_self_intersections(*triangles),
        chamfer=chamfer,
        size=size,
    )


def _degrees_between(
    light: geometry.AbstractLight, other: geometry.AbstractLight, middle: Float[HostArray, "3"]
) -> float:
    """The angle between the directions of two suns, or by which a lamp is displaced as a shape's `middle` sees it."""
    if light.is_directional:
        a, b = (np.asarray(each.direction, np.float64) for each in (light, other))  # type: ignore[attr-defined]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
    a, b = (np.asarray(each.pose().place, np.float64) for each in (light, other))
    return float(np.degrees(np.arctan2(np.linalg.norm(b - a), np.linalg.norm(a - middle))))


def _error(config: Config, what: str) -> ConfigError:
    path = ("fit", "shape")
    return ConfigError([Mistake(config.origin.place(path), ".".join(path), what)])
