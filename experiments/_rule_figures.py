"""Figures of a collection of scenes, and of what rules are worth over it."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import _collection as collection
import _common as common
import _rule_errors as errors
import _rules as rules
import numpy as np
from matplotlib.figure import Figure

from diffshadow import shadow
from diffshadow.config import parse_config
from diffshadow.study import style

_SHOWN, _WORST = "bilinear", 3
# Colours of the same meaning in both panels.
_NONE, _RULE, _FITTED, _OWN = (common.COLOURS[i] for i in (1, 0, 2, 3))


def of_collection(drawn: collection.Collection, pixels: int, described: np.ndarray) -> Figure:
    """A scene of each kind, as rays see its shadows, and how what rules may depend on is spread over all scenes."""
    kinds = drawn.kinds
    made, panels = common.figure(1.6 * len(kinds), 4.6, 2, len(kinds))
    for i, (panel, kind) in enumerate(zip(panels[: len(kinds)], kinds, strict=True)):
        case = common.draw(parse_config(json.dumps(drawn.scene(i, pixels)), source=kind))
        image = np.where(case.truth.mask, 0.15 + 0.85 * np.asarray(case.truth.visibility), 0.6)
        panel.imshow(image, cmap="gray", vmin=0, vmax=1, origin="lower")
        common.chart(panel, kind, "", "", grid=False)
        panel.set_xticks([])
        panel.set_yticks([])
    numbers = dict(zip(errors.DESCRIBED, described.T, strict=True))
    suns = numbers["perspective"] == 0
    steepness = np.maximum(numbers["steepness"], 0.03)
    shown: Sequence[tuple[str, str, np.ndarray, np.ndarray]] = [
        ("Maps", "texels a side", numbers["texels"], 2 ** np.arange(7.5, 13)),
        ("Texels on the screen", "pixels", numbers["pixels_per_texel"], _spread(numbers["pixels_per_texel"])),
        ("Slopes", "median tangent", steepness, _spread(steepness)),
        ("Suns", "degrees high", numbers["elevation"][suns], np.arange(0, 91, 10)),
        ("Lit", "share of the pixels", numbers["lit"], np.linspace(0, 1, 11)),
    ]
    below = panels[len(kinds) :]
    for panel in below[len(shown) :]:
        panel.set_axis_off()
    for panel, (title, unit, values, bins) in zip(below, shown, strict=False):
        panel.hist(values, bins=bins.tolist(), color=common.COLOURS[0])
        common.chart(panel, title, unit, "scenes" if panel is below[0] else "")
        if title in ("Maps", "Texels on the screen", "Slopes"):
            panel.set_xscale("log", base=2)
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:.2g}" if value < 10 else f"{value:g}")
            panel.tick_params(axis="x", labelsize=7)
    return made


def _spread(values: np.ndarray) -> np.ndarray:
    """Bins of equal ratios."""
    return np.geomspace(values.min(), values.max() * 1.001, 13)


def of_rules(result: Mapping[str, Any]) -> Figure:
    """What rules and fits are worth for each filter."""
    made, panels = common.figure(8.0, 4.4, 1, 2)
    filters = {name: found for name, found in result["filters"].items() if not name.endswith(errors.PLANE)}
    rows = {
        "constant alone": (_NONE, {name: found["rules"]["constant"]["tested"] for name, found in filters.items()}),
        "constant + slope": (_RULE, {name: of["rules"]["constant + slope"]["tested"] for name, of in filters.items()}),
        "best for each scene": (_FITTED, {name: found["fitted"] for name, found in filters.items()}),
    }
    _dots(panels[0], "Price of a rule, by filter", "mean error over the best bias for each scene", rows, "price")
    _dots(panels[1], "Scenes with acne, by filter", "share of the scenes", rows, "acne")
    common.legend(panels[1])
    return made


def of_worst(drawn: collection.Collection, result: Mapping[str, Any], measured: rules.Measured) -> Figure:
    """The three scenes in which the rule for a filter costs most: their shadows as rays see them, with the rule, and
    with the best bias."""
    capped = measured.capped(_SHOWN, np.array(result["rules"][_SHOWN]["bias"]))
    price = errors.ratio(measured.at(_SHOWN, capped)[:, 0], measured.best(_SHOWN))
    made, panels = common.figure(7.2, 7.8, _WORST, 3)
    for row, index in enumerate(np.argsort(-price, kind="stable")[:_WORST]):
        case = common.draw(parse_config(json.dumps(drawn.scene(int(index), 2 * result["pixels"]))))
        _, shadow_map, covered = errors.plain_map(case)
        of_scene = measured.errors[_SHOWN][index][..., 0].ravel()
        biases = (capped[index], errors.grid_of(_SHOWN)[of_scene.argmin()])
        pictures = [np.asarray(case.truth.visibility)]
        for constant, slope, offset in biases:
            technique = shadow.ShadowMapping(errors.FILTERS[_SHOWN].filter, shadow.Bias(constant, slope, offset))
            pictures.append(np.asarray(technique.visibility(shadow_map, case.surface)))
        says = lambda bias: ", ".join(f"{x:.2g}" for x in bias)
        titles = (
            f"{drawn.kind(int(index))}, {case.settings.shadow_map.resolution[0]}²: rays",
            f"rule {says(biases[0])}: price {price[index]:.2f}",
            f"best {says(biases[1])}",
        )
        for panel, picture, title in zip(panels[3 * row : 3 * row + 3], pictures, titles, strict=True):
            panel.imshow(np.where(covered, 0.15 + 0.85 * picture, 0.6), cmap="gray", vmin=0, vmax=1, origin="lower")
            common.chart(panel, title, "", "", grid=False)
            panel.set_xticks([])
            panel.set_yticks([])
    return made


def _dots(panel: Any, title: str, unit: str, rows: Mapping[str, tuple[str, Mapping[str, Any]]], key: str) -> None:
    names = list(next(iter(rows.values()))[1])
    for label, (colour, of) in rows.items():
        panel.plot([of[name][key] for name in names], range(len(names)), "o", color=colour, label=label, markersize=6)
    panel.set_yticks(range(len(names)), names)
    panel.invert_yaxis()
    common.chart(panel, title, unit, "")
    if key == "acne":
        panel.set_xlim(-0.03, 1.03)
        panel.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    style.frame(panel)
