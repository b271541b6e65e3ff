"""Fitting to a reference by least squares."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from .._checks import check_arguments, check_instance
from .._misc import as_float
from .._pictures import as_html
from ..settings.fit import FEWEST_POINTS
from ..settings.fit import Fit as Settings
from ..shadow import FittableTechnique
from ._anneal import Anneal
from ._arrangement import Arrangement
from ._bounds import AtBound, at_bounds
from ._front import FrontPoint, front_of
from ._history import Step
from ._loss import Loss
from ._parameters import Parameter, Parameters
from ._phases import phases_of
from ._precision import Precision
from ._profile import Bound, Profile, Profiler
from ._run import Outcome, Run, Start
from ._starts import starts_within
from .problems import AbstractProblem, Joint, check_problem
from .solvers import Solver

PIXELS = 1 << 16
"""The most pixels that a step of a fit of a technique evaluates, by default: as many as 256 x 256."""


class FitResult(NamedTuple):
    """What a fit found.

    - `technique`: the fitted technique, with the hard compare.
    - `initial`, `fitted`: values by name.
    - `phases`: how each went; `chosen`: which of them ended best under the hard compare, -1 if the start was best. Of
        phases whose losses differ by less than the solver's `noise`, the last.
    - `history`: every evaluation, in order.
    - `flat`: names of the parameters that stayed where they began, and have no slope there; they were not fitted.
    - `seconds_compiling`, `seconds_running`: of the whole fit.
    - `arrangement`: the fitted technique, lights and meshes, where lights or meshes were fitted.
    - `precision`: how well the values are determined; none if the start was best.
    - `starts`: how each of several starts went; `phases` and `initial` are those of the best.
    - `enlargements`: how often a phase was repeated with memory for more silhouettes.
    - `profiles`: of the parameters, if intervals were asked for; they are about the best values.
    - `best`: the values of the least error, by name. Others are `fitted` only if they are preferred.
    - `front`: of false shadow against false light, if it was asked for.
    - `at_bounds`: the fitted values that ended on a bound, and whether the error still falls there.
    - `errors`: the roots of the loss under the hard compare, at the start and at the best values.
    - `problems`: those that were fitted, with the memory for silhouettes that it needed, and maps laid out as fitted.
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
    starts: list[Start] = []  # noqa: RUF012
    enlargements: int = 0
    problems: tuple[AbstractProblem, ...] = ()
    profiles: list[Profile] = []  # noqa: RUF012
    best: dict[str, float] = {}  # noqa: RUF012
    front: list[FrontPoint] = []  # noqa: RUF012
    at_bounds: list[AtBound] = []  # noqa: RUF012
    errors: tuple[float, float] = (0.0, 0.0)

    def _repr_html_(self) -> str:
        """The fitted values and errors as a table, and the reference of the first problem."""
        deviations = {} if self.precision is None else self.precision.deviations
        rows: list[tuple[str, ...]] = [("", "before", "after", "std. dev.")]
        for name, value in self.fitted.items():
            deviation = f"{deviations[name]:.2g}" if name in deviations else ""
            rows.append((name, f"{self.initial[name]:.4g}", f"{value:.4g}", deviation))
        rows.append(("error", *(f"{error:.4f}" for error in self.errors), ""))
        # A sample of pixels is no image.
        references = (getattr(each, "reference", None) for each in self.problems)
        images = [image for image in references if image is not None and np.ndim(image) == 2]
        title = f"Fit of {len(self.fitted)} parameters: {self.steps} steps in {len(self.phases)} phases"
        return as_html(title, images[0] if images else None, rows)

    @property
    def steps(self) -> int:
        """Solver steps of all phases."""
        return sum(phase.steps for phase in self.phases)


