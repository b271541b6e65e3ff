"""Rules in the engines themselves: what these draw, beside what the library predicts."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import _common as common
import _rule_errors as errors
import _rule_shipped as shipped
import jax.numpy as jnp
import numpy as np
from _engine_jobs import NEAR, Engine, engine_job
from engines.engines import draw
from rich.table import Table

from diffshadow import shadow
from diffshadow.config import Config
from diffshadow.console import Console

EXACT = ("three.js", "babylon.js", "playcanvas")
"""The engines that can be drawn here."""
STATES = ("shipped", "rule")
HEAD = ("engine", "bias", "RMSE in the engine", "predicted", "acne in the engine", "predicted", "pixels equal")


class _Scene(NamedTuple):
    """A scene with the techniques that are drawn, one for each of `STATES`."""

    case: common.Case
    state: Any
    seen: errors.Seen
    techniques: list[Engine]


def checked(scenes: Sequence[Config], rules: Mapping[str, Any], console: Console) -> dict[str, Any]:
    """What the engines draw in the scenes that have a light of theirs, by engine and state: means over the scenes of
    the root mean square error, the share of scenes with acne and with leaks, each in the engine and as predicted, and
    the share of pixels that are equal.

    **Arguments:**

    - `rules`: what was found for each engine: its `bias` is constant, slope and normal offset in texels.
    """
    found = {}
    for name in EXACT:
        tried = [_scene(settings, name, rules[name]) for settings in common.progress(scenes, name, console)]
        made = [each for each in tried if each is not None]
        jobs = [engine_job(each.case, each.techniques[0], each.techniques) | {"outputs": ["mesh"]} for each in made]
        pictures = [drawing.arrays for drawing in draw(jobs)]
        scores = np.array([_scores(*each) for each in zip(made, pictures, strict=True)])
        found[name] = {"scenes": len(made)} | {state: _means(scores[:, i]) for i, state in enumerate(STATES)}
    return found


def _scene(settings: Config, name: str, rule: Mapping[str, Any]) -> _Scene | None:
    """None if the engine lacks the light."""
    case, engine = common.draw(settings), shipped.EXACT[name]
    plain, shadow_map, _ = errors.plain_map(case)
    at = shadow.receiver(shadow_map, case.surface)
    made = shipped.drawable(engine, case, at, errors.pixels_per_texel(plain, shadow_map, case))
    if made is None:
        return None
    constant, _, offset = rule["bias"]
    texels = [min(x * unit, engine.most) for x, unit in zip((constant, offset), made.units, strict=True)]
    values = (engine.shipped, rule["own"] if rule["is_own"] else texels)
    techniques = [shipped.with_biases(made.technique, each) for each in values]
    return _Scene(case, made.state, made.seen, techniques)


def _scores(scene: _Scene, arrays: Mapping[str, np.ndarray]) -> list[list[float]]:
    """For each state: error, acne and leaks in the engine, the same as predicted, and the share of equal pixels."""
    # The engine's camera may miss a pixel at an outline.
    there = jnp.asarray(arrays["mesh"] >= 0)
    seen = errors.Seen(
        scene.seen.truth, *(each & there for each in (scene.seen.inside, scene.seen.lit, scene.seen.dark))
    )
    inside = np.asarray(seen.inside)
    rows = []
    for technique, picture in zip(scene.techniques, arrays["grid"].clip(0, 1), strict=True):
        predicted = technique.visibility(scene.state, scene.case.surface)
        equal = np.abs(np.asarray(predicted) - picture)[inside] <= NEAR
        both = (errors.scores_of(jnp.asarray(image), seen) for image in (picture, predicted))
        rows.append([*(float(x) for each in both for x in each), float(equal.mean())])
    return rows


def _means(scores: np.ndarray) -> dict[str, Any]:
    named = {}
    for i, whose in enumerate(("engine", "predicted")):
        error, acne, leaks = scores[:, 3 * i : 3 * i + 3].T
        named[whose] = {
            "rmse": float(error.mean()),
            "acne": float(np.mean(acne > errors.ACNE)),
            "leaks": float(np.mean(leaks > errors.ACNE)),
        }
    return {**named, "equal": float(scores[:, 6].mean())}


def show(console: Console, found: Mapping[str, Any]) -> None:
    """Prints what the engines draw and what was predicted."""
    table = Table(*HEAD)
    for name, of in found.items():
        for state in STATES:
            table.add_row(name, state, *cells_of(of[state]))
    console.print(table)


def cells_of(found: Mapping[str, Any]) -> list[str]:
    """Errors and acne, in the engine and as predicted, and the share of equal pixels."""
    both = [found[whose] for whose in ("engine", "predicted")]
    rmse, acne = (f"{each['rmse']:.4f}" for each in both), (f"{each['acne']:.0%}" for each in both)
    return [*rmse, *acne, f"{found['equal']:.2%}"]
