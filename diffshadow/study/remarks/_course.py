"""How a fit went: whether its solver converged, and what its result owes to the solver."""

from collections.abc import Sequence

import numpy as np

from ...fit import FitResult, Outcome, PictureProblem

CUT_SHORT = "max_steps reached"
"""How a phase without further steps ends."""
STILL_FALLING = 0.25
"""A loss counts as still falling if it fell by more than this fraction in the last steps. Losses of poses change a
little at every step, as pixels switch between lit and shadowed."""
# Up to this one, the last phase of a fit of a technique counts as done: its error fell by no more than half as much.
_NEARLY_DONE = 0.01
# Of fewer evaluations of the loss, a decrease does not tell whether more would follow: solvers reject some first steps.
_FEW = 5
# Values of the solver within this part of the distance between the bounds from the start are the start.
_NO_MOVE = 1e-5


def what_is_fitted(result: FitResult) -> str:
    """What a fit compares, in words: an image of visibility, or a picture."""
    return "picture" if any(isinstance(problem, PictureProblem) for problem in result.problems) else "image"


def late_fall(losses: Sequence[float]) -> tuple[float, int] | None:
    """By which fraction a phase's loss fell in the last quarter of its steps, and the number of these steps; none if
    there are fewer than two steps."""
    if len(losses) < 2:
        return None
    late = max(len(losses) // 4, 1)
    # By minima, since the solver rejects some steps.
    early, least = min(losses[:-late]), min(losses)
    return (1 - least / early if early > 0 else 0.0), late


def is_nearly_done(result: FitResult, phase: int) -> bool:
    """Whether a phase converged, or ended at `max_steps` where its loss fell by little."""
    outcome = result.phases[phase]
    if outcome.result != CUT_SHORT:
        return outcome.result == "successful"
    fall = late_fall(losses_of(result, phase))
    # Losses of poses change a little at every step.
    least = _NEARLY_DONE if result.arrangement is None else STILL_FALLING
    return fall is not None and fall[0] <= least and len(losses_of(result, phase)) >= _FEW


def last_phase(result: FitResult) -> tuple[Outcome, int] | None:
    """The phase that gave the result, or the last phase if the start was better than all; none without phases."""
    if not result.phases:
        return None
    number = result.chosen if result.chosen >= 0 else len(result.phases) - 1
    return result.phases[number], number


def was_cut_short(result: FitResult) -> bool:
    """Whether `max_steps` ended the last phase before its loss settled, as far as the steps are known."""
    found = last_phase(result)
    if found is None or not losses_of(result, found[1]):
        return False
    return found[0].result == CUT_SHORT and not is_nearly_done(result, found[1])


def is_by_profiles(result: FitResult) -> bool:
    """Whether the solver left the start as it was, and profiles found a smaller error."""
    if not result.profiles or result.best == result.initial or not result.errors[1] < result.errors[0]:
        return False
    if result.chosen < 0:
        return True
    spans = [p.upper - p.lower for p in result.parameters] or [1.0] * len(result.initial)
    moved = np.subtract(result.phases[result.chosen].values, list(result.initial.values())) / spans
    return bool(np.abs(moved).max() <= _NO_MOVE)


def losses_of(result: FitResult, phase: int) -> list[float]:
    """The loss at each step of a phase."""
    # Only the best of several starts continues to the end.
    return [s.loss for s in result.history if s.phase == phase and s.start == result.history[-1].start]
