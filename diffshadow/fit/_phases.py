"""The phases that a fit runs through."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._misc import as_float
from ..shadow import HardCompare, SoftCompare
from ._arrangement import is_of_technique
from ._parameters import Bounds, with_values
from ._poses import PoseProblem
from ._residuals import Joint
from ._settings import Anneal, levels_of
from ._starts import starts_within

# At so many places within the bounds a fit of poses looks how much room drawing takes.
_PLACES = 16
# Of a technique's numbers, those whose gradient does not depend on the compare being soft.
_GEOMETRIC = ("radius", "light_size", "min_radius")


class Phase(NamedTuple):
    """A part of a fit.

    - `joint`: the problems as it sees them, with its compare.
    - `active`: the indices of the parameters that it changes.
    - `width`: of its soft compare in texels; 0 for the hard one.
    - `level`: how many pixels a side make one.
    """

    joint: Joint
    active: tuple[int, ...]
    width: float
    level: int = 1

    @property
    def program(self) -> tuple[object, ...]:
        """What tells its compiled program from those of other phases."""
        return self.level, self.active, self.width > 0

    @property
    def blurs(self) -> tuple[float, ...]:
        """The standard deviation, in its pixels, of the blur under which it compares each problem's images."""
        return tuple(float(p.blur / p.sharpness) if isinstance(p, PoseProblem) else 0.0 for p in self.joint.problems)


def hard(joint: Joint) -> Joint:
    """With the hard compare."""
    compare = joint.technique.compare
    return joint.compared_by(compare if isinstance(compare, HardCompare) else HardCompare())


def phases_of(joint: Joint, paths: Sequence[str], anneal: Anneal, levels: Sequence[int] | None) -> list[Phase]:
    """The phases of a fit of the numbers at `paths`.

    **Raises** `ValueError` if the levels do not suit the problems.
    """
    every = tuple(range(len(paths)))
    soft = lambda width: joint.compared_by(SoftCompare(width, anneal.kernel))
    if not joint.moves:
        if levels is not None:
            raise ValueError("got levels, and nothing moves; expected none: they are for fits of poses")
        return [Phase(soft(width), every, width) for width in anneal.widths]
    joint = _sharpened(joint, lambda _: 1.0)
    sides = [side for p in joint.problems if isinstance(p, PoseProblem) for side in p.sides]
    poses = tuple(i for i in every if not is_of_technique(paths[i]))
    chosen = levels_of(levels, *sides)
    coarse = [Phase(hard(joint).each(lambda p, n=n: p.at_level(n)), poses, 0.0, n) for n in chosen[:-1] if poses]
    if any(is_of_technique(path) and path.rpartition(".")[2] not in _GEOMETRIC for path in paths):
        fine = [Phase(soft(width), every, width) for width in anneal.widths]
    else:
        fine = [Phase(hard(joint), every, 0.0)]
    # By the same program.
    return [*coarse, *fine, fine[-1]._replace(joint=_sharpened(fine[-1].joint, lambda p: p.sharpest))]


def _sharpened(joint: Joint, sharpness: Callable[[PoseProblem], float]) -> Joint:
    return joint.each(lambda p: dataclasses.replace(p, sharpness=as_float(sharpness(p))))


def prepared(joint: Joint, paths: Sequence[str], bounds: Bounds, initial: Float[Array, " p"]) -> Joint:
    """With room to draw at the initial values, at both ends of the bounds, and at a Sobol sequence between."""
    if not joint.moves:
        return joint
    spread = starts_within(bounds, initial, _PLACES, seed=0)
    return joint.each(lambda p: p.planned(paths, jnp.concatenate([spread, bounds.lower[None], bounds.upper[None]])))


def enlarged(joint: Joint, paths: Sequence[str], values: Float[Array, "k p"]) -> Joint:
    """With capacity for the arrangements that have `values` (k, p) at `paths`, and as much again."""

    def grown(problem: PoseProblem) -> PoseProblem:
        for there in values:
            arrangement = with_values(problem.arrangement, paths, there)
            moved = dataclasses.replace(problem, arrangement=arrangement).planned(paths, there[None])
            problem = dataclasses.replace(moved, arrangement=problem.arrangement)
        return problem

    return joint.each(grown)
