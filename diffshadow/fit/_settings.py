"""How a fit runs: its solver, and how its soft compare hardens."""

import itertools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from ..shadow import SoftKernel

SolverName = Literal["levenberg_marquardt", "dogleg", "bfgs", "lbfgs", "adam"]
_SOLVERS = ("levenberg_marquardt", "dogleg", "bfgs", "lbfgs", "adam")
LEVELS = (8, 4, 2)
"""How many pixels a side make one in the first phase of a fit of poses: the first of these that suits."""
_LEAST_SIDE = 16


class Solver(NamedTuple):
    """Which optimistix solver runs, and when a phase ends.

    - `name`: `"levenberg_marquardt"`, `"dogleg"`, `"bfgs"`, `"lbfgs"` or `"adam"`.
    - `max_steps`: of each phase.
    - `rtol`, `atol`: a phase ends when both parameters and loss change by less. Levenberg-Marquardt also ends where,
        after a step that did not help, the next would change all parameters by less.
    - `learning_rate`: of Adam alone: how far its first steps go, where the whole way between the bounds is pi.
    """

    name: SolverName = "levenberg_marquardt"
    max_steps: int = 30
    rtol: float = 1e-4
    atol: float = 1e-6
    learning_rate: float = 0.05


class Anneal(NamedTuple):
    """How the soft compare hardens: `phases` widths from `start` to `end` texels, in geometric steps.

    A single phase has the width `end`.
    """

    start: float = 2.0
    end: float = 0.05
    phases: int = 4
    kernel: SoftKernel = "logistic"

    @property
    def widths(self) -> list[float]:
        """The width of each phase, in texels."""
        # Downwards from the end, so that a single width is the end's.
        return [float(w) for w in np.geomspace(self.end, self.start, self.phases)[::-1]]


def check_solver(solver: Solver) -> None:
    """**Raises** `ValueError` unless `solver` is known and its numbers make sense."""
    if solver.name not in _SOLVERS:
        raise ValueError(f"the solver is {solver.name!r}; expected one of {', '.join(_SOLVERS)}")
    if solver.max_steps < 1:
        raise ValueError(f"the solver's max_steps is {solver.max_steps}; expected 1 or more")
    for name in ("rtol", "atol", "learning_rate"):
        value = getattr(solver, name)
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"the solver's {name} is {value}; expected a finite number above 0, such as 1e-4")


def check_anneal(anneal: Anneal) -> None:
    """**Raises** `ValueError` unless the widths are positive and shrink, in at least one phase."""
    if anneal.phases < 1:
        raise ValueError(f"the anneal has {anneal.phases} phases; expected 1 or more")
    for name, value in (("start", anneal.start), ("end", anneal.end)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(
                f"the anneal's {name} is {value} texels; expected a finite width above 0: a fit ends with the hard "
                "compare in any case"
            )
    if anneal.end > anneal.start:
        raise ValueError(
            f"the anneal widens from {anneal.start} to {anneal.end} texels; expected end at most start: swap the two"
        )


def levels_of(levels: Sequence[int] | None, *sides: int) -> tuple[int, ...]:
    """The levels of a fit of poses: `levels`, or a coarse one that suits images and maps of these `sides`, and 1.

    **Raises** `ValueError` unless they fall, end with 1, and divide all sides.
    """
    if levels is None:
        # Two, for each is a program to compile.
        suits = lambda level: all(side % level == 0 and side // level >= _LEAST_SIDE for side in sides)
        return (*[level for level in LEVELS if suits(level)][:1], 1)
    levels = tuple(levels)
    if not levels or levels[-1] != 1 or any(a <= b for a, b in itertools.pairwise(levels)):
        raise ValueError(f"the levels are {list(levels)}; expected whole numbers that fall to 1, such as [8, 1]")
    for level in levels:
        bad = [side for side in sides if side % level]
        if bad:
            raise ValueError(
                f"level {level} makes one pixel of {level} x {level}, and image or map has a side of {bad[0]}; "
                "expected levels that divide all sides: leave it out, or change the resolution"
            )
    return levels