def fit(
    problem: AbstractProblem | Sequence[AbstractProblem],
    parameters: Sequence[Parameter],
    *,
    solver: Solver | None = None,
    anneal: Anneal | None = None,
    blurs: Sequence[float] | None = Settings.blurs,
    starts: int = Settings.multistart,
    seed: int = 0,
    evaluations: int = Settings.evaluations,
    loss: Loss | None = None,
    pixels: int = PIXELS,
    within: Sequence[float] = Settings.intervals,
    prefer: Sequence[tuple[str, Bound]] = (),
    tolerance: float = Settings.tolerance,
    front: int = Settings.front,
    on_step: Callable[[Step], None] | None = None,
) -> FitResult:
    """Fits numbers of a technique, or of an arrangement, so that its visibility comes closest to the reference.

    Visibility has no useful derivative with respect to numbers that lay out the map, such as the spacing of cascades.
    If there are such, a bounded search over all parameters comes before the fit by gradient.

    The fit runs in phases (`_phases.py`). The hard compare at full resolution judges the start and the end of each, and
    the best of these is the result: a fit never ends worse than it began.

    **Arguments:**

    - `problem`: one, or several that share what is fitted, such as one for each light; their errors are stacked.
    - `parameters`: what is fitted, and within which bounds.
    - `solver`, `anneal`: defaults if left out. A fit of poses anneals in its last phases if it also fits a bias.
    - `blurs`: for a fit of poses, the standard deviations in pixels of the Gaussian under which images are compared,
        which fall. Phases before the last move poses only; a phase under the best blur for the map's texels follows. If
        left out, from an eighth of the images' shorter side to 3, each about a third of the one before.
    - `starts`: how many starts are tried: the initial values, and a Sobol sequence over the bounds. The best of them
        under the first blurs, by the hard compare, goes on.
    - `seed`: of the starts.
    - `evaluations`: how often the error is evaluated, for each parameter, in the search for numbers that lay out the
        map.
    - `loss`: of the errors of several problems; by default the mean over all pixels.
    - `pixels`: the most pixels that a step of a fit of a technique evaluates. If more count, it takes a random part;
        for a loss other than the mean, most of it from the worst problems, with errors that are corrected by those of
        whole images at the start of each phase. The judge sees all.
    - `within`: for each of these fractions ε, finds the interval of every parameter in which the error stays below
        (1 + ε) times the best, while the others are fitted again.
    - `prefer`, `tolerance`: names of parameters, and the bound, `"lower"` or `"upper"`, that they should come close to.
        Of all values whose error is at most (1 + `tolerance`) times the best, these are the result: the first parameter
        goes as far as it can, then the second, and so on. For fits of a technique, as `within` is.
    - `front`: how many weighted sums of false shadow and false light are made least, 3 or more; 0 for none. For fits
        of a technique.
    - `on_step`: called with every evaluation of the loss, while the fit runs; also with those of a phase that is then
        repeated with memory for more silhouettes.

    **Raises** `ValueError` if there are no parameters, one does not exist, is named twice or has bounds that the
    technique does not allow, another argument is out of its range, no pixel counts, the visibility is not finite at the
    start, or the number of silhouettes never settles; and `TypeError` for objects of another kind.
    """
    solver, anneal = solver or Solver(), anneal or Anneal()
    check_instance("the solver", solver, Solver, 'a fit.Solver, such as Solver("adam")')
    check_instance("the anneal", anneal, Anneal, "a fit.Anneal")
    if not isinstance(parameters, Sequence):
        raise TypeError(f"the parameters are of type {type(parameters).__name__}; expected a list of fit.Parameter")
    for parameter in parameters:
        check_instance("a parameter", parameter, Parameter, 'a fit.Parameter, such as Parameter("bias.constant", ...)')
    fitted, joint = Parameters.of(parameters), Joint.of(problem, loss)
    check_arguments(
        Settings,
        blurs=None if blurs is None else tuple(blurs),
        multistart=starts,
        evaluations=evaluations,
        intervals=tuple(within),
        tolerance=tolerance,
        front=front,
    )
    if pixels < 1:
        raise ValueError(f"pixels is {pixels}; expected 1 or more")
    _check_choice(joint, parameters, within, prefer)
    if front and (front < FEWEST_POINTS or joint.moves):
        raise ValueError(
            f"a front of {front} points is asked for; expected {FEWEST_POINTS} or more, in a fit of a technique"
        )
    check_problem(joint, fitted)
    solver = solver.for_problem(joint.moves)
    offsets, parameters = [p.offset for p in parameters], [p.counted() for p in parameters]
    initial = as_float([p.initial for p in parameters])
    spread = starts_within(fitted, initial, starts, seed)
    began = time.perf_counter()
    joint = joint.each(lambda problem: problem.planned())
    phases = phases_of(joint, fitted.paths, anneal, blurs, pixels)
    run = Run(parameters, phases[-1].joint.hard(), phases, solver, evaluations, _from_offsets(on_step, offsets))
    with run.reporter:
        path, tried = run.through(spread)
    best = path.chosen(solver.noise or 0.0)
    values, profiles, least = path.values[best], [], path.values[best]
    if within or prefer:
        profiler = Profiler(run, parameters, values)
        profiles = profiler.profiles(within) if within else []
        least = profiler.best.values
        values = profiler.preferred(prefer, tolerance).values if prefer else least
    points = front_of(run, least, front) if front else []
    end, precision = run.judged_at(as_float(values)), run.precision(path, best - 1)
    result = FitResult(
        technique=end.technique,
        initial=dict(zip(run.names, path.values[0], strict=True)),
        fitted=dict(zip(run.names, values, strict=True)),
        phases=path.outcomes,
        chosen=best - 1,
        history=run.history,
        flat=run.flat(path),
        seconds_compiling=run.seconds_compiling,
        seconds_running=time.perf_counter() - began - run.seconds_compiling,
        arrangement=end.subject if end.moves else None,
        precision=precision,
        starts=tried,
        enlargements=run.enlargements,
        problems=run.judge.problems,
        profiles=profiles,
        best=dict(zip(run.names, least, strict=True)),
        front=points,
        at_bounds=at_bounds(run, parameters, values),
        errors=(path.losses[0] ** 0.5, run.error(least)),
    )
    return _with_offsets(result, offsets) if any(offsets) else result


