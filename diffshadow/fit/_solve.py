"""Fitting to a reference, by least squares, in phases.

The hard compare has no gradient, so the fit of a technique runs in phases under a soft one whose width shrinks
geometrically, each phase starting from the last. Where lights or meshes move, phases go from coarse images and maps
to fine ones, under the hard compare, for the outlines' motion is what counts; a bias that is fitted along needs the
soft one, in the end. The last phase is repeated under less blur, which ends nearer to the truth, and sees less far.
What judges is the hard compare at full resolution: it sees the start and the end of every phase, and the best of them
is the result, so a fit never ends worse than it began. Of poses it sees blurred differences, as the phases do, and
takes the last of those that differ by less than the loss jumps.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .._misc import as_float
from ..raster import Overflow
from ..shadow import ShadowMapping
from ._adam import Adam
from ._arrangement import Arrangement
from ._history import Report, Reporter, Step, report_overflow
from ._levenberg_marquardt import LevenbergMarquardt
from ._parameters import Bounds, Parameter, bounds_of, with_values
from ._phases import Phase, enlarged, hard, phases_of, prepared
from ._precision import Precision, precision_of
from ._programs import compiled
from ._residuals import AnyProblem, Joint, any_of, check_problem
from ._settings import Anneal, Solver, check_anneal, check_solver
from ._starts import starts_within

_Images = tuple[Float[Array, "..."], ...]

# Singular values of the Jacobian below this share of the largest count as zero: float32 knows no better.
_LEAST_SINGULAR = 1e-6
_LEAST_SQUARES = ("levenberg_marquardt", "dogleg")
# How often a phase may be given a larger capacity to draw.
_ENLARGEMENTS = 6
_NEVER_ENOUGH = (
    f"the capacity to draw is too small after {_ENLARGEMENTS} enlargements; expected it to settle: narrow the bounds "
    "of what moves"
)
# By which share the loss of poses jumps as they move a little, and pixels go from lit to shadowed and back.
_NOISE_OF_POSES = 0.25
# Mean square errors are not told from 0 below this.
_LEAST_LOSS = 1e-10


class Outcome(NamedTuple):
    """How a phase ended.

    - `width`: of its soft compare, in texels; 0 for the hard one.
    - `steps`: the solver took.
    - `result`: `"successful"`, `"max_steps reached"`, or what the solver says went wrong.
    - `gradient_norm`: of the soft mean square error with respect to the parameters over their bounds' distance.
    - `hard_loss`: the mean square error under the hard compare at the phase's end, of whole differences; `values`: the
        parameters there.
    - `level`: the downsampling factor, each coarse pixel averages `level` × `level` pixels; `blur`: the standard
        deviation, in such pixels, of the Gaussian under which images were compared, 0 where nothing moves.
    """

    width: float
    steps: int
    result: str
    gradient_norm: float
    hard_loss: float
    values: tuple[float, ...]
    level: int = 1
    blur: float = 0.0


class Start(NamedTuple):
    """One of several starts: where it began, where the phases that all starts run took it, and the judge's loss there.

    That is the mean square of blurred differences, as phases see them, under the hard compare at full resolution.
    """

    initial: tuple[float, ...]
    end: tuple[float, ...]
    loss: float


class FitResult(NamedTuple):
    """What a fit found.

    - `technique`: the fitted technique, with the hard compare.
    - `initial`, `fitted`: values by name.
    - `phases`: how each went; `chosen`: which of them ended best under the hard compare, -1 if the start was best. Of
        poses, whose loss jumps as they move, the last that is not worse by more than that.
    - `history`: every evaluation, in order.
    - `flat`: names of the parameters that stayed where they began, and have no slope there; they were not fitted.
    - `seconds_compiling`, `seconds_running`: of the whole fit.
    - `arrangement`: where lights or meshes were fitted, all that was.
    - `precision`: how well the values are determined; none if the start was best.
    - `starts`: how each of several starts went; `phases` and `initial` are those of the best.
    - `enlargements`: how often a phase was repeated with a larger capacity to draw.
    - `problems`: those that were fitted, with the capacity to draw what the bounds allow.
    """

    technique: ShadowMapping
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
    problems: tuple[AnyProblem, ...] = ()

    @property
    def steps(self) -> int:
        """Solver steps of all phases."""
        return sum(phase.steps for phase in self.phases)


def fit(
    problem: AnyProblem | Sequence[AnyProblem],
    parameters: Sequence[Parameter],
    *,
    solver: Solver | None = None,
    anneal: Anneal | None = None,
    levels: Sequence[int] | None = None,
    starts: int = 1,
    seed: int = 0,
    on_step: Callable[[Step], None] | None = None,
) -> FitResult:
    """Fits numbers of a technique, or of an arrangement, so that its visibility comes closest to the reference.

    **Arguments:**

    - `problem`: one, or several that share what is fitted, such as one for each light; their errors are stacked.
    - `parameters`: what is fitted, and within which bounds.
    - `solver`, `anneal`: defaults if left out. A fit of poses anneals in its last phases, if it fits a bias along.
    - `levels`: of a fit of poses, how many pixels a side make one, phase by phase, down to 1. Phases before the last
        level move poses only. 8 and 1 if left out, or the nearest that divides the resolutions.
    - `starts`: how many starts are tried: the initial values, and a Sobol sequence over the bounds. The best of them
        by the hard compare, after all phases but those of the last level, is gone on with.
    - `seed`: of the starts.
    - `on_step`: called with every evaluation of the loss, while the fit runs; also with those of a phase that is then
        repeated with a larger capacity.

    **Raises** `ValueError` if there are no parameters, one does not exist, is named twice or has bounds that the
    technique does not allow, `solver`, `anneal`, `levels` or `starts` hold values that make no sense, no pixel counts,
    or the visibility is not finite at the start.
    """
    solver, anneal = solver or Solver(), anneal or Anneal()
    paths = tuple(p.where for p in parameters)
    bounds, joint = bounds_of(parameters), Joint.of(problem)
    check_solver(solver)
    check_anneal(anneal)
    check_problem(joint, paths, bounds)
    initial = as_float([p.initial for p in parameters])
    spread = starts_within(bounds, initial, starts, seed)
    began = time.perf_counter()
    joint = prepared(joint, paths, bounds, initial)
    phases = phases_of(joint, paths, anneal, levels)
    run = _Run(parameters, hard(phases[-1].joint), phases, solver, on_step)
    with run.reporter:
        path, tried = run.through(spread)
    best = path.chosen(_NOISE_OF_POSES if joint.moves else 0.0)
    fitted = path.values[best]
    subject = with_values(run.judge.subject, paths, as_float(fitted))
    return FitResult(
        technique=Joint(subject, ()).technique,
        initial=dict(zip(run.names, path.values[0], strict=True)),
        fitted=dict(zip(run.names, fitted, strict=True)),
        phases=path.outcomes,
        chosen=best - 1,
        history=run.history,
        flat=run.flat(path),
        seconds_compiling=run.seconds_compiling,
        seconds_running=time.perf_counter() - began - run.seconds_compiling,
        arrangement=subject if isinstance(subject, Arrangement) else None,
        precision=run.precision(path, best - 1),
        starts=tried,
        enlargements=run.enlargements,
        problems=run.judge.problems,
    )


class _Solution(NamedTuple):
    """The end of a phase, as arrays.

    Derivatives are by each parameter's share of its bounds' distance: comparable, and free of the reparametrisation.
    `slope` is the length of a column of the residuals' Jacobian, 0 where a parameter changes nothing; `differences` and
    `slopes` are images, before they are compared, of each problem: (h, w), and (a, h, w).
    """

    value: Float[Array, " a"]
    gradient: Float[Array, " a"]
    slope: Float[Array, " a"]
    differences: _Images
    slopes: _Images
    steps: Array
    result: optx.RESULTS


class _Path(NamedTuple):
    """Where a start has come to: the free values at the start and after each phase, and the judge's losses there.

    `ends` holds the phases so far and their solutions.
    """

    free: list[Float[Array, " p"]]
    values: list[tuple[float, ...]]
    losses: list[float]
    outcomes: list[Outcome]
    ends: list[tuple[Phase, _Solution]]

    def chosen(self, noise: float) -> int:
        """The index of the best values: the last whose loss exceeds the least by no more than this share of it.

        Losses within the noise tell nothing; what tells then is that the phase has no slope left at its end.
        """
        if not noise:
            return int(np.argmin(self.losses))
        return int(np.flatnonzero(np.asarray(self.losses) <= (1 + noise) * min(self.losses))[-1])


class _Run:
    """A fit on its way: its phases, their compiled programs, and what is known so far."""

    def __init__(
        self,
        parameters: Sequence[Parameter],
        judge: Joint,
        phases: list[Phase],
        solver: Solver,
        on_step: Callable[[Step], None] | None,
    ):
        self.names, self.paths = tuple(p.name for p in parameters), tuple(p.where for p in parameters)
        self.bounds = bounds_of(parameters)
        self.judge, self.phases, self.solver = judge, phases, solver
        self.history: list[Step] = []
        self.reporter = Reporter(self.bounds, self.history, on_step)
        self.slopes = np.zeros(len(parameters))
        self.enlargements = 0
        self.seconds_compiling = 0.0
        self._programs: dict[Any, Any] = {}

    def through(self, spread: Float[Array, "s p"]) -> tuple[_Path, list[Start]]:
        """The best path from `spread` (s, p), and what became of each start where there are several."""
        last = [i for i, phase in enumerate(self.phases) if phase.level == 1]
        first = [i for i in range(len(self.phases)) if i not in last]
        # Without coarse phases, all starts run all of them.
        shared, rest = (first, last) if first and len(spread) > 1 else ([*first, *last], [])
        paths = []
        for number, initial in enumerate(spread):
            self.reporter.start = number
            paths.append(self._along(shared, self._start(initial)))
        tried = [Start(p.values[0], p.values[int(np.argmin(p.losses))], min(p.losses)) for p in paths]
        best = int(np.argmin([start.loss for start in tried]))
        self.reporter.start = best
        return self._along(rest, paths[best]), tried if len(spread) > 1 else []

    def precision(self, path: _Path, chosen: int) -> Precision | None:
        """How well the chosen phase determines what it fitted; none if the start was better than all phases."""
        if chosen < 0:
            return None
        phase, solution = path.ends[chosen]
        active = np.asarray(phase.active)
        span = np.asarray(self.bounds.upper - self.bounds.lower)[active]
        names = [self.names[i] for i in phase.active]
        on_host = lambda images: [np.asarray(image) for image in images]
        return precision_of(names, on_host(solution.differences), on_host(solution.slopes), phase.blurs, span)

    def flat(self, path: _Path) -> list[str]:
        """Names of the parameters that had no slope, and never moved."""
        rests = np.all(np.asarray(path.free) == np.asarray(path.free[0]), axis=0)
        return [name for name, slope, rest in zip(self.names, self.slopes, rests, strict=True) if slope == 0 and rest]

    def _start(self, initial: Float[Array, " p"]) -> _Path:
        loss, _ = self._judged(initial)
        if not np.isfinite(loss):
            raise ValueError(
                "the visibility or the reference is not finite at the initial values; expected numbers: check "
                "the mesh, the light and the reference"
            )
        return _Path([self.bounds.to_free(initial)], [tuple(initial.tolist())], [loss], [], [])

    def _along(self, numbers: Sequence[int], path: _Path) -> _Path:
        for number in numbers:
            path = self._solved(number, path)
        return path

    def _solved(self, number: int, path: _Path) -> _Path:
        """One phase more, from where `path` ends."""
        phase, free = self.phases[number], path.free[-1]
        active = np.asarray(phase.active)
        # Errors of any size look alike to the solver, so that its tolerances mean the same for all.
        scale = 1 / np.sqrt(max(path.losses[-1], _LEAST_LOSS)) if phase.joint.moves else 1.0
        self.reporter.begin(number, phase.width, np.asarray(free), active, scale)
        solution = self._drawn_by_phase(number, free, scale)
        if bool(jnp.all(jnp.isfinite(solution.value))):
            free = free.at[active].set(solution.value)
        self.slopes[active] = np.maximum(self.slopes[active], np.asarray(solution.slope))
        values = self.bounds.to_bounded(free)
        loss, hard_loss = self._judged(values)
        outcome = _outcome(solution, phase, hard_loss, values)
        return _Path(
            [*path.free, free],
            [*path.values, outcome.values],
            [*path.losses, loss],
            [*path.outcomes, outcome],
            [*path.ends, (self.phases[number], solution)],
        )

    def _arguments(self, phase: Phase, free: Float[Array, " p"], scale: float) -> tuple[Any, ...]:
        subject = with_values(phase.joint.subject, self.paths, self.bounds.to_bounded(free))
        active = np.asarray(phase.active)
        bounds = Bounds(self.bounds.lower[active], self.bounds.upper[active])
        paths = tuple(self.paths[i] for i in phase.active)
        joint = Joint(subject, phase.joint.problems)
        return joint, paths, bounds, free[active], self.solver, self.reporter.token, as_float(scale)

    def _judged(self, values: Float[Array, " p"]) -> tuple[float, float]:
        """The judge's losses at `values` (p,): of what counts of the differences, and of all of them."""
        loss, hard_loss = self._drawn_by_judge(values)
        finite = lambda loss: float(loss) if np.isfinite(loss) else np.inf
        return finite(loss), finite(hard_loss)

    def _drawn_by_phase(self, number: int, free: Float[Array, " p"], scale: float) -> _Solution:
        """What the program of a phase returns, repeated with a larger capacity until nothing is missing."""
        for _ in range(_ENLARGEMENTS + 1):
            phase = self.phases[number]
            found = self._returned(phase.program, _run_phase, self._arguments(phase, free, scale))
            if not self.reporter.overflowed:
                return found
            places = list(dict.fromkeys(self.reporter.overflowed))
            self._forget(phase.program)
            self.phases[number] = phase._replace(joint=enlarged(phase.joint, self.paths, as_float(places)))
            self.reporter.again()
        raise RuntimeError(_NEVER_ENOUGH)

    def _drawn_by_judge(self, values: Float[Array, " p"]) -> tuple[Array, Array]:
        """What the judge's program returns, likewise."""
        for _ in range(_ENLARGEMENTS + 1):
            loss, hard_loss, overflow = self._returned(None, _losses, (self.judge, self.paths, values))
            if not overflow:
                return loss, hard_loss
            self._forget(None)
            self.judge = enlarged(self.judge, self.paths, values[None])
        raise RuntimeError(_NEVER_ENOUGH)

    def _returned(self, key: Any, function: Any, arguments: tuple[Any, ...]) -> Any:
        found = self._program(key, function, arguments)(*arguments)
        jax.effects_barrier()
        return jax.block_until_ready(found)

    def _forget(self, key: Any) -> None:
        """Drops a program whose capacity is too small."""
        self.enlargements += 1
        self._programs.pop(key, None)

    def _program(self, key: Any, function: Any, arguments: tuple[Any, ...]) -> Any:
        """The compiled program of the phases that `key` tells; `None` is the judge's."""
        if key not in self._programs:
            started = time.perf_counter()
            self._programs[key] = compiled(function, arguments)
            self.seconds_compiling += time.perf_counter() - started
        return self._programs[key]


