"""Which solver runs, and when it ends."""

import dataclasses
from typing import ClassVar, NamedTuple

from jaxtyping import Array

from ..._checks import check_settings
from ...settings.fit import Solver as Settings
from ...settings.fit import SolverName

# Fraction of the loss.
_NOISE_OF_POSES = 0.25
_LEAST_SQUARES = ("levenberg_marquardt", "dogleg")


@dataclasses.dataclass(frozen=True)
class Solver:
    """Which optimistix solver runs, and when a phase ends.

    - `name`: `"levenberg_marquardt"`, `"dogleg"`, `"bfgs"`, `"lbfgs"` or `"adam"`.
    - `max_steps`: of each phase.
    - `rtol`, `atol`: a phase ends when both parameters and loss change by less. Levenberg-Marquardt also ends where,
        after a step that did not help, the next would change all parameters by less.
    - `learning_rate`: of Adam: the length of its first steps, where the distance between the bounds is pi.
    - `noise`: fraction of the loss by which it jumps as parameters change a little. Levenberg-Marquardt accepts steps
        within it, and of phases whose ends differ by less, the last is the result. Left out, it is 0 for a technique
        and 0.25 where lights or meshes move, since pixels then jump from lit to shadowed and back.

    **Raises** `ValueError` for a value that is not allowed.
    """

    settings: ClassVar = Settings

    name: SolverName = Settings.type
    max_steps: int = Settings.max_steps
    rtol: float = Settings.rtol
    atol: float = Settings.atol
    learning_rate: float = Settings.learning_rate
    noise: float | None = Settings.noise

    def __post_init__(self):
        check_settings(self)

    @property
    def is_least_squares(self) -> bool:
        """Whether it uses the residuals' Jacobian, rather than the loss' gradient."""
        return self.name in _LEAST_SQUARES

    def for_problem(self, moves: bool) -> "Solver":
        """With the noise of a problem in which lights or meshes move, or do not."""
        return self if self.noise is not None else dataclasses.replace(self, noise=_NOISE_OF_POSES if moves else 0.0)


class Stop(NamedTuple):
    """Where Levenberg-Marquardt ends, besides its tolerances. Other solvers do not use it.

    - `shortest`: the length of a step, in free values, at which it ends after a step that did not help.
    - `least_gain`: it ends where the sum of squares would fall by less than this fraction if residuals were linear.
    """

    shortest: Array | float = 0.0
    least_gain: Array | float = 0.0
