"""Converts solvers to optimistix's solvers."""

from collections.abc import Callable
from typing import Any

import lineax as lx
import optimistix as optx

from ._adam import Adam
from ._levenberg_marquardt import LevenbergMarquardt
from ._settings import Solver, Stop

# Singular values of the Jacobian below this fraction of the largest count as zero, at the precision of float32.
_MIN_SINGULAR = 1e-6


def optimistix_solver(
    solver: Solver, report: Callable[..., None], stop: Stop
) -> optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser:
    """The solver of optimistix. It calls `report` at every step, unless it is a user's solver."""
    if solver.method is not None:
        return solver.method
    tolerances = {"rtol": solver.rtol, "atol": solver.atol, "verbose": report}
    match solver.name:
        case "levenberg_marquardt":
            return LevenbergMarquardt(**tolerances, noise=solver.noise or 0.0, stop=stop)
        case "dogleg":
            # It solves without damping, and a parameter without a gradient must not spoil the others' steps.
            return optx.Dogleg(**tolerances, linear_solver=lx.SVD(rcond=_MIN_SINGULAR))
        case "bfgs":
            return optx.BFGS(**tolerances)
        case "lbfgs":
            return optx.LBFGS(**tolerances)
        case "adam":
            return Adam(solver.learning_rate, solver.max_steps, solver.rtol, solver.atol, report)


def optimistix_options(solver: Solver) -> dict[str, Any]:
    """The options for `optimistix.least_squares`, for forward mode."""
    return {"jac": "fwd"} if solver.is_least_squares else {"autodiff_mode": "fwd"}