def _phase(
    problem: Joint, names: tuple[str, ...], bounds: Bounds, y: Array, solver: Solver, token: Array, scale: Array
) -> _Solution:
    def residual(y: Array, args: tuple[Joint, Bounds, Array]) -> tuple[Array, tuple[_Images, _Images]]:
        # A solver asks for several products with the Jacobian. As a linear function it would be compiled, and
        # evaluated, anew for each; here it is a matrix, found once beside the residuals.
        problem, bounds, scale = args
        share = bounds.share(y)
        fixed = jax.lax.stop_gradient(share)
        differences, slopes, overflow = _with_slopes(problem, names, bounds, fixed)
        if problem.moves:
            report_overflow(token, overflow, y)
        change = jnp.matmul(_columns(jax.vmap(problem.compared)(slopes)), share - fixed, precision="highest")
        return scale * (_flat(problem.compared(differences)) + change), (differences, slopes)

    solution = optx.least_squares(
        residual,
        _optimistix(solver, token, problem.moves),
        y,
        (problem, bounds, scale),
        {"jac": "fwd"} if solver.name in _LEAST_SQUARES else {"autodiff_mode": "fwd"},
        has_aux=True,
        max_steps=solver.max_steps,
        throw=False,
    )
    differences, slopes = solution.state.aux
    end, jacobian = _flat(problem.compared(differences)), _columns(jax.vmap(problem.compared)(slopes))
    return _Solution(
        value=solution.value,
        gradient=2 * jnp.matmul(end, jacobian, precision="highest"),
        slope=jnp.sqrt(jnp.sum(jacobian**2, axis=0)),
        differences=differences,
        slopes=slopes,
        steps=solution.stats["num_steps"],
        result=solution.result,
    )


