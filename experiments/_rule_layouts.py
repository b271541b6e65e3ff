"""Errors of layouts of a map with the same number of texels, and of numbers and patterns of taps, in one scene."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import _common as common
import _rule_errors as errors
import jax.numpy as jnp
import numpy as np
from rich.table import Table

from diffshadow import shadow
from diffshadow.console import Console

SIZES = (512, 1024)
"""The side of one square map; other layouts have as many texels."""
LAYOUTS: dict[str, tuple[shadow.AbstractLayout, int]] = {
    "one map": (shadow.SingleMap(), 1),
    "4 cascades": (shadow.Cascades(4, depths="surface", stabilize=False), 2),
    "LiSPSM": (shadow.PerspectiveWarp(depths="surface"), 1),
    "pages": (shadow.ResolutionMatched(finest=1 << 16, level_bias=-8.0), 1),
}
"""Each layout, and how many times smaller the side of its maps is."""
_BIASES = np.array([(c, s, 0.0) for c in (0.5, 1.0, 2.0, 4.0) for s in (0.5, 1.0, 2.0)], np.float32)

PATTERNS: dict[str, Callable[[int], shadow.Pattern]] = {
    "stratified": lambda taps: shadow.stratified(taps),
    "vogel": lambda taps: shadow.vogel(taps),
    "sobol": lambda taps: shadow.sobol(taps),
    "halton": lambda taps: shadow.halton(taps),
    "poisson disk": lambda taps: shadow.poisson_disk(taps),
    "uniform": lambda taps: shadow.uniform(taps),
    "vogel, not rotated": lambda taps: shadow.vogel(taps, rotated=False),
}
"""Patterns by name, of a number of taps. The spiral (vogel) is rotated at each pixel by interleaved gradient noise; the
others have other points at each pixel of a tile of 8 x 8."""
TAPS = (4, 8, 16, 32, 64)
_MANY, _RADIUS = 256, 4.0


def layout_errors(settings: Any) -> dict[str, np.ndarray]:
    """The least error of each layout over a few biases, (sizes, layouts); nothing but under a sun.

    All pixels with a surface count.
    """
    if settings.scene.light.type != "directional":
        return {}
    case = common.draw(settings)
    seen = errors.seen_by(case.truth, np.asarray(case.truth.mask), 1.0)
    found = np.full((len(SIZES), len(LAYOUTS)), np.nan, np.float32)
    for (i, size), (j, (layout, smaller)) in ((a, b) for a in enumerate(SIZES) for b in enumerate(LAYOUTS.values())):
        side = size // smaller
        made = shadow.MapSettings((side, side))
        technique = shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(0.0, 0.0, 0.0), map=made, layout=layout)
        state = technique.prepare(case.scene, case.surface)
        found[i, j] = errors.grid_errors(technique, _BIASES, state, case.surface, seen)[:, 0].min()
    return {"layouts": found}


@functools.cache
def _pattern(name: str, taps: int) -> shadow.Pattern:
    return PATTERNS[name](taps)


def tap_errors(settings: Any, bias: np.ndarray) -> dict[str, np.ndarray]:
    """Errors of a disk with each pattern and number of taps, (patterns, taps, 2): against the rays, and against the
    same disk with many taps. `bias` is that of all, in texels."""
    case = common.draw(settings)
    _, state, covered = errors.plain_map(case)
    biased = shadow.Bias(float(bias[0]), float(bias[1]), float(bias[2]))

    def seen_with(pattern: shadow.Pattern) -> jnp.ndarray:
        technique = shadow.ShadowMapping(shadow.RandomDisk(_RADIUS, pattern), biased)
        return technique.visibility(state, case.surface)

    truth, many = jnp.asarray(case.truth.visibility), seen_with(_pattern("vogel", _MANY))
    error = lambda image, other: float(jnp.sqrt(jnp.mean(jnp.square(image - other)[covered])))
    found = [[seen_with(_pattern(name, taps)) for taps in TAPS] for name in PATTERNS]
    values = [[(error(each, truth), error(each, many)) for each in row] for row in found]
    return {"taps": np.array(values, np.float32), "many taps": np.array([error(many, truth)], np.float32)}


# --- Over all scenes ---


def compared(found: Sequence[Mapping[str, np.ndarray]], kinds: Sequence[str]) -> dict[str, Any]:
    """For each size and kind of scene under a sun: the share of scenes where a layout has the least error, and the mean
    of its error over the least."""
    kept = [(kind, each["layouts"]) for kind, each in zip(kinds, found, strict=False) if "layouts" in each]
    table: dict[str, Any] = {}
    for i, size in enumerate(SIZES):
        for kind in (*dict.fromkeys(kind for kind, _ in kept), "all"):
            values = np.stack([each[i] for own, each in kept if kind in (own, "all")])
            least = values.min(axis=1, keepdims=True)
            ratio, wins = errors.ratio(values, least), np.mean(values == least, axis=0)
            table[f"{size}, {kind}"] = {
                name: {"wins": float(wins[j]), "ratio": float(ratio[:, j].mean())} for j, name in enumerate(LAYOUTS)
            }
    return table


def taps_compared(found: Sequence[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    """For each pattern and number of taps, the mean error over that with many taps, and the mean noise: the difference
    from many taps."""
    against = np.mean([errors.ratio(each["taps"][..., 0], each["many taps"][0]) for each in found], axis=0)
    noise = np.mean([each["taps"][..., 1] for each in found], axis=0)
    return {
        name: {str(taps): [float(against[i, j]), float(noise[i, j])] for j, taps in enumerate(TAPS)}
        for i, name in enumerate(PATTERNS)
    }


def show_layouts(console: Console, found: Mapping[str, Any]) -> None:
    """Prints how layouts compare."""
    table = Table("texels, scenes", *(f"{name}: wins, error" for name in LAYOUTS))
    for label, of in found.items():
        table.add_row(label, *(f"{each['wins']:.0%}, {each['ratio']:.2f}" for each in of.values()))
    console.print(table)


def show_taps(console: Console, found: Mapping[str, Any]) -> None:
    """Prints how patterns of taps compare."""
    table = Table("pattern", *(f"{taps} taps: error, noise" for taps in TAPS))
    for name, of in found.items():
        table.add_row(name, *(f"{error:.3f}, {noise:.4f}" for error, noise in of.values()))
    console.print(table)
