"""Remarks on a fit, in addition to its numbers."""

from collections.abc import Iterator

from ..._checks import text_within
from ..._words import counted, plural
from ...config import Config, is_limit
from ...fit import FitResult, FittedShape, Outcome
from ...settings.scene import SpotLight
from ..record._runs import BEST_ALREADY, UNEXPLAINED
from ._course import (
    CUT_SHORT,
    STILL_FALLING,
    is_by_profiles,
    is_nearly_done,
    last_phase,
    late_fall,
    losses_of,
    was_cut_short,
    what_is_fitted,
)

# If an interval exceeds this fraction of the distance between the bounds, the value hardly matters.
_FLAT = 0.5
_IN_PICTURES = "because no pixel of the picture changes with it near its start: try another initial value"


def remarks(config: Config | None, result: FitResult, kind: str = "fitted") -> list[str]:
    """A sentence for each reason not to rely on the fit.

    **Arguments:**

    - `config`: the configuration; `None` for a fit made in Python, whose remarks name Python's settings.
    - `kind`: the kind of the verdict. If the references are not explained, or if the start was the best, the fitted
      values and the reasons for stopping do not matter.
    """
    if result.arrangement is None:
        sentences = [_flat(config, name) for name in result.flat]
    else:
        # Large differences that more steps would reduce do not show how well the values are determined.
        is_known = kind != UNEXPLAINED and not was_cut_short(result)
        sentences = list(pose_remarks(config, result, is_known=is_known))
    if kind == UNEXPLAINED:
        return sentences
    sentences += [*_undecided(result), *_few_points(config, result)]
    if kind == BEST_ALREADY:
        return sentences
    # A preferred value may lie at a bound on purpose.
    preferred = bool(result.best) and result.fitted != result.best
    on_bounds = [] if preferred else _on_bounds(config, result)
    more = "raise max_steps of the fit.Solver" if config is None else "raise fit.solver.max_steps"
    within = "fit.Sureness(within=...)" if config is None else "fit.intervals"
    return [*sentences, *on_bounds, *_by_profiles(result, within, more), *_unconverged(result, more)]


def _undecided(result: FitResult) -> Iterator[str]:
    """A sentence for each parameter that hardly matters."""
    for parameter, profile in zip(result.parameters, result.profiles, strict=False):
        span = parameter.upper - parameter.lower
        flat = [each for each in profile.intervals if each.upper.value - each.lower.value > _FLAT * span]
        if flat:
            lower, upper = flat[0].lower.value, flat[0].upper.value
            yield (
                f"the error hardly depends on {profile.name}: it stays within {flat[0].within:.2%} of the best from "
                f"{lower:.3g} to {upper:.3g} {parameter.unit}"
            )


def _few_points(config: Config | None, result: FitResult) -> Iterator[str]:
    """A sentence for a front with fewer points than requested."""
    count, asked = len(result.front), result.sureness.front
    if count < asked:
        yield (
            f"{'Sureness' if config is None else 'fit'}.front is {asked}, and the front has {counted(count, 'point')}: "
            "no other settings were found that minimise a weighted sum of the two errors"
        )


def _unconverged(result: FitResult, more: str) -> Iterator[str]:
    """A sentence for each phase that led to the result and ended while its error was falling. `more` says how to get
    more steps."""
    found = last_phase(result)
    if found is None:
        return
    last, number = found
    is_done = is_nearly_done(result, number)
    if not is_done:
        fall = late_fall(losses_of(result, number))
        still = f", while its error fell {_by(*fall)}" if fall and fall[0] > 0 and last.result == CUT_SHORT else ""
        mend = f": {more}" if last.result == CUT_SHORT else ""
        which = "the phase that gave the result" if result.chosen >= 0 else "its last phase, and no phase ended better"
        yield f"the solver did not converge in {which} ({_named(last)}): {last.result}{still}{mend}"
    # If no phase led to the result, no earlier phase matters.
    for earlier, phase in enumerate(result.phases[: max(result.chosen, 0)]):
        if phase.result != CUT_SHORT:
            continue
        fall = late_fall(losses_of(result, earlier))
        before = f"an earlier phase ({_named(phase)}), where the result's phase began, ended at max_steps"
        # If a later phase has converged, an earlier phase that had nearly converged does not matter.
        if fall is not None and fall[0] > STILL_FALLING:
            yield f"{before} while its error still fell, {_by(*fall)}: {more}"
        elif not is_done:
            yield f"{before}, too"


def _by_profiles(result: FitResult, within: str, more: str) -> Iterator[str]:
    """A sentence for a fit whose solver gained nothing. `within` is the setting that requests profiles."""
    if is_by_profiles(result):
        yield (
            f"the solver found nothing better than the start: the profiles of {within}, which search near the best "
            f"values, found the whole improvement; a lower error may lie farther away: {more}, or "
            "begin at the fitted values"
        )


def _by(decrease: float, steps: int) -> str:
    return f"by {decrease:.0%} in its last {'step' if steps == 1 else f'{steps} steps'}"