def _with_slopes(
    problem: Joint, names: tuple[str, ...], bounds: Bounds, share: Float[Array, " p"]
) -> tuple[_Images, _Images, Overflow]:
    """All differences where the parameters have gone so far (p,) between their bounds, and their derivatives by each.

    **Returns:** images (h, w), stacks of them (p, h, w), and whether a capacity was too small to draw them.
    """

    def differences(share: Array) -> tuple[_Images, Overflow]:
        overflows: list[Overflow] = []
        found = problem.differences(with_values(problem.subject, names, bounds.at(share)), overflows)
        return found, any_of(overflows)

    # Few parameters, many pixels: forward.
    pushed = jax.vmap(lambda way: jax.jvp(differences, (share,), (way,), has_aux=True), out_axes=(None, 0, None))
    return pushed(jnp.eye(share.shape[0], dtype=share.dtype))


def _flat(images: _Images) -> Float[Array, " n"]:
    return jnp.concatenate([image.ravel() for image in images])


def _columns(stacks: _Images) -> Float[Array, "n p"]:
    return jnp.concatenate([stack.reshape(stack.shape[0], -1) for stack in stacks], axis=1).T


_run_phase: Any = eqx.filter_jit(_phase)
_losses: Any = eqx.filter_jit(
    lambda problem, names, values: problem.losses(with_values(problem.subject, names, values))
)


