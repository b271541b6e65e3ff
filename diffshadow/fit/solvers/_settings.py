"""The choice of a solver, and its end."""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import optimistix as optx
from jaxtyping import Array

from ..._checks import CheckedModule, check_instance
from ...settings.fit import Solver as Settings
from ...settings.fit import SolverName

OptimistixSolver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser
"""Any least-squares solver or minimiser of optimistix, or a user's own."""

# A fraction of the loss.
_NOISE_OF_POSES = 0.25
_MIN_SQUARES = ("levenberg_marquardt", "dogleg")
_OF_OPTIMISTIX = "a least-squares solver or minimiser of optimistix, such as optimistix.BFGS(1e-4, 1e-6)"
_EXPECTED = f'a fit.Solver, such as Solver("adam"), or {_OF_OPTIMISTIX}'


class Solver(CheckedModule):
    """The solver of a fit, and the end of its phases.

    - `name`: `"levenberg_marquardt"`, `"dogleg"`, `"bfgs"`, `"lbfgs"` or `"adam"`.
    - `max_steps`: the maximum number of steps of each phase.
    - `rtol`, `atol`: a phase ends when both parameters and loss change by less than these tolerances.
        Levenberg-Marquardt also ends after a step that did not help, if the next step would change all parameters by
        less.
    - `learning_rate`: the length of Adam's first steps, if the distance between the bounds is pi.
    - `noise`: the fraction by which the loss jumps if parameters change a little. Levenberg-Marquardt accepts steps
      that raise the loss by less than the noise. If the losses at the ends of phases differ by less than the noise, the
      last phase is the result. By default, it is 0 for a technique, and 0.25 if lights or meshes move, because pixels
      then jump between lit and shadowed.
    - `method`: any least-squares solver or minimiser of optimistix, instead of the solver `name`. Such a method
        has its own tolerances. Only the fields `max_steps` and `noise` apply to it, and `noise` only affects the choice
        between phases.

    !!! Example

        ```python
        adam = fit.Solver("adam", max_steps=60, learning_rate=0.1)
        own = fit.Solver(method=optimistix.Dogleg(rtol=1e-4, atol=1e-6), max_steps=20)
        ```
    """

    settings: ClassVar = Settings

    name: SolverName = eqx.field(static=True, default=Settings.type)
    max_steps: int = eqx.field(static=True, default=Settings.max_steps)
    rtol: float = eqx.field(static=True, default=Settings.rtol)
    atol: float = eqx.field(static=True, default=Settings.atol)
    learning_rate: float = eqx.field(static=True, default=Settings.learning_rate)
    noise: float | None = eqx.field(static=True, default=Settings.noise)
    method: OptimistixSolver | None = None

    @classmethod
    def of(cls, solver: Any) -> "Solver":
        """Returns a `Solver` unchanged. Wraps a solver of optimistix with the default number of steps. Returns the
        default for `None`.

        **Raises** `TypeError` for any other object.
        """
        if solver is None:
            return cls()
        if isinstance(solver, OptimistixSolver):
            return cls(method=solver)
        check_instance("the solver", solver, cls, _EXPECTED)
        return solver

    def _check_rules(self) -> None:
        if self.method is not None:
            check_instance("the method of the solver", self.method, OptimistixSolver, _OF_OPTIMISTIX)

    @property
    def is_least_squares(self) -> bool:
        """Whether it uses the residuals' Jacobian instead of the loss' gradient."""
        if self.method is not None:
            return isinstance(self.method, optx.AbstractLeastSquaresSolver)
        return self.name in _MIN_SQUARES

    @property
    def title(self) -> str:
        """Its name in messages."""
        return self.name if self.method is None else f"optimistix' {type(self.method).__name__}"

    def for_problem(self, moves: bool) -> "Solver":
        """The solver with the default noise, which depends on whether lights or meshes move."""
        return self if self.noise is not None else dataclasses.replace(self, noise=_NOISE_OF_POSES if moves else 0.0)


class Stop(NamedTuple):
    """Additional conditions for the end of Levenberg-Marquardt. Other solvers do not use them.

    - `shortest`: the length of a step, in free values, at which it ends after a step that did not help.
    - `least_gain`: it ends if the sum of squares would fall by less than this fraction for linear residuals.
    """

    shortest: Array | float = 0.0
    least_gain: Array | float = 0.0
