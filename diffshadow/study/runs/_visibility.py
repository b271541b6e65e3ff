"""Images of visibility before and after a fit of a technique, of lights or of meshes: how they are measured, their
arrays and their pictures."""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32

from ... import fit, shadow
from ..._types import HostArray
from ..._words import counted
from ...config import Config, FitPlan, build_shadow_mapping
from ...geometry import Scene
from .._drawn import Drawn
from ..record import _runs as records
from ..record._stored import StoredRun
from ..remarks._bias import bias_remarks
from ..remarks._fit import remarks
from ..remarks._layout import layout_remarks
from ..remarks._reference import reference_remarks
from ..remarks._verdict import verdict
from ._engine import code_file, code_of
from ._explained import fitted_images, unexplained
from ._measure import Pictures, combined, light_arrays, measured, noise, perceptual_error, shaded, stacked, suffix
from ._progress import Progress
from ._setup import Loaded, draw, visibility_of
from ._views import DrawnView, Views
from ._write import configs_of_fit

# Of views, the worst have pictures.
_MAX_SHOWN = 8
# ꟻLIP takes far longer than all other errors of a view. Of more views, it is of so many, evenly spaced among them.
_MAX_PERCEIVED = 32


def pose_problems(config: Config, plan: FitPlan, scene: Scene) -> list[fit.PoseProblem]:
    """The problems of a fit of `plan`, which fits lights and meshes of `config`: one for each light.

    **Raises** `ConfigError` if no pixel counts, or the reference does not match the scene.
    """
    drawn = draw(config, Loaded(scene), build_shadow_mapping(config), Progress.quiet())
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
            points=plan.points,
        )
        for i, each in enumerate(drawn)
    ]


def with_references_of(problems: Sequence[fit.PoseProblem], drawn: Sequence[Drawn]) -> list[Drawn]:
    """The same with the references of the problems, which are dark outside a spot light's cone."""
    visibility = [np.asarray(problem.reference) for problem in problems]
    return [
        each._replace(reference=dataclasses.replace(each.reference, visibility=image))
        for each, image in zip(drawn, visibility, strict=True)
    ]


class State(NamedTuple):
    """The images of visibility before or after a fit, one for each view and light.

    - `drawn`: the scenes that they show, in which lights and meshes may have moved.
    - `errors`: errors under the hard compare, by name.
    """

    images: list[Float32[HostArray, "h w"]]
    drawn: list[Drawn]
    errors: list[dict[str, float]]


