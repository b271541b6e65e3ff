"""The course of a fit: its starts, its phases, and their memory for silhouettes."""

import dataclasses
import time
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .._arithmetic import as_float, as_int
from .._progress import Update
from .._types import HostArray
from ._history import Reporter, Step
from ._judge import Judge
from ._loss import Loss
from ._parameters import Parameter, Parameters
from ._phases import Phase, enlarged
from ._precision import Precision, on_grids, precision_of
from ._programs import compiled
from ._search import search
from ._solve import Solution, solve
from .problems import on_host
from .solvers import Solver, Stop

# The maximum number of times that a phase gets memory for more silhouettes.
_ENLARGEMENTS = 6
_NEVER_ENOUGH = (
    f"there are too many silhouettes for the memory planned, after {_ENLARGEMENTS} enlargements; expected a stable "
    "number: narrow the bounds of the moving objects"
)
# Mean square errors below this count as 0.
_MIN_LOSS = 1e-10
# The token for no reporter.
_UNHEARD = -1
# The error of layouts that do not suit the scene, because visibility cannot be wrong by more than 1.
_UNSUITABLE = 1.0

Values = tuple[float, ...]
"""The values of all parameters, (p,)."""


class Outcome(NamedTuple):
    """The end of a phase.

    - `width`: width of its soft compare, in texels; 0 for the hard compare.
    - `steps`: number of solver steps.
    - `result`: `"successful"`, `"max_steps reached"`, or the solver's error.
    - `gradient_norm`: norm of the gradient of the soft mean square error with respect to the parameters as fractions of
      their bounds' distance; 0 for a search.
    - `hard_loss`: the mean square error under the hard compare at the phase's end, of whole differences; `values`: the
      parameters there.
    - `blur`: the standard deviation, in pixels, of the Gaussian under which images were compared; 0 if nothing moves.
    - `searched`: the fraction of the bounds in which it searched for numbers without a derivative; 0 for a phase by
      gradient. The steps of a search are evaluations of the error.
    """

    width: float
    steps: int
    result: str
    gradient_norm: float
    hard_loss: float
    values: tuple[float, ...]
    blur: float = 0.0
    searched: float = 0.0


class Start(NamedTuple):
    """One of several starts.

    - `initial`: its values; `end`: the values after the phases that all starts run.
    - `loss`: the mean square of the compared differences at `end`, under the hard compare at full resolution.
    """

    initial: tuple[float, ...]
    end: tuple[float, ...]
    loss: float


class Trajectory(NamedTuple):
    """The course of one start: free values, values and the judge's losses at the start and after each phase.

    `ends` are the phases so far and their solutions. A search has no solution.
    """

    free: list[Float[Array, " p"]]
    values: list[tuple[float, ...]]
    losses: list[float]
    outcomes: list[Outcome]
    ends: list[tuple[Phase, Solution | None]]

    def chosen(self, noise: float) -> int:
        """The index of the best values: the last values whose loss exceeds the lowest loss by at most this fraction.

        Differences within the noise carry no information. Among such values, a later phase has the smaller gradient.
        """
        if not noise:
            return int(np.argmin(self.losses))
        return int(np.flatnonzero(np.asarray(self.losses) <= (1 + noise) * min(self.losses))[-1])


