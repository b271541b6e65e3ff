"""Fitting a technique to a reference, by least squares under a soft compare that hardens.

The hard compare has no gradient, so the fit runs in phases under a soft one whose width shrinks geometrically, each
phase starting from the last. What counts is the hard compare: it judges the start and the end of every phase, and the
best of them is the result, so a fit never ends worse than it began.
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
from ..shadow import HardCompare, ShadowMapping, SoftCompare
from ._history import Report, Reporter, Step
from ._parameters import Bounds, Parameter, bounds_of, with_values
from ._residuals import Joint, Problem, check_problem, residual_at
from ._settings import Anneal, Solver, check_anneal, check_solver

# Singular values of the Jacobian below this share of the largest count as zero: float32 knows no better.
_LEAST_SINGULAR = 1e-6


class Outcome(NamedTuple):
    """How a phase ended.

    - `width`: of its soft compare, in texels.
    - `steps`: the solver took.
    - `result`: `"successful"`, `"max_steps reached"`, or what the solver says went wrong.
    - `gradient_norm`: of the soft mean square error with respect to the parameters over their bounds' distance.
    - `hard_loss`: the mean square error under the hard compare at the phase's end; `values`: the parameters there.
    """

    width: float
    steps: int
    result: str
    gradient_norm: float
    hard_loss: float
    values: tuple[float, ...]


class FitResult(NamedTuple):
    """What a fit found.

    - `technique`: the fitted technique, with the hard compare.
    - `initial`, `fitted`: values by name.
    - `phases`: how each went; `chosen`: which of them ended best under the hard compare, -1 if the start was best.
    - `history`: every evaluation, in order.
    - `flat`: names of the parameters whose gradient was zero at every phase's start; they were not fitted.
    - `seconds_compiling`, `seconds_running`: of the whole fit.
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

    @property
    def steps(self) -> int:
        """Solver steps of all phases."""
        return sum(phase.steps for phase in self.phases)


