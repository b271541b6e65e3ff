"""Remarks on a fit: what a reader should know besides its numbers."""

from collections.abc import Iterator, Sequence

from ..._checks import text_within
from ...config import Config
from ...fit import FitResult, Outcome, Parameter
from ._pose import pose_remarks

_CUT_SHORT = "max_steps reached"
# Above this relative decrease in the last steps, a loss counts as still falling. Losses of poses change a little at
# every step, as pixels switch between lit and shadowed.
_STILL_FALLING = 0.25
# An interval longer than this part of the distance between the bounds says that a value hardly matters.
_FLAT = 0.5
# A value is on a bound if it is within this fraction of the bounds' distance from it.
_ON_BOUND = 1e-3


def remarks(config: Config, parameters: Sequence[Parameter], result: FitResult) -> list[str]:
    """A sentence for each reason not to rely on the fit."""
    if result.arrangement is None:
        sentences = [_flat(config, name) for name in result.flat]
    else:
        sentences = list(pose_remarks(config, result))
    if result.chosen < 0:
        sentences.append(
            "no phase ended better than the start under the hard compare, so the start is the result: try other "
            "initial values, or a smaller fit.anneal.start"
        )
    # A preferred value lies on purpose where it does.
    preferred = bool(result.best) and result.fitted != result.best
    for p in parameters:
        if p.name not in result.flat and not preferred:
            sentences += _on_bound(p, result.fitted[p.name])
    return [*sentences, *_undecided(parameters, result), *_unconverged(result)]


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


def _unconverged(result: FitResult) -> Iterator[str]:
    """A sentence for each phase that led to the result and ended before the solver converged."""
    if result.chosen < 0:
        return
    last = result.phases[result.chosen]
    if last.result != "successful":
        mend = ": raise fit.solver.max_steps" if last.result == _CUT_SHORT else ""
        yield f"the solver did not converge in the phase that gave the result ({_named(last)}): {last.result}{mend}"
    for number, phase in enumerate(result.phases[: result.chosen]):
        if phase.result != _CUT_SHORT:
            continue
        decrease, steps = _late_fall(result, number)
        before = f"an earlier phase ({_named(phase)}), where the one that gave the result began, ended at max_steps"
        # If a later phase has converged, an earlier one that was nearly done does not matter.
        if decrease > _STILL_FALLING:
            fall = f"by {decrease:.0%} in its last {'step' if steps == 1 else f'{steps} steps'}"
            yield f"{before} while its error still fell, {fall}: raise fit.solver.max_steps"
        elif last.result != "successful":
            yield f"{before}, too"


def _late_fall(result: FitResult, phase: int) -> tuple[float, int]:
    """The relative decrease of a phase's loss in the last quarter of its steps, and the number of these steps."""
    # Only the best of several starts continues to the end.
    losses = [s.loss for s in result.history if s.phase == phase and s.start == result.history[-1].start]
    if len(losses) < 2:
        return 0.0, len(losses)
    late = max(len(losses) // 4, 1)
    # By minima, since the solver rejects some steps.
    early, least = min(losses[:-late]), min(losses)
    return (1 - least / early if early > 0 else 0.0), late


def _named(phase: Outcome) -> str:
    return f"width {phase.width:.3g} texels" if phase.width else f"blur {phase.blur:.3g} pixels"


def _flat(config: Config, name: str) -> str:
    remark = f"{name} was not fitted: its gradient is zero throughout"
    if name == "filter.radius" and config.filter.looks_up_nearest:
        return f"{remark}, since nearest look-ups have no gradient by it: set filter.lookup to bilinear"
    if name == "filter.radius" and config.initial(name) == 0:
        return f"{remark}, since it starts at 0: give it an initial value above 0"
    return f"{remark}; no pixel changes with it near its start: try another initial value, or a larger fit.anneal.start"


def _on_bound(parameter: Parameter, value: float) -> list[str]:
    reach = _ON_BOUND * (parameter.upper - parameter.lower)
    for name, bound in (("lower", parameter.lower), ("upper", parameter.upper)):
        if abs(value - bound) <= reach:
            # These numbers cannot be less than 0.
            mend = "" if bound == 0 and name == "lower" else ": the best value may lie beyond it, so widen the bounds"
            text = text_within(bound, parameter.lower, parameter.upper, 6)
            return [f"{parameter.name} ended on its {name} bound, {text} {parameter.unit}{mend}"]
    return []