class Run:
    """A fit in progress.

    - `given`: the fitted parameters. All values in a run are relative to their offsets.
    - `judge`: evaluates the start and the end of every phase. The best of these is the result.
    - `phases`: the phases. Their memory for silhouettes may grow.
    - `evaluations`: the number of error evaluations of a search, for each parameter.
    - `history`: every evaluation so far, in order.
    - `update`: called with the current activity of the fit, and the finished fraction.
    """

    update: Update | None = None

    def __init__(
        self,
        parameters: Sequence[Parameter],
        judge: Judge,
        phases: list[Phase],
        solver: Solver,
        evaluations: int,
        on_step: Callable[[Step], None] | None,
        update: Update | None,
    ):
        self.given = tuple(parameters)
        self.names, self.parameters = tuple(p.name for p in parameters), judge.parameters
        self.judge, self.phases, self.solver, self.evaluations = judge, phases, solver, evaluations
        self.history: list[Step] = []
        self.update = update
        # Not a method: with a cycle from the reporter to this run, its images would stay until a garbage collection.
        self.with_offsets = partial(_with_offsets, self.given)
        """Converts values (p,) to the coordinates of the given parameters, by adding their offsets."""
        self.reporter = Reporter(self.parameters, self.history, on_step, self.with_offsets)
        self.slopes = np.zeros(len(parameters))
        self.enlargements = 0
        self.seconds_compiling = 0.0
        self._programs: dict[Any, dict[Any, Any]] = {}

    def say(self, detail: str) -> None:
        """Reports the activity of the fit, apart from its steps."""
        if self.update is not None:
            self.update(detail, None)

    def through(self, spread: Float[Array, "s p"]) -> tuple[Trajectory, list[Start]]:
        """The best path from `spread` (s, p), and the course of each start if there are several."""
        shared = [i for i, phase in enumerate(self.phases) if phase.shared]
        rest = [i for i, phase in enumerate(self.phases) if not phase.shared]
        paths = []
        for number, initial in enumerate(np.asarray(spread)):
            self.reporter.start = number
            paths.append(self._along(shared, self._start(as_float(initial))))
        tried = [Start(p.values[0], p.values[int(np.argmin(p.losses))], min(p.losses)) for p in paths]
        best = int(np.argmin([start.loss for start in tried]))
        self.reporter.start = best
        return self._along(rest, paths[best]), tried if len(spread) > 1 else []

    def precision(self, path: Trajectory, chosen: int) -> Precision | None:
        """The precision of the chosen phase's values. `None` for a search, for a user's loss, or if the start was
        better than all phases."""
        phase, solution = path.ends[chosen] if chosen >= 0 else (None, None)
        if phase is None or solution is None or phase.joint.own is not None:
            return None
        lower, upper = np.asarray(self.parameters.lower), np.asarray(self.parameters.upper)
        span = (upper - lower)[np.asarray(phase.active)]
        names = [self.names[i] for i in phase.active]
        joint = phase.joint.put(self.parameters, as_float(path.values[chosen + 1]))
        own, stacks = on_host((solution.differences, solution.slopes))
        differences = on_grids(joint, own, np.asarray(solution.roots))
        slopes = [stack for each in stacks for stack in each.swapaxes(0, 1)]
        channels = np.size(phase.joint.problems[0].count)
        return precision_of(names, differences, slopes, phase.blurs, span, channels)

    def flat(self, path: Trajectory) -> list[str]:
        """Names of the parameters that had no slope, and never moved."""
        rests = np.all(np.asarray(path.free) == np.asarray(path.free[0]), axis=0)
        return [name for name, slope, rest in zip(self.names, self.slopes, rests, strict=True) if slope == 0 and rest]

    def _start(self, initial: Float[Array, " p"]) -> Trajectory:
        loss, _ = self._judged(initial)
        if not np.isfinite(loss):
            raise ValueError(
                "the visibility or the reference is not finite at the initial values; expected numbers: check "
                "the mesh, the light and the reference"
            )
        if loss < -(_MIN_LOSS**0.5):
            raise ValueError(
                f"the loss is {loss:.4g} at the initial values; expected 0 or more: add a constant, as in 1 - SSIM"
            )
        return Trajectory([self.parameters.to_free(initial)], [tuple(initial.tolist())], [loss], [], [])

    def _along(self, numbers: Sequence[int], path: Trajectory) -> Trajectory:
        for number in numbers:
            path = self._continued(number, path)
        return path

    def _continued(self, number: int, path: Trajectory) -> Trajectory:
        """`path`, followed by one more phase from its end."""
        if self.phases[number].searched:
            return self._searched(number, path)
        phase, free = self.phases[number], path.free[-1]
        active = np.asarray(phase.active)
        # Relative residuals, so that the solver's tolerances mean the same for any size of the errors.
        scale = 1 / np.sqrt(max(path.losses[-1], _MIN_LOSS)) if phase.joint.moves else 1.0
        self.reporter.begin(number, phase.width, np.asarray(free), active, scale)
        solution = self._solution(number, free, as_float(path.values[-1]), scale)
        if np.isfinite(solution.value).all():
            free = _replaced(free, active, solution.value)
        self.slopes[active] = np.maximum(self.slopes[active], np.asarray(solution.slope))
        values = self.parameters.to_bounded(free)
        loss, hard_loss = self._judged(values)
        outcome = _outcome(solution, phase, hard_loss, values)
        return Trajectory(
            [*path.free, free],
            [*path.values, outcome.values],
            [*path.losses, loss],
            [*path.outcomes, outcome],
            [*path.ends, (self.phases[number], solution)],
        )

    def _searched(self, number: int, path: Trajectory) -> Trajectory:
        """`path`, followed by a search from its end."""
        phase, free, values = self.phases[number], path.free[-1], as_float(path.values[-1])
        active = np.asarray(phase.active)
        at, on_host = self.parameters[phase.active], lambda array: np.asarray(array, np.float64)
        self.reporter.begin(number, phase.width, np.asarray(free), active)

        def error(tried: np.ndarray) -> float:
            at_tried = _replaced(values, active, as_float(tried))
            try:
                loss, _ = self._judged(at_tried)
            except ValueError:
                # Values within the bounds that are invalid together, for example distances that do not increase.
                loss = _UNSUITABLE
            self.reporter.record(loss, tuple(at_tried.tolist()))
            return loss

        # A part of the box needs fewer evaluations.
        evaluations = max(round(self.evaluations * len(active) * phase.searched**0.5), 1)
        start = on_host(values)[active]
        found = search(error, start, on_host(at.lower), on_host(at.upper), evaluations, phase.searched)
        if (found.values != start).any():
            values = _replaced(values, active, as_float(found.values))
            free = _replaced(free, active, at.to_free(as_float(found.values), inset=0.0))
        self.slopes[active] = np.inf
        loss, hard_loss = self._judged(values)
        at_end = tuple(values.tolist())
        outcome = Outcome(0.0, found.evaluations, "successful", 0.0, hard_loss, at_end, searched=phase.searched)
        return Trajectory(
            [*path.free, free],
            [*path.values, at_end],
            [*path.losses, loss],
            [*path.outcomes, outcome],
            [*path.ends, (phase, None)],
        )

    def refitted(self, values: Values, kept: Collection[int], *, ratio: float = 1.0, least_gain: float = 0.0) -> Values:
        """The end of the last phase if it starts at `values`. The values at the indices `kept` do not change.

        **Arguments:** `ratio`: as for `Loss.reweighted`; `least_gain`: as for `Stop`.
        """
        phase = self.phases[-1]
        phase = phase._replace(joint=phase.joint.with_loss(phase.joint.loss.reweighted(ratio)))
        phase = phase._replace(stop=phase.stop._replace(least_gain=least_gain))
        active = np.asarray(phase.active)
        stays = np.isin(active, list(kept))
        if stays.all():
            return values
        at, now = self.parameters[phase.active], np.asarray(values, np.float32)[active]
        # A value without space between its bounds does not change, and the program is the same.
        lower, upper = (np.where(stays, now, np.asarray(end)) for end in (at.lower, at.upper))
        free = np.where(stays, 0, np.asarray(at.to_free(as_float(now))))
        narrowed = Parameters(at.paths, as_float(lower), as_float(upper))
        arguments = self._arguments(phase, as_float(values), narrowed, free, 1.0, as_int(_UNHEARD))
        found = self._ran(phase, arguments).value
        if not np.isfinite(found).all():
            return values
        return tuple(_replaced(as_float(values), active, narrowed.to_bounded(as_float(found))).tolist())

    def error(self, values: Values) -> float:
        """The root of the judge's loss at `values`. Infinite for a layout that does not suit the scene."""
        try:
            return root(self._judged(as_float(values))[0])
        except ValueError:
            return np.inf

    def sides(self, values: Values) -> tuple[float, float]:
        """The roots of the judge's two losses at `values`: false shadow and false light. Infinite for a layout that
        does not suit the scene."""
        try:
            dark, light = self.judge.sides(as_float(values))
        except ValueError:
            return np.inf, np.inf
        return dark**0.5, light**0.5

    def rmse(self, values: Values) -> float:
        """The root mean square error over all pixels under the hard compare, for any loss."""
        return float(self.judge.losses(as_float(values), Loss()).whole) ** 0.5

    def _arguments(
        self,
        phase: Phase,
        values: Float[Array, " p"],
        parameters: Parameters,
        free: Float[np.ndarray, " a"],
        scale: float,
        token: Array,
    ) -> tuple[Any, ...]:
        """The arguments of a phase's program from the `free` values of its active `parameters`."""
        own = phase.joint
        joint = own.each(lambda p: p.padded()).stacked() if own.moves else self.judge.seen_by(phase, values)
        joint = dataclasses.replace(joint, subject=self.parameters.put(own.subject, values), loss=own.loss)
        stop = Stop(*map(as_float, phase.stop))
        return joint, parameters, as_float(free), self.solver, token, as_float(scale), stop

    def _judged(self, values: Float[Array, " p"]) -> tuple[float, float]:
        """The judge's losses at `values` (p,): of the compared part of the differences, and of all differences."""
        for _ in range(_ENLARGEMENTS + 1):
            found = self.judge.losses(values, self.judge.loss)
            if not found.overflow:
                loss, hard_loss = (float(each) if np.isfinite(each) else np.inf for each in found[:2])
                return loss, hard_loss
            self.enlargements += 1
            self.judge.enlarge(values)
        raise ValueError(_NEVER_ENOUGH)

    def _solution(self, number: int, free: Float[Array, " p"], values: Float[Array, " p"], scale: float) -> Solution:
        """The result of a phase's program from the `free` values of `values`, repeated with memory for more silhouettes
        until none is missing."""
        for _ in range(_ENLARGEMENTS + 1):
            phase = self.phases[number]
            active = np.asarray(phase.active)
            at = self.parameters[phase.active]
            arguments = self._arguments(phase, values, at, np.asarray(free)[active], scale, self.reporter.token)
            with self.reporter.own_errors():
                found = self._ran(phase, arguments)
                jax.effects_barrier()
            if not self.reporter.overflowed:
                return found
            places = list(dict.fromkeys(self.reporter.overflowed))
            self.enlargements += 1
            # Their memory is too small for all silhouettes.
            self._programs.clear()
            larger = enlarged(phase.joint, self.parameters, as_float(places))
            self.phases = [each.with_memory_of(larger) for each in self.phases]
            self.reporter.again()
        raise ValueError(_NEVER_ENOUGH)

    def _ran(self, phase: Phase, arguments: tuple[Any, ...]) -> Solution:
        """The result of a phase's program for `arguments`. Only images and their derivatives stay on devices."""
        found = self._program(phase, arguments)(*arguments)
        numbers = {name: getattr(found, name) for name in ("value", "gradient", "slope", "roots")}
        return found._replace(**on_host(numbers))

    def _program(self, phase: Phase, arguments: tuple[Any, ...]) -> Any:
        """The compiled program of a phase for arguments of these shapes, which may differ between samples."""
        programs = self._programs.setdefault(phase.program, {})
        shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(arguments))
        if shapes not in programs:
            started = time.perf_counter()
            programs[shapes] = compiled(solve, arguments)
            self.seconds_compiling += time.perf_counter() - started
        return programs[shapes]