def _named(phase: Outcome) -> str:
    value, unit = (phase.width, "texel") if phase.width else (phase.blur, "pixel")
    return f"{'width' if phase.width else 'blur'} {value:.3g} {unit if value == 1 else plural(unit)}"


def _flat(config: Config | None, name: str) -> str:
    remark = f"{name} was not fitted: its gradient is zero throughout"
    if config is None:
        return f"{remark}; no pixel changes with it near its start: try another initial value, or a larger Anneal.start"
    if name == "filter.radius" and config.filter.looks_up_nearest:
        return f"{remark}, because nearest look-ups have no gradient with respect to it: set filter.lookup to bilinear"
    if name == "filter.radius" and config.initial(name) == 0:
        return f"{remark}, because it starts at 0: give it an initial value above 0"
    return f"{remark}; no pixel changes with it near its start: try another initial value, or a larger fit.anneal.start"


def _on_bounds(config: Config | None, result: FitResult) -> Iterator[str]:
    """A sentence for each value on a bound beyond which the error may fall further. For a picture, also for a value at
    the limit of its key."""
    named = {parameter.name: parameter for parameter in result.parameters}
    for name, side, bound, falls in result.at_bounds:
        if not falls or name in result.flat:
            continue
        lower, upper, unit = named[name].lower, named[name].upper, named[name].unit
        where = f"{name} ended on its {side} bound, {text_within(bound, lower, upper, 6)} {unit}".rstrip()
        # Values without a key have no known limits.
        if config is None or not is_limit(config, name, bound):
            yield f"{where}, where the error still falls: the best value may lie beyond it, so widen the bounds"
        elif what_is_fitted(result) == "picture":
            yield (
                f"{where}, where the error still falls. That is the limit of {name}, so wider bounds are not "
                "possible: an object or number that is not fitted differs from the picture; fit more of the scene "
                "as well, such as lights, "
                "colours or reference.exposure"
            )


def pose_remarks(config: Config | None, result: FitResult, *, is_known: bool = True) -> Iterator[str]:
    """A sentence for each parameter that the image or the picture does not determine, with the cause.

    **Arguments:**

    - `is_known`: whether the fit converged and explains the image. If not, no sentence says how well the image
      determines the values.
    """
    what = what_is_fitted(result)
    for name in result.flat:
        # A picture also shows objects without a shadow.
        cause = _IN_PICTURES if what == "picture" else _cause_of_pose(config, name)
        yield f"{name} was not fitted: its gradient is zero throughout, {cause}"
    for group in () if result.precision is None or not is_known else result.precision.undetermined:
        if len(group) == 1:
            yield f"the {what} hardly determines {group[0]}: other values fit equally well"
        else:
            listed = f"{', '.join(group[:-1])} and {group[-1]}"
            yield f"the {what} hardly determines {listed}: joint changes do not affect the error"
    if result.enlargements:
        yield f"memory for silhouettes was enlarged {result.enlargements} times during the fit; each time recompiles"


def _cause_of_pose(config: Config | None, name: str) -> str:
    if config is None:
        return (
            "because no pixel changes with it: try another initial value, a filter with bilinear taps, or silhouettes"
        )
    section, *_, key = name.split(".")
    if section != "scene":
        if config.filter.looks_up_nearest:
            return "because nearest look-ups have no gradient: choose a filter with bilinear look-ups"
        return "because no pixel changes with it: try another initial value"
    if key in ("azimuth", "elevation") and not _is_obeyed(config, name):
        return "because the cone of a spot light without inner_angle is ignored: set inner_angle, or do not fit this"
    if "meshes" in name:
        mesh = config.scene.meshes[int(name.split(".")[2])]
        if not mesh.casts:
            return "because its mesh does not cast: set casts: true"
    if not config.has_silhouettes:
        return "because outlines have no gradient without silhouettes: remove shadow_map.silhouettes"
    if config.filter.looks_up_nearest:
        return "because nearest look-ups have no gradient at outlines: choose a filter with bilinear look-ups"
    if "meshes" in name:
        return "because no pixel sees its shadow: it is outside the light's frustum, or its shadow is outside the image"
    return "because no pixel sees a shadow's outline: the light's frustum contains nothing that the camera sees"


def _is_obeyed(config: Config, name: str) -> bool:
    lights = {"scene." + ".".join(map(str, key)): light for key, light in config.scene.each_light.items()}
    light = lights[name.rpartition(".")[0]]
    return not isinstance(light, SpotLight) or light.inner_angle is not None


def shape_remarks(result: FittedShape) -> Iterator[str]:
    """Warns if the error still fell at the end of the phase that gave the result."""
    found = late_fall([loss for phase, loss in result.history if phase == result.chosen])
    if found is not None and found[0] > STILL_FALLING:
        yield (
            f"the error still fell when phase {result.chosen + 1} ended, which gave the result, {_by(*found)}: raise "
            f"its steps, fit.shape.phases.{result.chosen}.steps"
        )