@dataclasses.dataclass(frozen=True)
class FittedRun:
    """A finished fit, with its images before and after.

    - `name`: name of the run; `config`: its configuration; none for a fit that was made in Python.
    - `truth`: true values of fitted poses, by name, as far as they are known.
    - `views`: the views that the fit sees, and its validation; `drawn`: their true scenes.
    """

    name: str
    config: Config | None
    result: fit.FitResult
    truth: Mapping[str, float]
    views: Views
    drawn: list[Drawn]
    before: State
    after: State

    @cached_property
    def verdict(self) -> records.Verdict:
        """What the fit comes to."""
        left = unexplained(fitted_images(self.views, self.drawn, self.after.images, self.after.drawn, self.result))
        before, after = (errors["rmse"] for errors in self.errors.values())
        return verdict(self.config, self.result, before, after, left)

    @cached_property
    def remarks(self) -> list[str]:
        """What to know besides."""
        config, result, drawn = self.config, self.result, self.drawn
        return [
            *self.views.remarks,
            *layout_remarks(result.technique, [each.key for each in drawn], [each.stored for each in drawn]),
            *self._bias_remarks(),
            *(reference_remarks(config, drawn) if config is not None and len(self.views.all) == 1 else []),
            *remarks(config, result, self.verdict.kind),
        ]

    def _bias_remarks(self) -> Iterator[str]:
        """What the fitted bias hides in the first views, once for all that it is the same for."""
        found: dict[str, int] = {}
        for view, part in itertools.islice(self.views.parts, _MAX_SHOWN):
            if view.config is not None:
                drawn = self.after.drawn[part]
                parts = ([each.key for each in drawn], [each.scene for each in drawn], [each.state for each in drawn])
                for sentence in bias_remarks(view.config, self.result.technique, *parts):
                    found[sentence] = found.get(sentence, 0) + 1
        if found:
            first, others = next(iter(found)), sum(found.values()) - 1
            more = f" ({counted(others, 'more such light')} in the first {_MAX_SHOWN} views)" if others else ""
            yield f"{first}{more}"

    @property
    def mapped(self) -> list[Drawn]:
        """The scene with the stored maps: drawn by the fitted technique, or from the true lights and meshes."""
        return self.after.drawn if self.result.arrangement is None else self.drawn

    @property
    def has_views(self) -> bool:
        """Whether there are other views than the configuration's own scene."""
        return len(self.views.all) > 1 or bool(self.config and self.config.views)

    @property
    def code(self) -> dict[str, str]:
        """The code for the lights of an engine, by their keys; with several views, the code for the first view. None
        without a configuration, since the code needs its keys."""
        first = self.views.fitted[0]
        if first.config is None:
            return {}
        return code_of(self.result.technique, first.config, self.mapped[: len(first.drawn)])

    @property
    def shown(self) -> list[int]:
        """The indices of the scenes and lights whose pictures are written: all, or only the worst views."""
        if not self.has_views:
            return list(range(len(self.drawn)))
        errors = np.nan_to_num([errors["rmse"] for errors in self.after.errors])
        return np.argsort(-errors, kind="stable")[:_MAX_SHOWN].tolist()

    @property
    def errors(self) -> dict[str, dict[str, float]]:
        """The errors `before` and `after` the fit, over all views that the fit sees."""
        return self._errors(slice(self.views.seen))

    @property
    def validation(self) -> dict[str, dict[str, float]]:
        """The errors `before` and `after` the fit over the validation; empty if there is none."""
        return self._errors(slice(self.views.seen, None)) if self.views.validation else {}

    def _errors(self, part: slice) -> dict[str, dict[str, float]]:
        states = {"before": self.before.errors, "after": self.after.errors}
        return {state: combined(errors[part], self.drawn[part]) for state, errors in states.items()}

    @cached_property
    def pictures(self) -> list[Pictures]:
        """The shaded pictures of views by the names of their arrays: the worst views, and those whose ꟻLIP is measured.
        Other views have no picture, nor have views whose scene is not known."""
        views = self.views
        if any(each.scene is None for each in self.drawn):
            return [{} for _ in views.all]
        chosen = {views.of(self.shown[0]), *spaced(0, len(views.fitted)), *spaced(len(views.fitted), len(views.all))}
        truth = State([each.reference.visibility for each in self.drawn], self.drawn, [])
        states = {"reference": truth, "before": self.before, "after": self.after}
        return [
            {
                f"shaded_{name}": shaded(view.config, state.drawn[part], state.images[part])
                for name, state in states.items()
            }
            if i in chosen
            else {}
            for i, (view, part) in enumerate(views.parts)
        ]

    def record(self, **about: Any) -> records.FitRecord:
        """Its record."""
        result, views, validation = self.result, self.views, self.validation
        named = lambda values: dict(zip(result.fitted, values, strict=True))
        seen = _with_flip(self.errors, views.fitted, self.pictures[: len(views.fitted)])
        unseen = _with_flip(validation, views.validation, self.pictures[len(views.fitted) :]) if validation else None
        lights = [
            records.FittedLight(
                light=each.key,
                before=records.LightErrors(**before),
                after=records.LightErrors(**after),
                validation=i >= views.seen if views.validation else None,
            )
            for i, (each, before, after) in enumerate(
                zip(self.drawn, self.before.errors, self.after.errors, strict=True)
            )
        ]
        own = result.is_own_loss and result.arrangement is None
        poses = None
        if result.arrangement is not None:
            poses = records.Poses.of(
                result,
                truth=dict(self.truth),
                error={name: result.fitted[name] - truth for name, truth in self.truth.items()},
                starts=[
                    records.Start.of(each, initial=named(each.initial), end=named(each.end)) for each in result.starts
                ],
            )
        return records.FitRecord.of(
            result,
            verdict=self.verdict,
            name=self.name,
            bounds={p.name: records.Bounds.of(p) for p in result.parameters},
            metrics=records.FitMetrics(
                compare="hard",
                before=seen.before,
                after=seen.after,
                reference_noise_floor=noise(self.drawn),
                pixels=sum(each.pixels for each in self.drawn),
                lights=lights,
                validation=unseen,
                shown=self.shown if self.has_views else None,
                resolution=list(self.drawn[0].mask.shape) if self.config is None else None,
            ),
            solver=records.Course.of(
                result,
                name=result.solver.title,
                chosen_phase=result.chosen,
                initial_loss=result.errors[0] ** 2 if own else None,
                phases=[records.Phase.of(phase, values=named(phase.values)) for phase in result.phases],
            ),
            profiles={each.name: records.Profile.of(each) for each in result.profiles},
            front=[records.FrontPoint.of(point, values=named(point.values)) for point in result.front],
            code=self.code,
            code_file=code_file("js" if self.config is None else getattr(self.config.technique, "suffix", "js")),
            poses=poses,
            warnings=self.remarks,
            **about,
        )

    def arrays(self) -> dict[str, Any]:
        """Its images, the history of the fit, and the shaded pictures of the worst view."""
        history = self.result.history
        return {
            "reference": stacked([each.reference.visibility for each in self.drawn]),
            "before": stacked(self.before.images),
            "after": stacked(self.after.images),
            "mask": stacked([each.mask for each in self.drawn]),
            **({} if self.has_views else light_arrays(self.mapped)),
            "history_start": np.asarray([step.start for step in history], np.int32),
            "history_phase": np.asarray([step.phase for step in history], np.int32),
            "history_step": np.asarray([step.step for step in history], np.int32),
            "history_width": np.asarray([step.width for step in history], np.float32),
            "history_loss": np.asarray([step.loss for step in history], np.float32),
            "history_values": np.asarray([step.values for step in history], np.float64),
            **self.pictures[self.views.of(self.shown[0])],
        }

    @property
    def stored_configs(self) -> dict[str, Config]:
        """The configurations that its folder holds, by the names of their files."""
        return {} if self.config is None else configs_of_fit(self.config, self.result.fitted)

    def write(self, draft: Path, run: StoredRun[Any]) -> None:
        """Writes its figures, and an engine's code."""
        from ..pages import _figures as figures

        figures.write_figures(run, draft)
        for i in self.shown:
            state = self.mapped[i].state
            figures.write_from_light(draft, suffix(i, self.drawn), self.result.technique, state)
        if self.result.arrangement is not None:
            from ..pages._pose_figures import write_paths

            write_paths(draft / "paths.png", self.drawn[0].scene, self.result, self.truth)
        if run.record.code:
            (draft / run.record.code_file).write_text("\n".join(run.record.code.values()))


