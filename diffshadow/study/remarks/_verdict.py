"""The verdict on a fit in words. The console, the report and `result.json` show it first."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..._words import counted
from ...config import Config
from ...fit import FitResult, FittedShape
from ..record._runs import BEST_ALREADY, UNEXPLAINED, ShapeMetrics, Verdict
from ._course import was_cut_short, what_is_fitted

# If this many parameters precede the last one, a sentence counts them instead of naming them.
_MANY = 3
# The advised number of starts for a fit with one start.
_STARTS, _MAX_STARTS = 8, 1024
# The light and the shadow of a correct reference differ from 0 and 1 by at most this value.
_NEARLY = 0.05
# Up to this factor, improvements are given in percent.
_MUCH_BETTER = 1.5


class Change(NamedTuple):
    """The change after which a reference shows the same as rays.

    - `turn`: in words, such as `"flip the reference upside down"`; empty if it is correct.
    - `is_inverted`: whether light and shadow are exchanged.
    - `low`, `high`: the reference's values where rays see shadow and light.
    - `rmse`: RMSE of the turned and inverted reference against rays.
    - `left`: the fraction of its variance that rays do not explain, for any `low` and `high`.
    """

    turn: str
    is_inverted: bool
    low: float
    high: float
    rmse: float
    left: float


class Unexplained(NamedTuple):
    """The part of its references that a fit does not explain.

    - `rmse`: the fit's error over all images; `constant`: the lowest error of constant images.
    - `keys`: the keys of the lights or views whose references do not show this scene in its fitted state. May be empty.
    - `by_rays`: the error of rays against the first of these references; `given`: whether this reference is a file.
    - `change`: the change that makes the first of these references a picture of the scene. `None` if no change does, or
      if the reference was traced.
    """

    rmse: float
    constant: float
    keys: list[str] = []  # noqa: RUF012
    by_rays: float | None = None
    given: bool = False
    change: Change | None = None


def verdict(
    config: Config | None, result: FitResult, before: float, after: float, found: Unexplained | None
) -> Verdict:
    """The verdict on a fit.

    **Arguments:**

    - `config`: the configuration; `None` for a fit made in Python, whose remedies name Python's settings.
    - `before`, `after`: the RMSE before and after the fit.
    - `found`: the part that the fit leaves unexplained.
    """
    if found is not None:
        return unexplained_verdict(config, found, starts=result.search.starts, moves=result.arrangement is not None)
    names = _listed(list(result.fitted))
    if set(result.flat) == set(result.fitted):
        return Verdict(
            kind="nothing fitted", sentence=f"nothing was fitted: the error does not change with {names} near the start"
        )
    if _was_best(result) and was_cut_short(result):
        return Verdict(kind="cut short", sentence=_cut_short(result, before, after))
    if _was_best(result):
        return Verdict(kind=BEST_ALREADY, sentence=_best_already(config, result, before, after))
    if after >= before:
        # With another loss, or by preference.
        return Verdict(
            kind="fitted",
            sentence=f"fitting {names} changed the RMSE from {before:.4f} to {after:.4f} in "
            f"{counted(result.steps, 'step')}; the fit's own loss fell from {result.errors[0] ** 2:.3g} to "
            f"{result.errors[1] ** 2:.3g}",
        )
    whose = "picture's" if what_is_fitted(result) == "picture" else "shadow's"
    factor = before / max(after, 1e-12)
    by = f"a factor of {factor:.1f}" if factor >= _MUCH_BETTER else f"{100 * (1 - 1 / factor):.1f} %"
    return Verdict(
        kind="fitted",
        sentence=f"fitting {names} reduced the {whose} error from {before:.4f} to {after:.4f} RMSE, by {by}, in "
        f"{counted(result.steps, 'step')}",
    )


def unexplained_verdict(config: Config | None, found: Unexplained, *, starts: int, moves: bool) -> Verdict:
    """The verdict on a fit that does not explain its references.

    **Arguments:** `starts`: number of starts of the fit; `moves`: whether it moved lights, meshes or the camera.
    """
    remedies = list(_remedies(config, found, starts, moves=moves))
    return Verdict(kind=UNEXPLAINED, sentence=_unexplained(found), remedies=remedies, constant_rmse=found.constant)


def _was_best(result: FitResult) -> bool:
    """Whether the error at the start is the best within the tolerance."""
    # With several starts, the best start may differ from the configured one.
    starts = [p.initial for p in result.parameters]
    is_own = np.allclose(starts, list(result.initial.values()), rtol=1e-5, atol=0)
    before, best = result.errors
    return is_own and before <= (1 + result.sureness.tolerance) * best


def _cut_short(result: FitResult, before: float, after: float) -> str:
    steps = counted(result.steps, "step")
    error = f"stayed at {before:.4f}" if before == after else f"went from {before:.4f} to {after:.4f}"
    return f"the fit ended before it converged: its RMSE {error} in {steps}, and more steps may find better values"


def _best_already(config: Config | None, result: FitResult, before: float, after: float) -> str:
    best = "your settings are already the best"
    if result.fitted == result.initial:
        return f"{best}: no values that the fit tried have a smaller error than their RMSE of {before:.4f}"
    by = "the fitted values"
    if result.sureness.prefer:
        by = f"the values that {'Sureness.prefer' if config is None else 'fit.prefer'} chose"
    return (
        f"{best} within {100 * result.sureness.tolerance:.3g} %: their RMSE is {before:.4f}, and {by} have {after:.4f}"
    )


def _unexplained(found: Unexplained) -> str:
    says = f"the fit does not explain its image{'s' if len(found.keys) > 1 else ''}"
    if found.rmse >= found.constant:
        return (
            f"{says}: its RMSE is {found.rmse:.4f}, and a constant image instead of the fitted one would have "
            f"{found.constant:.4f}"
        )
    which = "its reference" if len(found.keys) == 1 else f"the reference of {found.keys[0]}"
    return f"{says}: rays in the fitted scene differ from {which} by {found.by_rays:.4f} RMSE"


def _remedies(config: Config | None, found: Unexplained, starts: int, *, moves: bool) -> Iterator[str]:
    if len(found.keys) > 1:
        yield f"this concerns {_listed(found.keys, 'views')}"
    if found.change is not None and (steps := list(_mended(found, found.change))):
        yield from steps
        return
    starts = _STARTS if starts == 1 else min(4 * starts, _MAX_STARTS)
    more = f"search=fit.Search(starts={starts})" if config is None else f"fit.multistart={starts}"
    if moves:
        yield f"try more starts, {more}, or other initial values: the fit may have ended in a local minimum"
    if found.keys and found.given:
        what = "check that it was made with this camera, this light and these meshes"
        yield f"flipping or inverting the reference does not help either: {what}"
        fits_lights = config is None or any(name.startswith("scene.light") for name in config.fit.parameters)
        if config is not None and not fits_lights and (pose := _pose_of_light(config)):
            yield f"if the light is unknown, fit it as well: add {pose} to fit.parameters, with {more}"
    if not found.keys and not moves:
        larger = "a shadow map of more texels" if config is None else "a larger shadow_map.resolution"
        yield f"try more starts, {more}, other initial values, or {larger}"


def _mended(found: Unexplained, change: Change) -> Iterator[str]:
    """The change that makes the reference a picture of the scene."""
    steps = [change.turn] if change.turn else []
    if change.is_inverted:
        steps.append(f"invert {'it' if steps else 'the reference'}")
    if steps:
        yield (
            f"{' and '.join(steps)}: rays in this scene then differ from it by {change.rmse:.4f} RMSE instead of "
            f"{found.by_rays:.4f}"
        )
    low, high = sorted((change.low, change.high))
    if low > _NEARLY or high < 1 - _NEARLY:
        yield (
            f"stretch the reference's values: they are about {low:.2f} in shadow and {high:.2f} in light, and "
            "visibility is 0 in shadow and 1 in light"
        )


def _pose_of_light(config: Config) -> str | None:
    """The numbers of the configuration's light that define its position."""
    of_type = {
        "directional": ("azimuth", "elevation"),
        "spot": ("position.x", "position.y", "position.z"),
        "point": ("position.x", "position.y", "position.z"),
    }
    for key, light in config.scene.each_light.items():
        if light.type in of_type:
            return _listed([".".join(map(str, ("scene", *key, name))) for name in of_type[light.type]])
    return None