def _with_offsets(given: Sequence[Parameter], values: Values) -> Values:
    return tuple(value + p.offset if p.offset else value for value, p in zip(values, given, strict=True))


def root(loss: float) -> float:
    """The root of a loss; a user's loss may be less than 0."""
    return max(loss, 0.0) ** 0.5


def _replaced(
    free: Float[Array, " p"], active: np.ndarray, values: Float[Array | HostArray, " a"]
) -> Float[Array, " p"]:
    # NumPy compiles nothing.
    replaced = np.array(free)
    replaced[active] = values
    return as_float(replaced)


def _outcome(solution: Solution, phase: Phase, hard_loss: float, values: Array) -> Outcome:
    # Compared by message, because comparing the results themselves would be compiled.
    message, ends = optx.RESULTS[solution.result], optx.RESULTS
    names = {ends[ends.successful]: "successful", ends[ends.nonlinear_max_steps_reached]: "max_steps reached"}
    result = names.get(message, message)
    gradient_norm = float(np.linalg.norm(solution.gradient))
    if not np.isfinite(gradient_norm):
        result = "the loss is not finite near the solution"
    steps, at = int(solution.steps), tuple(values.tolist())
    return Outcome(phase.width, steps, result, gradient_norm, hard_loss, at, max(phase.blurs))
