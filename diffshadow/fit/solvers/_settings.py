"""Which solver runs, and when it ends."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Array

from ..._checks import check_choice

SolverName = Literal["levenberg_marquardt", "dogleg", "bfgs", "lbfgs", "adam"]
# Fraction of the loss.
_NOISE_OF_POSES = 0.25
_LEAST_SQUARES = ("levenberg_marquardt", "dogleg")


class Solver(NamedTuple):
    """Which optimistix solver runs, and when a phase ends.

    - `name`: `"levenberg_marquardt"`, `"dogleg"`, `"bfgs"`, `"lbfgs"` or `"adam"`.
    - `max_steps`: of each phase.
    - `rtol`, `atol`: a phase ends when both parameters and loss change by less. Levenberg-Marquardt also ends where,
        after a step that did not help, the next would change all parameters by less.
    - `learning_rate`: of Adam: the length of its first steps, where the distance between the bounds is pi.
    - `noise`: fraction of the loss by which it jumps as parameters change a little. Levenberg-Marquardt accepts steps
        within it, and of phases whose ends differ by less, the last is the result. Left out, it is 0 for a technique
        and 0.25 where lights or meshes move, since pixels then jump from lit to shadowed and back.
    """

    name: SolverName = "levenberg_marquardt"
    max_steps: int = 30
    rtol: float = 1e-4
    atol: float = 1e-6
    learning_rate: float = 0.05
    noise: float | None = None

    @property
    def is_least_squares(self) -> bool:
        """Whether it uses the residuals' Jacobian, rather than the loss' gradient."""
        return self.name in _LEAST_SQUARES

    def for_problem(self, moves: bool) -> "Solver":
        """With the noise of a problem in which lights or meshes move, or do not."""
        return self if self.noise is not None else self._replace(noise=_NOISE_OF_POSES if moves else 0.0)


class Stop(NamedTuple):
    """Where Levenberg-Marquardt ends, besides its tolerances. Other solvers do not use it.

    - `shortest`: the length of a step, in free values, at which it ends after a step that did not help.
    - `least_gain`: it ends where the sum of squares would fall by less than this fraction if residuals were linear.
    """

    shortest: Array | float = 0.0
    least_gain: Array | float = 0.0


def check_solver(solver: Solver) -> None:
    """**Raises** `ValueError` unless `solver` is known and its numbers make sense."""
    check_choice("the solver", solver.name, SolverName.__args__)
    if solver.max_steps < 1:
        raise ValueError(f"the solver's max_steps is {solver.max_steps}; expected 1 or more")
    if solver.noise is not None and not 0 <= solver.noise < 1:
        raise ValueError(f"the solver's noise is {solver.noise}; expected a fraction of the loss, from 0 to below 1")
    for name in ("rtol", "atol", "learning_rate"):
        value = getattr(solver, name)
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"the solver's {name} is {value}; expected a finite number above 0, such as 1e-4")
