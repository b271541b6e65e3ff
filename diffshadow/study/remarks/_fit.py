"""Remarks on a fit: what a reader should know besides its numbers."""

from collections.abc import Iterator, Sequence

from ..._checks import text_within
from ...config import Config, FitPlan, is_limit
from ...fit import FitResult, Outcome, Parameter
from ..pages._table import UNEXPLAINED
from ._pose import pose_remarks
from ._verdict import BEST_ALREADY, Kind

_CUT_SHORT = "max_steps reached"
# Above this relative decrease in the last steps, a loss counts as still falling. Losses of poses change a little at
# every step, as pixels switch between lit and shadowed.
_STILL_FALLING = 0.25
# Up to this one, the last phase of a fit of a technique counts as done: its error fell by no more than half as much.
_NEARLY_DONE = 0.01
# An interval longer than this part of the distance between the bounds says that a value hardly matters.
_FLAT = 0.5


def remarks(config: Config | None, plan: FitPlan, result: FitResult, kind: Kind = "fitted") -> list[str]:
    """A sentence for each reason not to rely on the fit.

    **Arguments:**

    - `config`: none of a fit that was made in Python, whose remarks name Python's settings.
    - `kind`: of the verdict. Where the references are not explained, it does not matter where the values ended or
        why; nor where the start was the best.
    """
    if result.arrangement is None:
        sentences = [_flat(config, name) for name in result.flat]
    else:
        sentences = list(pose_remarks(config, result, is_explained=kind != UNEXPLAINED))
    if kind == UNEXPLAINED:
        return sentences
    sentences += [*_undecided(plan.parameters, result), *_few_points(plan, result)]
    if kind == BEST_ALREADY:
        return sentences
    # A preferred value lies on purpose where it does.
    preferred = bool(result.best) and result.fitted != result.best
    on_bounds = [] if preferred else _on_bounds(config, plan.parameters, result)
    more = "raise max_steps of the fit.Solver" if config is None else "raise fit.solver.max_steps"
    return [*sentences, *on_bounds, *_unconverged(result, more)]


def _undecided(parameters: Sequence[Parameter], result: FitResult) -> Iterator[str]:
    """A sentence for each parameter that hardly matters."""
    for parameter, profile in zip(parameters, result.profiles, strict=False):
        span = parameter.upper - parameter.lower
        flat = [each for each in profile.intervals if each.upper.value - each.lower.value > _FLAT * span]
        if flat:
            lower, upper = flat[0].lower.value, flat[0].upper.value
            yield (
                f"the error hardly depends on {profile.name}: it stays within {flat[0].within:.2%} of the best from "
                f"{lower:.3g} to {upper:.3g} {parameter.unit}"
            )


def _few_points(plan: FitPlan, result: FitResult) -> Iterator[str]:
    """A sentence for a front of fewer points than asked for."""
    count = len(result.front)
    if count < plan.front:
        yield (
            f"fit.front is {plan.front}, and the front has {count} point{'' if count == 1 else 's'}: no other settings "
            "were found whose errors differ from theirs and whose weighted sum is the least for some weights"
        )


def _unconverged(result: FitResult, more: str) -> Iterator[str]:
    """A sentence for each phase that led to the result and ended while its error still fell; `more` says what gives
    more steps."""
    if result.chosen < 0:
        return
    last, is_done = result.phases[result.chosen], True
    if last.result != "successful":
        fall = _late_fall(result, result.chosen)
        # Losses of poses change a little at every step.
        least = _NEARLY_DONE if result.arrangement is None else _STILL_FALLING
        is_done = last.result == _CUT_SHORT and fall is not None and fall[0] <= least
        if not is_done:
            still = "" if fall is None or last.result != _CUT_SHORT else f", while its error fell {_by(*fall)}"
            mend = f": {more}" if last.result == _CUT_SHORT else ""
            in_phase = f"the solver did not converge in the phase that gave the result ({_named(last)})"
            yield f"{in_phase}: {last.result}{still}{mend}"
    for number, phase in enumerate(result.phases[: result.chosen]):
        if phase.result != _CUT_SHORT:
            continue
        fall = _late_fall(result, number)
        before = f"an earlier phase ({_named(phase)}), where the result's phase began, ended at max_steps"
        # If a later phase has converged, an earlier one that was nearly done does not matter.
        if fall is not None and fall[0] > _STILL_FALLING:
            yield f"{before} while its error still fell, {_by(*fall)}: {more}"
        elif not is_done:
            yield f"{before}, too"


def _by(decrease: float, steps: int) -> str:
    return f"by {decrease:.0%} in its last {'step' if steps == 1 else f'{steps} steps'}"


def _late_fall(result: FitResult, phase: int) -> tuple[float, int] | None:
    """The relative decrease of a phase's loss in the last quarter of its steps, and the number of these steps; none for
    fewer than two steps."""
    # Only the best of several starts continues to the end.
    losses = [s.loss for s in result.history if s.phase == phase and s.start == result.history[-1].start]
    if len(losses) < 2:
        return None
    late = max(len(losses) // 4, 1)
    # By minima, since the solver rejects some steps.
    early, least = min(losses[:-late]), min(losses)
    return (1 - least / early if early > 0 else 0.0), late


def _named(phase: Outcome) -> str:
    return f"width {phase.width:.3g} texels" if phase.width else f"blur {phase.blur:.3g} pixels"


def _flat(config: Config | None, name: str) -> str:
    remark = f"{name} was not fitted: its gradient is zero throughout"
    if config is None:
        return f"{remark}; no pixel changes with it near its start: try another initial value, or a larger Anneal.start"
    if name == "filter.radius" and config.filter.looks_up_nearest:
        return f"{remark}, since nearest look-ups have no gradient by it: set filter.lookup to bilinear"
    if name == "filter.radius" and config.initial(name) == 0:
        return f"{remark}, since it starts at 0: give it an initial value above 0"
    return f"{remark}; no pixel changes with it near its start: try another initial value, or a larger fit.anneal.start"


def _on_bounds(config: Config | None, parameters: Sequence[Parameter], result: FitResult) -> Iterator[str]:
    """A sentence for each value on a bound beyond which the error may fall further."""
    named = {parameter.name: parameter for parameter in parameters}
    for name, side, bound, falls in result.at_bounds:
        # Values without a key have no known limits.
        is_end = config is not None and is_limit(config, name, bound)
        if falls and name not in result.flat and not is_end:
            lower, upper, unit = named[name].lower, named[name].upper, named[name].unit
            where = f"{name} ended on its {side} bound, {text_within(bound, lower, upper, 6)} {unit}".rstrip()
            yield f"{where}, where the error still falls: the best value may lie beyond it, so widen the bounds"
