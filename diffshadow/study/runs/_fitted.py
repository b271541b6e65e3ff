"""A finished fit, which is then written, printed or put into a table."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32

from ... import fit, shadow
from ..._types import HostArray
from ...config import Config, FitPlan
from .._drawn import Drawn
from ..remarks._verdict import Verdict
from . import _pose as poses
from . import _record as record
from ._engine import code_of
from ._progress import Stages
from ._setup import visibility_of
from ._views import Views

Images = list[Float32[HostArray, "h w"]]
# Of views, the worst have pictures.
_MAX_SHOWN = 8


class FittedRun(NamedTuple):
    """A finished fit, with its images and their errors under the hard compare, one for each view and light.

    - `views`: all that the fit sees, and its validation.
    - `seen`: the scenes before and after the fit, which may move lights and meshes; `drawn` is the truth.
    - `verdict`: what the fit comes to.
    - `config`: none of a fit that was made in Python.
    - `name`: of the run.
    - `has_pictures`: whether the scene is known, so that it can be shaded.
    """

    name: str
    config: Config | None
    plan: FitPlan
    views: Views
    drawn: list[Drawn]
    result: fit.FitResult
    before: Images
    after: Images
    errors_before: list[dict[str, float]]
    errors_after: list[dict[str, float]]
    remarks: list[str]
    seen: "States"
    verdict: Verdict
    has_pictures: bool = True

    @property
    def mapped(self) -> list[Drawn]:
        """The scene with the stored maps: of the fitted technique, or of the true lights and meshes."""
        return self.seen[1] if self.plan.arrangement is None else self.drawn

    @property
    def has_views(self) -> bool:
        """Whether there are other views than the configuration's own scene."""
        return len(self.views.all) > 1 or bool(self.config and self.config.views)

    @property
    def code(self) -> dict[str, str]:
        """The code for the lights of an engine, by their keys; of several views, for the first. None without a
        configuration, whose keys the code has."""
        first = self.views.fitted[0]
        if first.config is None:
            return {}
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


States = tuple[list[Drawn], list[Drawn]]


def states_of(
    plan: FitPlan, result: fit.FitResult, problems: Sequence[Any], drawn: list[Drawn], stages: Stages
) -> tuple[tuple[Images, Images], States]:
    """The images before and after a fit under the hard compare, and the scenes that they show.

    **Arguments:**

    - `problems`: of `drawn`: those that the fit has seen, and more for its validation.
    """
    start = list(result.initial.values())
    if result.arrangement is not None:
        subjects = fit.with_parameters(result.arrangement, plan.parameters, start), result.arrangement
        (before, seen_before), (after, seen_after) = (poses.images_at(result.problems, drawn, s) for s in subjects)
        return (before, after), (seen_before, seen_after)
    techniques = fit.with_parameters(result.technique, plan.parameters, start), result.technique
    laid_out = [*result.problems, *problems[len(result.problems) :]]
    first, last = (_seen_with(technique, laid_out, drawn) for technique in techniques)
    before = [visibility_of(techniques[0], each) for each in stages.counted("image before the fit", first)]
    after = [visibility_of(techniques[1], each) for each in stages.counted("image after the fit", last)]
    return (before, after), (first, last)


def _seen_with(
    technique: shadow.FittableTechnique, problems: Sequence[fit.AbstractProblem], drawn: list[Drawn]
) -> list[Drawn]:
    """`drawn`, with maps laid out as the technique says."""
    laid_out: Any = [problem.laid_out(technique) for problem in problems]
    return [each._replace(state=problem.shadow_map) for each, problem in zip(drawn, laid_out, strict=True)]
