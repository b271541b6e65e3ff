"""What a reader of a fit's numbers should know beside them."""

from collections.abc import Sequence

from ..config import Config
from ..fit import FitResult, Parameter
from ._pose_run import pose_remarks

# A value within this share of its bounds' distance from one of them sits on it.
_ON_BOUND = 1e-3


def remarks(config: Config, parameters: Sequence[Parameter], result: FitResult) -> list[str]:
    """One plain sentence for each thing that makes the fit less than it looks."""
    if result.arrangement is None:
        said = [_flat(config, name) for name in result.flat]
    else:
        said = list(pose_remarks(config, result))
    if result.chosen < 0:
        said.append(
            "no phase ended better than the start under the hard compare, so the start is the result: try other "
            "initial values, or a smaller fit.anneal.start"
        )
    said += [text for p in parameters if p.name not in result.flat for text in _on_bound(p, result.fitted[p.name])]
    outcome = result.phases[result.chosen]
    if outcome.result != "successful":
        mend = ": raise fit.solver.max_steps" if outcome.result == "max_steps reached" else ""
        phase = f"width {outcome.width:.3g} texels" if outcome.width else f"level {outcome.level}"
        said.append(f"the solver did not converge in the phase that gave the result ({phase}): {outcome.result}{mend}")
    return said


def _flat(config: Config, name: str) -> str:
    said = f"{name} was not fitted: its gradient is zero throughout"
    looks_up_nearest = config.filter.type == "nearest" or getattr(config.filter, "lookup", "bilinear") == "nearest"
    if name == "filter.radius" and looks_up_nearest:
        return f"{said}, since nearest look-ups give the radius none: set filter.lookup to bilinear"
    if name == "filter.radius" and config.initial(name) == 0:
        return f"{said}, since it starts at 0: give it an initial value above 0"
    return f"{said}; no pixel changes with it near its start: try another initial value, or a larger fit.anneal.start"


def _on_bound(parameter: Parameter, value: float) -> list[str]:
    reach = _ON_BOUND * (parameter.upper - parameter.lower)
    for name, bound in (("lower", parameter.lower), ("upper", parameter.upper)):
        if abs(value - bound) <= reach:
            # Nothing lies below 0 for these numbers.
            mend = "" if bound == 0 and name == "lower" else ": the best value may lie beyond it, so widen the bounds"
            return [f"{parameter.name} ended on its {name} bound, {bound:g} {parameter.unit}{mend}"]
    return []