def _optimistix(solver: Solver, token: Array, moves: bool) -> optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser:
    report = Report(token)
    tolerances = {"rtol": solver.rtol, "atol": solver.atol, "verbose": report}
    match solver.name:
        case "levenberg_marquardt":
            return LevenbergMarquardt(**tolerances, noise=_NOISE_OF_POSES if moves else 0.0)
        case "dogleg":
            # It solves undamped: a parameter without a gradient must not spoil the others' steps.
            return optx.Dogleg(**tolerances, linear_solver=lx.SVD(rcond=_LEAST_SINGULAR))
        case "bfgs":
            return optx.BFGS(**tolerances)
        case "lbfgs":
            return optx.LBFGS(**tolerances)
        case "adam":
            return Adam(solver.learning_rate, solver.max_steps, solver.rtol, solver.atol, report)


def _outcome(solution: _Solution, phase: Phase, hard_loss: float, values: Array) -> Outcome:
    if solution.result == optx.RESULTS.successful:
        result = "successful"
    elif solution.result == optx.RESULTS.nonlinear_max_steps_reached:
        result = "max_steps reached"
    else:
        result = optx.RESULTS[solution.result]
    gradient_norm = float(jnp.linalg.norm(solution.gradient))
    if not np.isfinite(gradient_norm):
        result = "the loss is not finite near the solution"
    steps, at = int(solution.steps), tuple(values.tolist())
    return Outcome(phase.width, steps, result, gradient_norm, hard_loss, at, phase.level, max(phase.blurs))
