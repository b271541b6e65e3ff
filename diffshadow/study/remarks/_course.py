"""The course of a fit: whether its solver converged, and the solver's share in the result."""

from collections.abc import Sequence

import numpy as np

from ...fit import FitResult, Outcome, PictureProblem

CUT_SHORT = "max_steps reached"
"""The reason of a phase that ended because it had no further steps."""
STILL_FALLING = 0.25
"""A loss counts as still falling if it fell by more than this fraction in the last steps. Losses of poses change a
little at every step, because pixels switch between light and shadow."""
# The last phase of a fit of a technique counts as finished up to this limit: its error fell by no more than half as
# much.
_NEARLY_DONE = 0.01
# With fewer evaluations, a decrease does not tell whether more would follow, because solvers reject some first steps.
_FEW = 5
# Values of the solver count as the start within this fraction of the distance between the bounds.
_NO_MOVE = 1e-5


def what_is_fitted(result: FitResult) -> str:
    """What a fit compares, in words: an image of visibility, or a picture."""
    return "picture" if any(isinstance(problem, PictureProblem) for problem in result.problems) else "image"


def late_fall(losses: Sequence[float]) -> tuple[float, int] | None:
    """The fraction by which a phase's loss fell in the last quarter of its steps, and the number of these steps. `None`
    if there are fewer than two steps."""
    if len(losses) < 2:
        return None
    late = max(len(losses) // 4, 1)
    # Compares minima, because the solver rejects some steps.
    early, least = min(losses[:-late]), min(losses)
    return (1 - least / early if early > 0 else 0.0), late


def is_nearly_done(result: FitResult, phase: int) -> bool:
    """Whether a phase converged, or ended at `max_steps` after its loss had nearly settled."""
    outcome = result.phases[phase]
    if outcome.result != CUT_SHORT:
        return outcome.result == "successful"
    fall = late_fall(losses_of(result, phase))
    # Losses of poses change a little at every step.
    least = _NEARLY_DONE if result.arrangement is None else STILL_FALLING
    return fall is not None and fall[0] <= least and len(losses_of(result, phase)) >= _FEW


def last_phase(result: FitResult) -> tuple[Outcome, int] | None:
    """The phase that gave the result, or the last phase if the start was better than all phases. `None` without
    phases."""
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
    """Whether the solver did not change the start and profiles found a lower error."""
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
