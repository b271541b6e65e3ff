"""Fits of many numbers to many views.

With many numbers, the residuals of all views do not fit into memory. The views are therefore scanned. An orthogonal
transformation compresses the residuals and the Jacobian of each view to as many rows as there are numbers. It preserves
sums of squares (sequential least squares; Lawson & Hanson, "Solving Least Squares Problems", chapter 27).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._arithmetic import as_float
from .._memory import limit_programs
from .._progress import showing
from .._types import Scalar
from ..shadow import FittableTechnique, HardCompare, SoftCompare
from ._anneal import Anneal
from .problems import TechniqueProblem, of_one_structure, together
from .solvers import OptimistixSolver, Solver, Stop, optimistix_options, optimistix_solver

Where = Callable[[Any], Any]
# A number with a lower bound starts at least this far above the bound.
_INSET = 1e-3


class TrainingPhase(NamedTuple):
    """The end of a phase of training.

    - `width`: width of its soft compare, in texels; `steps`: steps of the solver.
    - `loss`: the mean square error under the soft compare; `hard_loss`: under the hard compare.
    """

    width: float
    steps: int
    loss: float
    hard_loss: float


class Training(NamedTuple):
    """The result of training.

    - `technique`: the trained technique, with the hard compare.
    - `initial_loss`, `loss`: its mean square error over all views under the hard compare, before and after.
    - `phases`: the result of each phase; `chosen`: the phase that ended best, -1 if the start was best.
    """

    technique: FittableTechnique
    initial_loss: float
    loss: float
    phases: list[TrainingPhase]
    chosen: int


def train(
    problems: Sequence[TechniqueProblem],
    where: Where,
    *,
    lower: Any = -np.inf,
    solver: Solver | OptimistixSolver | None = None,
    anneal: Anneal | None = None,
    on_phase: Callable[[TrainingPhase], None] | None = None,
) -> Training:
    """Fits all numbers in a part of a technique, such as a network's weights, to several views.

    It minimises the mean square error over all pixels that count, under a soft compare that hardens from phase to
    phase. The hard compare judges the start and the end of each phase, and the best is the result. Views whose arrays
    have equal shapes share a compiled loop. Only the derivatives of one view at a time are in memory.

    **Arguments:**

    - `problems`: views. Training starts from the technique of the first view.
    - `where`: a function of a technique that returns the trained part: one module or several. All of their
        floating-point arrays are trained. Calls with the same function share their compiled programs.
    - `lower`: the minimum of the trained numbers, or minus infinity for no limit. A number, or a tree of numbers with
        the structure of the result of `where` or of its upper part.
    - `solver`, `anneal`: the solver and the annealing of the compare. Levenberg-Marquardt and dogleg compute a
      derivative for each number and pixel, which is suitable for some tens of numbers. The other solvers compute the
      loss' gradient in reverse mode.
    - `on_phase`: called after each phase. Without it, `diffshadow.setup` decides whether a line shows the steps.

    **Raises** `ValueError` if there is no view, if no pixel of a view counts, if nothing is selected, or if a number
    starts below its minimum.
    """
    limit_programs()
    solver, anneal = Solver.of(solver).for_problem(False), anneal or Anneal()
    if not problems:
        raise ValueError("got no view to train on; expected one or more problems")
    technique = _with_compare(problems[0].technique, HardCompare())
    start, _ = ravel_pytree(_selected(technique, where))
    if not start.size:
        raise ValueError("where selects no number of the technique; expected numbers: select a module that has numbers")
    least = _least(lower, _selected(technique, where))
    if (np.asarray(start) < least).any():
        raise ValueError(
            "a number starts below its lower bound; expected no number below it: raise the number, or lower the bound"
        )
    groups = _stacked([_plain(problem, technique) for problem in problems])
    if not _count(groups) > 0:
        raise ValueError("no pixel of any view counts; expected cameras and lights to see the same part of the scene")
    values, losses, phases = [start], [float(_loss(groups, technique, start, where))], []
    with showing("training", unless=on_phase is not None) as update:
        for number, width in enumerate(anneal.widths):
            if update is not None:
                state = f"phase {number + 1} of {anneal.phases}, RMSE {losses[-1] ** 0.5:.5f}"
                update(state, number / anneal.phases)
            soft = _with_compare(technique, SoftCompare(width, anneal.kernel))
            found, loss, steps = _phase(groups, soft, values[-1], as_float(least), where, solver)
            values.append(found if np.isfinite(found).all() else values[-1])
            losses.append(float(_loss(groups, technique, values[-1], where)))
            phases.append(TrainingPhase(width, int(steps), float(loss), losses[-1]))
            if on_phase is not None:
                on_phase(phases[-1])
    best = int(np.nanargmin(losses))
    return Training(_put(technique, where, values[best]), losses[0], losses[best], phases, best - 1)


def mean_square_error(problems: Sequence[TechniqueProblem], technique: FittableTechnique) -> float:
    """The mean square error of a technique over all counted pixels of several views, by one compiled program."""
    groups = _stacked([_plain(problem, technique) for problem in problems])
    return float(_loss(groups, technique, jnp.zeros(0), _nothing))


Groups = list[TechniqueProblem]
"""Views with arrays of equal shapes, stacked along their first axis."""


def _nothing(technique: Any) -> tuple[()]:
    return ()


def _selected(technique: Any, where: Where) -> Any:
    return eqx.filter(where(technique), eqx.is_inexact_array)


def _put(technique: Any, where: Where, values: Float[Array, " p"]) -> Any:
    """`technique` with `values` (p,) instead of the part that `where` selects."""
    selected, rest = eqx.partition(where(technique), eqx.is_inexact_array)
    _, unravel = ravel_pytree(selected)
    return eqx.tree_at(where, technique, eqx.combine(unravel(values), rest)) if values.size else technique


def _least(lower: Any, selected: Any) -> Float[np.ndarray, " p"]:
    """The minimum of each number (p,)."""
    spread = jax.tree.map(lambda least, part: jax.tree.map(lambda x: np.full(x.shape, least), part), lower, selected)
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(spread)])


def _with_compare(technique: Any, compare: Any) -> Any:
    if isinstance(compare, HardCompare) and isinstance(technique.compare, HardCompare):
        return technique
    return eqx.tree_at(lambda t: t.compare, technique, compare)


def _plain(problem: TechniqueProblem, technique: Any) -> TechniqueProblem:
    """`problem` without its scene, and with the technique that all views share."""
    return TechniqueProblem(technique, problem.shadow_map, problem.surface, problem.reference, problem.mask)


def _stacked(problems: Sequence[TechniqueProblem]) -> Groups:
    return [together(group) for group in of_one_structure(problems)]


def _count(groups: Groups) -> Scalar:
    return sum((jnp.sum(group.mask) for group in groups), start=jnp.zeros(()))


@eqx.filter_jit
def _loss(groups: Groups, technique: Any, values: Float[Array, " p"], where: Where) -> Scalar:
    """The mean square error over all views."""
    technique = _put(technique, where, values)

    # Reverse mode draws each view again, so that only one view's intermediate values are in memory.
    @jax.checkpoint
    def add(total: Scalar, problem: TechniqueProblem) -> tuple[Scalar, None]:
        return total + jnp.sum(problem.difference(technique) ** 2), None

    total = jnp.zeros(())
    for group in groups:
        total, _ = jax.lax.scan(add, total, group)
    return total / _count(groups)


@eqx.filter_jit
def _phase(
    groups: Groups, technique: Any, start: Float[Array, " p"], least: Float[Array, " p"], where: Where, solver: Solver
) -> tuple[Array, Array, Array]:
    """The values (p,) at the end of a phase, the loss there under the technique's compare, and the solver's steps."""
    bounded = lambda y: _bounded(y, least)

    def residual(y: Array, args: Any) -> Array:
        groups, technique = args
        fixed = jax.lax.stop_gradient(y)
        rows = _compressed(groups, lambda y: _put(technique, where, bounded(y)), fixed)
        return rows[:, -1] + jnp.matmul(rows[:, :-1], y - fixed, precision="highest")

    def loss(y: Array, args: Any) -> Array:
        groups, technique = args
        return _loss(groups, technique, bounded(y), where)

    quiet, start = (lambda **_: None), _free(start, least)
    method: Any = optimistix_solver(solver, quiet, Stop())
    views, until = (groups, technique), {"max_steps": solver.max_steps, "throw": False}
    if solver.is_least_squares:
        solution = optx.least_squares(residual, method, start, views, optimistix_options(solver), **until)
    else:
        # Reverse mode, because its cost does not depend on the number of parameters.
        solution = optx.minimise(loss, method, start, views, {"autodiff_mode": "bwd"}, **until)
    end = bounded(solution.value)
    return end, _loss(groups, technique, end, where), solution.stats["num_steps"]


def _bounded(y: Float[Array, " p"], least: Float[Array, " p"]) -> Float[Array, " p"]:
    """`least - 1 + sqrt(y² + 1)`, or `y` if there is no bound. Every `y` is valid, and the bound can be reached (James
    & Roos, "Minuit", Computer Physics Communications 10, 1975)."""
    # sqrt(y² + 1) - 1 without a difference, because rounding could move the difference below the bound.
    above = y * y / (jnp.sqrt(y * y + 1) + 1)
    return jnp.where(jnp.isfinite(least), least + above, y)


def _free(x: Float[Array, " p"], least: Float[Array, " p"]) -> Float[Array, " p"]:
    """The inverse of `_bounded`, for values moved off the bound, where it has no slope."""
    above = jnp.maximum(jnp.where(jnp.isfinite(least), x - least, 0), _INSET)
    return jnp.where(jnp.isfinite(least), jnp.sqrt(above * (above + 2)), x)


def _compressed(groups: Groups, of: Callable[[Array], Any], y: Float[Array, " p"]) -> Float[Array, "q q"]:
    """p + 1 rows with the same sums of squares and products as the Jacobian of all views with the residuals as its last
    column."""
    size = y.size + 1

    def add(rows: Array, problem: TechniqueProblem) -> tuple[Array, None]:
        difference = lambda y: problem.difference(of(y)).ravel()
        push = lambda way: jax.jvp(difference, (y,), (way,))
        value, columns = jax.vmap(push, out_axes=(None, 0))(jnp.eye(y.size, dtype=y.dtype))
        own = jnp.concatenate([columns, value[None]]).T
        return jnp.linalg.qr(jnp.concatenate([rows, own]), mode="r"), None

    rows = jnp.zeros((size, size), y.dtype)
    for group in groups:
        rows, _ = jax.lax.scan(add, rows, group)
    return rows / jnp.sqrt(_count(groups))