def _listed(names: Sequence[str], what: str = "parameters") -> str:
    *most, last = names
    if len(most) >= _MANY:
        return f"{len(names)} {what}"
    return f"{', '.join(most)} and {last}" if most else last


def shape_verdict(result: FittedShape, measured: ShapeMetrics) -> Verdict:
    """The verdict on a fit of a shape.

    **Arguments:** `measured`: the closeness of the shape's shadows to their targets.
    """
    overlap = f"{np.mean([light.rays for light in measured.lights]):.1%}"
    if result.chosen < 0:
        kind = BEST_ALREADY
        text = (
            f"no phase ended better than the start, which is the result: its shadows overlap their targets to {overlap}"
        )
    else:
        kind, before = "fitted", np.mean([light.before for light in measured.lights])
        steps = counted(len(result.history), "step")
        text = f"the shadows overlap their targets to {overlap} by rays, from {before:.1%}, in {steps}"
    if measured.unseen:
        unseen = np.mean([light.rays for light in measured.unseen])
        text += f", and to {unseen:.1%} under lights that the fit has not seen"
    if measured.chamfer is not None and measured.size is not None:
        text += f"; the shape is {measured.chamfer / measured.size:.2%} of its size from the truth on average"
    pairs, remedies = measured.self_intersections, []
    if pairs:
        text += f"; the surface intersects itself in {counted(pairs, 'pair')} of faces"
        remedies = [
            "raise normal_consistency of the phases of fit.shape, to 0.001 for example, for a surface that crosses "
            "itself less"
        ]
    return Verdict(kind=kind, sentence=text, remedies=remedies)
