"""The phases of a fit: a sequence of solves and searches; each starts where the last one ended.

All values are an array (p,), one for each parameter. A phase changes only its active parameters, and minimises the loss
of a joint problem. It has one width of the soft compare, in texels (0 for the hard compare), and one blur for each
problem's images, in pixels.

The hard compare has no gradient with respect to bias, so the fit of a technique runs under a soft compare whose width
shrinks geometrically from phase to phase. If lights or meshes move, phases run under the hard compare, because
silhouettes have derivatives under any compare. Only a fitted bias needs the soft compare, at the end. These phases
compare images under a shrinking blur: a wide blur has a larger range, and a narrow blur is more accurate.

The error has no useful derivative with respect to numbers that lay out the map, such as the spacing of cascades. A
search under the hard compare finds these numbers. It covers all parameters, because the best layout depends on the
other parameters and they depend on the layout. The others are then fitted by gradient. A shorter search for the layout
alone follows around the result, and then the last phase is repeated.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ..shadow import SoftCompare
from ._anneal import Anneal
from ._arrangement import is_of_technique
from ._parameters import Parameters
from .problems import ArrangedProblem, Joint, blurs_of
from .solvers import Stop

# Numbers of a technique whose gradient does not need a soft compare.
_GEOMETRIC = ("radius", "light_size", "min_radius")
# The fraction of the bounds for the second search.
_REFINED = 0.25

# A shorter step of the first phases changes a value by less than a two-hundredth of its bounds' distance, which has no
# effect under their blur.
_ROUGHLY = 0.01

_ALL = 1 << 62


class Phase(NamedTuple):
    """A part of a fit.

    - `joint`: the problems at its resolution and with its compare.
    - `active`: the indices of the parameters that it changes.
    - `width`: width of its soft compare in texels; 0 for the hard compare.
    - `shared`: whether all starts run the phase, or only the best start.
    - `stop`: additional conditions for the end of its solver.
    - `searched`: the fraction of the bounds that it searches around the current values; 0 for a phase by gradient.
    - `pixels`: the maximum number of pixels in a step, in a fit of a technique.
    """

    joint: Joint
    active: tuple[int, ...]
    width: float
    shared: bool = True
    stop: Stop = Stop()
    searched: float = 0.0
    pixels: int = _ALL

    @property
    def program(self) -> tuple[object, ...]:
        """The key of its compiled program among all programs of the fit."""
        return self.active, self.width > 0, self.pixels

    @property
    def blurs(self) -> tuple[float, ...]:
        """The standard deviation of each image's blur, in pixels."""
        each = self.joint.problems
        return tuple(problem.blur_in_pixels for problem in each for _ in range(np.size(problem.count)))

    def with_memory_of(self, joint: Joint) -> "Phase":
        """This phase, with memory for as many silhouettes as in the problems of `joint`."""
        grown = tuple(own.with_memory_of(like) for own, like in zip(self.joint.problems, joint.problems, strict=True))
        return self._replace(joint=dataclasses.replace(self.joint, problems=grown))


def phases_of(
    joint: Joint, paths: Sequence[str], anneal: Anneal, blurs: Sequence[float] | None, pixels: int
) -> list[Phase]:
    """The phases of a fit of the numbers at `paths`. Their steps evaluate at most about `pixels` pixels.

    **Raises** `ValueError` if the blurs do not suit the problems, or if a number lays out maps while lights or meshes
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
        return _phases_of_poses(joint, paths, annealed, blurs)
    if blurs is not None:
        raise ValueError("got blurs, but no light or mesh moves; expected none: they are for fits of poses")
    if not searched:
        return annealed
    search = Phase(joint.hard(), tuple(range(len(paths))), 0.0, searched=1.0)
    again = search._replace(active=searched, searched=_REFINED)
    return [search, *annealed, again, annealed[-1]] if smooth else [search]


def _phases_of_poses(
    joint: Joint, paths: Sequence[str], annealed: list[Phase], blurs: Sequence[float] | None
) -> list[Phase]:
    poses = tuple(i for i, path in enumerate(paths) if not is_of_technique(path))
    *wide, narrow = blurs_of(blurs, *(side for problem in joint.problems for side in problem.shape))
    first = [Phase(_blurred(joint.hard(), blur), poses, 0.0, stop=Stop(shortest=_ROUGHLY)) for blur in wide if poses]
    if any(is_of_technique(path) and path.rpartition(".")[2] not in _GEOMETRIC for path in paths):
        last = annealed
    else:
        last = [Phase(joint.hard(), tuple(range(len(paths))), 0.0)]
    # Without first phases, there is no basis for a choice between several starts.
    last = [phase._replace(joint=_blurred(phase.joint, narrow), shared=not first) for phase in last]
    return [*first, *last, last[-1]._replace(joint=last[-1].joint.each(lambda p: p.sharpest))]


def _blurred(joint: Joint, blur: float) -> Joint:
    return joint.each(lambda problem: dataclasses.replace(problem, blur=blur))


def enlarged(joint: Joint, parameters: Parameters, values: Float[Array, "k p"]) -> Joint:
    """The phases, with memory for several times the silhouettes at each row of `values` (k, p)."""

    def grown(problem: ArrangedProblem) -> ArrangedProblem:
        for there in values:
            moved = dataclasses.replace(problem, arrangement=parameters.put(problem.arrangement, there))
            planned: Any = moved.planned()
            problem = dataclasses.replace(planned, arrangement=problem.arrangement)
        return problem

    return joint.each(grown)
