"""The phases of a fit.

The hard compare has no gradient with respect to bias, so the fit of a technique runs under a soft compare whose width
shrinks geometrically from phase to phase. Where lights or meshes move, phases go from coarse images and maps to fine
ones under the hard compare, since silhouettes have derivatives whatever the compare; only a bias that is fitted as well
needs the soft one, at the end. The last phase is repeated under less blur, which is more accurate but sees less far.

The error has no useful derivative with respect to numbers that lay out the map, such as the spacing of cascades. They
are found by a search under the hard compare. It goes over all parameters, since the best layout depends on the others
and these on it. The others are then fitted by gradient. A shorter search for the layout alone follows, about the
result, and the last phase once more.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxtyping import Array, Float

from .._misc import as_float
from ..shadow import SoftCompare
from ._anneal import Anneal
from ._arrangement import is_of_technique
from ._parameters import Parameters
from .problems import AbstractProblem, Joint, PoseProblem, levels_of

# Numbers of a technique whose gradient does not need a soft compare.
_GEOMETRIC = ("radius", "light_size", "min_radius")
# The part of the bounds in which the second search looks.
_REFINED = 0.25

_ALL = 1 << 62


class Phase(NamedTuple):
    """A part of a fit.

    - `joint`: the problems at its resolution and with its compare.
    - `active`: the indices of the parameters that it changes.
    - `width`: of its soft compare in texels; 0 for the hard one.
    - `level`: the downsampling factor: each coarse pixel averages `level` × `level` pixels.
    - `searched`: the part of the bounds that it searches, about the values so far; 0 for a phase by gradient.
    - `pixels`: the most of them that a step of a fit of a technique evaluates.
    """

    joint: Joint
    active: tuple[int, ...]
    width: float
    level: int = 1
    searched: float = 0.0
    pixels: int = _ALL

    @property
    def program(self) -> tuple[object, ...]:
        """What identifies its compiled program among those of the fit."""
        return self.level, self.active, self.width > 0, self.pixels

    @property
    def blurs(self) -> tuple[float, ...]:
        """The standard deviation, in its pixels, of the blur under which it compares each problem's images."""
        return tuple(problem.blur_in_pixels for problem in self.joint.problems)


def phases_of(
    joint: Joint, paths: Sequence[str], anneal: Anneal, levels: Sequence[int] | None, pixels: int
) -> list[Phase]:
    """The phases of a fit of the numbers at `paths`, whose steps evaluate about `pixels` of them at most.

    **Raises** `ValueError` if the levels do not suit the problems, or a number lays out maps while lights or meshes
    move.
    """
    searched = tuple(i for i, path in enumerate(paths) if joint.searched(path))
    smooth = tuple(i for i in range(len(paths)) if i not in searched)
    annealed = []
    for number, width in enumerate(anneal.widths):
        part = (number + 1) / len(anneal.widths)
        soft = joint.with_compare(SoftCompare(width, anneal.kernel)).with_loss(joint.loss.in_phase(part))
        annealed.append(Phase(soft, smooth, width, pixels=pixels))
    if joint.moves:
        if searched:
            raise ValueError(
                f"{paths[searched[0]]} is found by a search, and lights or meshes move; expected a fit of one or the "
                "other: leave it out, or fit it first"
            )
        return _phases_of_poses(joint, paths, annealed, levels)
    if levels is not None:
        raise ValueError("got levels, but no light or mesh moves; expected none: they are for fits of poses")
    if not searched:
        return annealed
    search = Phase(joint.hard(), tuple(range(len(paths))), 0.0, searched=1.0)
    again = search._replace(active=searched, searched=_REFINED)
    return [search, *annealed, again, annealed[-1]] if smooth else [search]


def _phases_of_poses(
    joint: Joint, paths: Sequence[str], annealed: list[Phase], levels: Sequence[int] | None
) -> list[Phase]:
    poses = tuple(i for i, path in enumerate(paths) if not is_of_technique(path))
    problems: tuple[Any, ...] = joint.problems
    factors = levels_of(levels, *(side for problem in problems for side in problem.sides))
    blurred = lambda joint: _sharpened(joint, lambda _: 1.0)
    hard = blurred(joint).hard()
    coarse = [Phase(hard.each(lambda p, n=n: p.at_level(n)), poses, 0.0, n) for n in factors[:-1] if poses]
    if any(is_of_technique(path) and path.rpartition(".")[2] not in _GEOMETRIC for path in paths):
        fine = [phase._replace(joint=blurred(phase.joint)) for phase in annealed]
    else:
        fine = [Phase(hard, tuple(range(len(paths))), 0.0)]
    # By the same program.
    return [*coarse, *fine, fine[-1]._replace(joint=_sharpened(fine[-1].joint, lambda p: p.sharpest))]


def _sharpened(joint: Joint, sharpness: Callable[[PoseProblem], float]) -> Joint:
    return joint.each(lambda p: dataclasses.replace(p, sharpness=as_float(sharpness(p))))


def enlarged(joint: Joint, parameters: Parameters, values: Float[Array, "k p"]) -> Joint:
    """With memory for several times the silhouettes at each row of `values` (k, p)."""

    def grown(problem: PoseProblem) -> AbstractProblem:
        for there in values:
            moved = dataclasses.replace(problem, arrangement=parameters.put(problem.arrangement, there))
            problem = dataclasses.replace(moved.planned(), arrangement=problem.arrangement)
        return problem

    return joint.each(grown)