def spaced(start: int, end: int) -> list[int]:
    """Whole numbers from `start` up to `end`, evenly spaced: all, or as many as there are pictures to measure ꟻLIP
    for."""
    count = min(end - start, _MAX_PERCEIVED)
    return np.linspace(start, end - 1, count).round().astype(int).tolist()


def _with_flip(
    errors: Mapping[str, Mapping[str, float]], views: Sequence[DrawnView], pictures: Sequence[Pictures]
) -> records.BeforeAndAfter:
    """The errors of `views` before and after, with the mean of ꟻLIP over spaced ones; none without its package."""

    def flip(state: str) -> float | None:
        pictured = [(views[i], pictures[i]) for i in spaced(0, len(views)) if pictures[i]]
        found = (perceptual_error(each, state, view.drawn) for view, each in pictured)
        known = [error for error in found if error is not None]
        return float(np.mean(known)) if known else None

    before, after = (records.Errors(**errors[state], flip=flip(state)) for state in ("before", "after"))
    return records.BeforeAndAfter(before=before, after=after)


def states_of(
    result: fit.FitResult, problems: Sequence[Any], drawn: list[Drawn], progress: Progress
) -> tuple[State, State]:
    """The images before and after a fit under the hard compare.

    **Arguments:**

    - `problems`: the problems of `drawn`: those that the fit has seen, and more for its validation.
    """
    laid_out, states = [*result.problems, *problems[len(result.problems) :]], []
    end: Any = result.technique if result.arrangement is None else result.arrangement
    start = fit.with_parameters(end, result.parameters, list(result.initial.values()))
    for when, subject in {"before": start, "after": end}.items():
        if result.arrangement is not None:
            images, seen = _arranged(result.problems, drawn, subject)
        else:
            seen = _laid_out(subject, laid_out, drawn)
            # One after another, so that they are written without a copy.
            rows = fit.Rows(len(seen))
            images = [
                rows.put(visibility_of(subject, each)) for each in progress.counted(f"image {when} the fit", seen)
            ]
        pairs = progress.counted("errors of image", list(zip(images, drawn, strict=True)))
        states.append(State(images, seen, [measured(*pair) for pair in pairs]))
    return states[0], states[1]


def _arranged(
    problems: Sequence[Any], drawn: Sequence[Drawn], arrangement: fit.Arrangement
) -> tuple[list[Float32[HostArray, "h w"]], list[Drawn]]:
    """The image of an arrangement that is compared with each reference, and the scene as light and camera see it."""
    images, seen = [], []
    for problem, each in zip(problems, drawn, strict=True):
        shadow_map, surface = problem.draw(arrangement)
        images.append(np.asarray(problem.image(shadow_map, surface, arrangement.technique), np.float32))
        scene = dataclasses.replace(each.scene, lights=shadow_map.light)
        seen.append(each._replace(scene=scene, stored=shadow_map, surface=surface))
    return images, seen


def _laid_out(
    technique: shadow.FittableTechnique, problems: Sequence[fit.AbstractProblem], drawn: list[Drawn]
) -> list[Drawn]:
    """`drawn`, with maps laid out as the technique says."""
    laid_out: Any = [problem.laid_out(technique) for problem in problems]
    return [each._replace(stored=problem.shadow_map) for each, problem in zip(drawn, laid_out, strict=True)]
