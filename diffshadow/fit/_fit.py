"""Fits to a reference."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .._arithmetic import as_float
from .._checks import check_instance
from .._memory import limit_programs
from .._pictures import as_html
from .._progress import Update, showing
from .._words import counted
from ..shadow import FittableTechnique
from ._anneal import Anneal
from ._arrangement import Arrangement
from ._bounds import AtBound, at_bounds
from ._front import FrontPoint, front_of
from ._history import Step, shown_steps
from ._how import Search, Sureness
from ._judge import Judge
from ._loss import Loss
from ._own_loss import LossFunction, OwnLoss
from ._parameters import Parameter, Parameters
from ._phases import phases_of
from ._precision import Precision
from ._profile import Profile, Profiler
from ._run import Outcome, Run, Start, Trajectory, Values, root
from ._starts import starts_within
from .problems import AbstractProblem, Joint, check_problem, devices_of, on_host
from .solvers import OptimistixSolver, Solver


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FitResult:
    """The result of a fit, and its arguments.

    - `technique`: the fitted technique, with the hard compare.
    - `initial`, `fitted`: values by name.
    - `phases`: the result of each phase; `chosen`: the phase that ended best under the hard compare, -1 if the start
        was best. If losses differ by less than the solver's `noise`, the last phase is chosen.
    - `history`: every evaluation, in order.
    - `flat`: names of the parameters that were not fitted. They kept their start, because the loss has no slope there.
    - `seconds_compiling`, `seconds_running`: times of the whole fit.
    - `arrangement`: the fitted technique, lights and meshes, if lights or meshes were fitted.
    - `precision`: the precision of the values; `None` if the start was best, or with your own loss.
    - `starts`: the course of each of several starts; `phases` and `initial` belong to the best start.
    - `enlargements`: the number of times that a phase was repeated with memory for more silhouettes.
    - `profiles`: the parameters' error profiles around the best values, if intervals were requested.
    - `best`: the values with the lowest error, by name. They differ from `fitted` only if `Sureness.prefer` is given.
    - `front`: the front of false shadow against false light, if requested.
    - `at_bounds`: the fitted values that ended on a bound, and whether the error still falls there.
    - `errors`: the square roots of the loss under the hard compare, at the start and at the best values; 0 if your own
      loss is negative.
    - `problems`: the fitted problems, with the memory for silhouettes that the fit needed, and maps with the fitted
        layout.
    - `parameters`, `solver`, `search`, `sureness`: the arguments of the fit.
    - `is_own_loss`: whether `errors` and the losses of `phases` and `history` come from your own loss instead of mean
      square errors.

    `study.save_fit(result, folder)` writes the result with its images and a report, as `diffshadow fit` does.
    """

    technique: FittableTechnique
    initial: dict[str, float]
    fitted: dict[str, float]
    phases: list[Outcome]
    chosen: int
    history: list[Step]
    flat: list[str]
    seconds_compiling: float
    seconds_running: float
    arrangement: Arrangement | None = None
    precision: Precision | None = None
    starts: list[Start] = dataclasses.field(default_factory=list)
    enlargements: int = 0
    problems: tuple[AbstractProblem, ...] = ()
    profiles: list[Profile] = dataclasses.field(default_factory=list)
    best: dict[str, float] = dataclasses.field(default_factory=dict)
    front: list[FrontPoint] = dataclasses.field(default_factory=list)
    at_bounds: list[AtBound] = dataclasses.field(default_factory=list)
    errors: tuple[float, float] = (0.0, 0.0)
    parameters: tuple[Parameter, ...] = ()
    solver: Solver = dataclasses.field(default_factory=Solver)
    search: Search = dataclasses.field(default_factory=Search)
    sureness: Sureness = dataclasses.field(default_factory=Sureness)
    is_own_loss: bool = False

    def _repr_html_(self) -> str:
        """The fitted values and errors as a table, and the reference of the first problem."""
        deviations = {} if self.precision is None else self.precision.deviations
        rows: list[tuple[str, ...]] = [("", "before", "after", "std. dev.")]
        for name, value in self.fitted.items():
            deviation = f"{deviations[name]:.2g}" if name in deviations else ""
            rows.append((name, f"{self.initial[name]:.4g}", f"{value:.4g}", deviation))
        rows.append(("error", *(f"{error:.4f}" for error in self.errors), ""))
        # A sample of pixels is not an image.
        references = (getattr(each, "reference", None) for each in self.problems)
        images = [image for image in references if image is not None and np.ndim(image) == 2]
        steps = f"{counted(self.steps, 'step')} in {counted(len(self.phases), 'phase')}"
        title = f"Fit of {counted(len(self.fitted), 'parameter')}: {steps}"
        return as_html(title, images[0] if images else None, rows)

    @property
    def steps(self) -> int:
        """Solver steps of all phases."""
        return sum(phase.steps for phase in self.phases)


def fit(
    problem: AbstractProblem | Sequence[AbstractProblem],
    parameters: Sequence[Parameter],
    *,
    solver: Solver | OptimistixSolver | None = None,
    anneal: Anneal | None = None,
    loss: Loss | LossFunction | None = None,
    search: Search | None = None,
    sureness: Sureness | None = None,
    on_step: Callable[[Step], None] | None = None,
    progress: Update | None = None,
) -> FitResult:
    """Fits numbers of a technique, or of an arrangement, to bring its visibility as close as possible to the reference.

    Visibility has no useful derivative with respect to numbers that lay out the map, such as the spacing of cascades.
    If there are such numbers, a bounded search over all parameters comes before the fit by gradient.

    The fit runs in phases (`_phases.py`). The hard compare at full resolution judges the start and the end of each
    phase. The best of these is the result, so a fit never ends worse than it began.

    **Arguments:**

    - `problem`: one problem, or several that share the fitted values, such as one for each light; their errors are
        stacked.
    - `parameters`: the fitted numbers with their bounds.
    - `solver`: a `Solver`, or any least-squares solver or minimiser of optimistix, such as `optimistix.BFGS(1e-4,
        1e-6)`. Wrap it in `Solver(method=...)` for another number of steps.
    - `anneal`: the annealing of the compare. A fit of poses anneals in its last phases if it also fits a bias.
    - `loss`: a loss of the errors of several problems; by default the mean over all pixels. Or a function of three
        images (h, w), predicted, reference and mask (whether each pixel counts), that returns an array of residuals,
        whose squares are summed, or a number, 0 or more. It is called once for each image, and the loss is the mean
        over all images. At pixels that do not count, the predicted image equals the reference. Both images are blurred
        in the phases of a fit of poses. A number needs a minimiser: `Solver("bfgs")`, which is then the default,
        `"lbfgs"`, `"adam"`, or one of optimistix. An `equinox.Module` may have arrays. Arrays in a plain function's
        closure become constants of its compiled program.
    - `search`, `sureness`: the region of the search, and the intervals and fronts to compute around the best values.
    - `on_step`: called with every evaluation of the loss, while the fit runs; also with evaluations of a phase that is
        then repeated with memory for more silhouettes. An error in `on_step` ends the fit, and `fit` raises this error.
    - `progress`: called with the current stage of the fit, as text, and with the finished fraction, or `None` if the
        fraction is not known. If neither `progress` nor `on_step` is given, `diffshadow.setup` decides whether a line
        shows the progress.

    **Raises** `ValueError` if there are no parameters, one does not exist, is named twice or has bounds that the
    technique does not allow, another argument is out of its range, no pixel counts, the visibility is not finite or the
    loss less than 0 at the start, the loss is a number and the solver needs residuals, or the number of silhouettes
    never settles; and `TypeError` for objects of another kind.

    !!! Example

        ```python
        problem = fit.TechniqueProblem.of(scene, technique, truth)
        bounds = [fit.Parameter("bias.constant", 1.0, 0.0, 30.0)]
        result = fit.fit(problem, bounds, solver=fit.Solver(max_steps=10), anneal=fit.Anneal(phases=2))
        result.errors[1] <= result.errors[0]  # True
        sorted(result.fitted)  # ['bias.constant']
        ```
    """
    limit_programs()
    began = time.perf_counter()
    anneal, search, sureness = anneal or Anneal(), search or Search(), sureness or Sureness()
    check_instance("the anneal", anneal, Anneal, "a fit.Anneal")
    check_instance("the search", search, Search, "a fit.Search")
    check_instance("the sureness", sureness, Sureness, "a fit.Sureness")
    _check_parameters(parameters)
    fitted, joint = Parameters.of(parameters), Joint.of(problem, loss)
    sureness.check(joint, [p.name for p in parameters])
    check_problem(joint, fitted)
    chosen = _solver_for(joint, solver).for_problem(joint.moves)
    initial = as_float([p.counted().initial for p in parameters])
    spread = starts_within(fitted, initial, search.starts, search.seed)
    joint = joint.each(lambda problem: problem.planned())
    if (devices := devices_of(search.devices, moves=joint.moves)) > 1:
        # The program of a step puts one part on each device.
        joint = dataclasses.replace(joint.each(on_host), devices=devices)
    phases = phases_of(joint, fitted.paths, anneal, search.blurs, search.pixels)
    with showing("fit", unless=on_step is not None or progress is not None) as shown:
        update, watched = progress or shown, on_step
        if update is not None:
            watched = shown_steps(update, phases, search.starts, joint.own is not None, watched)
        judge = Judge(phases[-1].joint.hard(), fitted)
        run = Run(parameters, judge, phases, chosen, search.evaluations, watched, update)
        with run.reporter:
            path, tried = run.through(spread)
        found = _found(run, path, tried, sureness)
    seconds = time.perf_counter() - began - run.seconds_compiling
    asked = {"parameters": tuple(parameters), "solver": chosen, "search": search, "sureness": sureness}
    return FitResult(**found, **asked, seconds_compiling=run.seconds_compiling, seconds_running=seconds)


def _found(run: Run, path: Trajectory, tried: list[Start], sureness: Sureness) -> dict[str, Any]:
    """The findings of a run along its best path, and near its best values: the fields of the result.

    Within a run, values are relative to the parameters' offsets. Here the offsets are added, as in the reporter's
    steps.
    """
    named = lambda values: dict(zip(run.names, run.with_offsets(values), strict=True))
    best = path.chosen(run.solver.noise or 0.0)
    values, least, profiles = _chosen(run, path.values[best], sureness)
    front = front_of(run, least, sureness.front) if sureness.front else []
    end = run.judge.at(as_float(values))
    return {
        "technique": end.technique,
        "initial": named(path.values[0]),
        "fitted": named(values),
        "phases": [phase._replace(values=run.with_offsets(phase.values)) for phase in path.outcomes],
        "chosen": best - 1,
        "history": run.history,
        "flat": run.flat(path),
        "arrangement": end.subject if end.moves else None,
        "precision": run.precision(path, best - 1),
        "starts": [
            start._replace(initial=run.with_offsets(start.initial), end=run.with_offsets(start.end)) for start in tried
        ],
        "enlargements": run.enlargements,
        "problems": run.judge.joint.problems,
        "profiles": [
            each.shifted(p.offset) if p.offset else each for each, p in zip(profiles, run.given, strict=False)
        ],
        "best": named(least),
        "front": [point._replace(values=run.with_offsets(point.values)) for point in front],
        "at_bounds": at_bounds(run, run.given, values),
        "errors": (root(path.losses[0]), run.error(least)),
        "is_own_loss": run.judge.joint.own is not None,
    }


def _chosen(run: Run, values: Values, sureness: Sureness) -> tuple[Values, Values, list[Profile]]:
    """The preferred values, the values with the lowest error, and the profiles around the latter."""
    if not (sureness.within or sureness.prefer):
        return values, values, []
    profiler = Profiler(run, [p.counted() for p in run.given], values)
    profiles = profiler.profiles(sureness.within) if sureness.within else []
    least = profiler.best.values
    preferred = profiler.preferred(sureness.prefer, sureness.tolerance).values if sureness.prefer else least
    return preferred, least, profiles


def _check_parameters(parameters: Any) -> None:
    """**Raises** `TypeError` unless `parameters` is a list of `Parameter`."""
    if not isinstance(parameters, Sequence):
        raise TypeError(f"the parameters are of type {type(parameters).__name__}; expected a list of fit.Parameter")
    for parameter in parameters:
        check_instance("a parameter", parameter, Parameter, 'a fit.Parameter, such as Parameter("bias.constant", ...)')


def check_loss(loss: LossFunction, solver: Solver, shape: tuple[int, int]) -> None:
    """Checks your own loss for images of this `shape`, (height, width), as `fit` does.

    **Raises** `TypeError` if it does not return a valid loss; `ValueError` if it returns a number and the solver needs
    residuals.
    """
    own = OwnLoss.of(loss, [shape])
    _check_solver(own.is_scalar, solver)


def _check_solver(is_number: bool, solver: Solver) -> None:
    if is_number and solver.is_least_squares:
        raise ValueError(
            f"the loss returns a number, and {solver.title} needs residuals; expected a minimiser, or an array: set "
            'solver to fit.Solver("bfgs") (in YAML, fit.solver.type: bfgs) or optimistix.BFGS(1e-4, 1e-6), or let the '
            "loss return residuals, whose squares are summed"
        )


def _solver_for(joint: Joint, solver: Any) -> Solver:
    """The solver for the loss of `joint`. The default depends on the loss.

    **Raises** `ValueError` if it needs residuals, and the loss is a number.
    """
    is_number = joint.own is not None and joint.own.is_scalar
    if solver is None and is_number:
        return Solver("bfgs")
    solver = Solver.of(solver)
    _check_solver(is_number, solver)
    return solver