def _from_offsets(on_step: Callable[[Step], None] | None, offsets: Sequence[float]) -> Callable[[Step], None] | None:
    if on_step is None or not any(offsets):
        return on_step
    return lambda step: on_step(step._replace(values=_plus(step.values, offsets)))


def _plus(values: Sequence[float], offsets: Sequence[float]) -> tuple[float, ...]:
    return tuple(value + offset for value, offset in zip(values, offsets, strict=True))


def _with_offsets(result: FitResult, offsets: Sequence[float]) -> FitResult:
    """`result`, whose values are counted from `offsets` (p,), with the parameters' own values. Only lights and meshes
    have offsets, and their fits have neither profiles nor fronts."""
    by_name = lambda values: dict(zip(values, _plus(tuple(values.values()), offsets), strict=True))
    return result._replace(
        initial=by_name(result.initial),
        fitted=by_name(result.fitted),
        best=by_name(result.best),
        phases=[phase._replace(values=_plus(phase.values, offsets)) for phase in result.phases],
        history=[step._replace(values=_plus(step.values, offsets)) for step in result.history],
        starts=[
            start._replace(initial=_plus(start.initial, offsets), end=_plus(start.end, offsets))
            for start in result.starts
        ],
    )


def _check_choice(
    joint: Joint,
    parameters: Sequence[Parameter],
    within: Sequence[float],
    prefer: Sequence[tuple[str, Bound]],
) -> None:
    """**Raises** `ValueError` for intervals and preferences that cannot be found."""
    if (within or prefer) and joint.moves:
        raise ValueError("intervals or preferences are asked for in a fit of lights or meshes; expected none there")
    names = [p.name for p in parameters]
    for name, _ in prefer:
        if name not in names:
            raise ValueError(f"{name} is preferred and not fitted; expected one of {', '.join(names)}")