def fit(
    problem: Problem | Sequence[Problem],
    parameters: Sequence[Parameter],
    *,
    solver: Solver | None = None,
    anneal: Anneal | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> FitResult:
    """Fits numbers of `problem.technique` so that its visibility comes closest to the reference.

    **Arguments:**

    - `problem`: one, or several that share a technique, such as one for each light; their errors are stacked.
    - `parameters`: what is fitted, and within which bounds.
    - `solver`, `anneal`: defaults if left out.
    - `on_step`: called with every evaluation of the loss, while the fit runs.

    **Raises** `ValueError` if there are no parameters, one does not exist, is named twice or has bounds that the
    technique does not allow, `solver` or `anneal` hold values that make no sense, no pixel counts, or the visibility is
    not finite at the start.
    """
    solver, anneal = solver or Solver(), anneal or Anneal()
    names, paths = tuple(p.name for p in parameters), tuple(p.where for p in parameters)
    bounds, joint = bounds_of(parameters), Joint.of(problem)
    check_solver(solver)
    check_anneal(anneal)
    check_problem(joint, paths, bounds)
    hard = eqx.tree_at(lambda p: p.technique.compare, joint, _hard(joint.technique))
    soft = eqx.tree_at(lambda p: p.technique.compare, joint, SoftCompare(anneal.start, anneal.kernel))
    initial = as_float([p.initial for p in parameters])

    history: list[Step] = []
    reporter = Reporter(bounds, history, on_step)
    started = time.perf_counter()
    compiled = _compile(soft, paths, bounds, bounds.to_free(initial), solver, reporter.token)
    hard_loss = _hard_loss.lower(hard, paths, initial).compile()
    seconds_compiling = time.perf_counter() - started

    started = time.perf_counter()
    phases: list[Outcome] = []
    best_loss, best, chosen = float(hard_loss(hard, paths, initial)), initial, -1
    if not np.isfinite(best_loss):
        raise ValueError(
            "the visibility or the reference is not finite at the initial values; expected numbers: check "
            "the mesh, the light and the reference"
        )
    y, slopes = bounds.to_free(initial), np.zeros(len(names))
    with reporter:
        for number, width in enumerate(anneal.widths):
            reporter.begin(number, width)
            soft = eqx.tree_at(lambda p: p.technique.compare.width, soft, as_float(width))
            solution = compiled(soft, paths, bounds, y, solver, reporter.token)
            jax.effects_barrier()
            if bool(jnp.all(jnp.isfinite(solution.value))):
                y = solution.value
            slopes = np.maximum(slopes, np.abs(np.asarray(solution.first_gradient)))
            values = bounds.to_bounded(y)
            loss = float(hard_loss(hard, paths, values))
            phases.append(_outcome(solution, width, loss, values))
            if loss < best_loss:
                best_loss, best, chosen = loss, values, number
    flat = [name for name, slope in zip(names, slopes, strict=True) if slope == 0]
    return FitResult(
        technique=with_values(hard.technique, paths, best),
        initial=dict(zip(names, initial.tolist(), strict=True)),
        fitted=dict(zip(names, best.tolist(), strict=True)),
        phases=phases,
        chosen=chosen,
        history=history,
        flat=flat,
        seconds_compiling=seconds_compiling,
        seconds_running=time.perf_counter() - started,
    )


class _Solution(NamedTuple):
    """The end of a phase, as arrays."""

    value: Float[Array, " p"]
    gradient: Float[Array, " p"]
    first_gradient: Float[Array, " p"]
    steps: Array
    result: optx.RESULTS


def _phase(problem: Joint, names: tuple[str, ...], bounds: Bounds, y: Array, solver: Solver, token: Array) -> _Solution:
    def residual(y: Array, args: tuple[Joint, Bounds]) -> tuple[Array, ...]:
        problem, bounds = args
        return residual_at(problem, names, bounds, y)

    args = (problem, bounds)
    # Least squares want a Jacobian, minimisers a gradient; with few parameters and many pixels both go forward.
    options = {"jac": "fwd"} if solver.name in ("levenberg_marquardt", "dogleg") else {"autodiff_mode": "fwd"}
    solution = optx.least_squares(
        residual, _optimistix(solver, token), y, args, options, max_steps=solver.max_steps, throw=False
    )

    # The gradient per unit of each parameter's share of its bounds: comparable, and free of the reparametrisation.
    def gradient(y: Array) -> Array:
        share = (bounds.to_bounded(y) - bounds.lower) / (bounds.upper - bounds.lower)
        at = lambda share: bounds.lower + share * (bounds.upper - bounds.lower)
        loss = lambda share: problem.mean_square_error(with_values(problem.technique, names, at(share)))
        return jax.jacfwd(loss)(share)

    return _Solution(
        solution.value, gradient(solution.value), gradient(y), solution.stats["num_steps"], solution.result
    )


_run_phase: Any = eqx.filter_jit(_phase)
_hard_loss: Any = eqx.filter_jit(
    lambda problem, names, values: problem.mean_square_error(with_values(problem.technique, names, values))
)


def _compile(*args):
    return _run_phase.lower(*args).compile()


def _optimistix(solver: Solver, token: Array) -> optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser:
    report = Report(token)
    tolerances = {"rtol": solver.rtol, "atol": solver.atol, "verbose": report}
    match solver.name:
        case "levenberg_marquardt":
            return optx.LevenbergMarquardt(**tolerances, linear_solver=lx.QR())
        case "dogleg":
            # It solves undamped: a parameter without a gradient must not spoil the others' steps.
            return optx.Dogleg(**tolerances, linear_solver=lx.SVD(rcond=_LEAST_SINGULAR))
        case "bfgs":
            return optx.BFGS(**tolerances)
        case "lbfgs":
            return optx.LBFGS(**tolerances)


def _hard(technique: ShadowMapping) -> HardCompare:
    return technique.compare if isinstance(technique.compare, HardCompare) else HardCompare()


def _outcome(solution: _Solution, width: float, hard_loss: float, values: Array) -> Outcome:
    if solution.result == optx.RESULTS.successful:
        result = "successful"
    elif solution.result == optx.RESULTS.nonlinear_max_steps_reached:
        result = "max_steps reached"
    else:
        result = optx.RESULTS[solution.result]
    gradient_norm = float(jnp.linalg.norm(solution.gradient))
    if not np.isfinite(gradient_norm):
        result = "the loss is not finite near the solution"
    return Outcome(width, int(solution.steps), result, gradient_norm, hard_loss, tuple(values.tolist()))
