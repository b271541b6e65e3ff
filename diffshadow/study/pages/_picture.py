"""The page of a fit to a picture, made of its folder's files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ... import io
from ..._checks import text_within
from ..._types import HostArray
from ..._words import counted
from ...shading import to_srgb
from .. import style
from ..files._stored import ARRAYS, PICTURE_STATES, REPORT, read_result
from ._next import after_shape
from ._page import picture, sentences_of, write_page
from ._table import UNEXPLAINED

_CURVE = "loss"
_TITLES = dict(zip(PICTURE_STATES, ("Reference", "Before", "After"), strict=True))
_ERRORS = (("rmse", "RMSE"), ("mae", "MAE"), ("flip", "FLIP"))


def report_picture(folder: Path, form: str | None = None, dpi: int | None = None) -> Path:
    """Writes the page of the fit to a picture in `folder`, and the curve of its error if a format `form` is given.

    **Returns** the page. **Raises** `FileError` if a file of the run is missing or damaged.
    """
    result = read_result(folder)
    measured = result["metrics"]
    height, width = measured["resolution"]
    layouts = {
        **dict.fromkeys(PICTURE_STATES, io.ArrayLayout("f", (height, width, 3), bytes=4)),
        "mask": io.ArrayLayout("b", (height, width)),
        "history_phase": io.ArrayLayout("iu", (None,)),
        "history_loss": io.ArrayLayout("f", (None,), bytes=4),
    }
    arrays = io.read_arrays(folder / ARRAYS, layouts)
    if form is not None:
        style.save(_loss(arrays), folder / f"{_CURVE}.{form}", dpi or style.DPI)
    write_page(
        folder / REPORT,
        "picture.html.j2",
        name=result["name"],
        summary=_summary(result),
        is_explained=(result.get("verdict") or {}).get("kind") != UNEXPLAINED,
        warnings=result.get("warnings", []),
        pictures=[_shown(arrays, result, state) for state in PICTURE_STATES],
        differences=[_difference(arrays, state) for state in PICTURE_STATES[1:]],
        slides=[_TITLES[state] for state in ("reference", "after")],
        fitted=[_row(name, result) for name in result["fitted"]],
        errors=[
            (title, *(f"{measured[state][key]:.4f}" for state in PICTURE_STATES[1:]))
            for key, title in _ERRORS
            if measured["after"].get(key) is not None
        ],
        camera=[(key, ", ".join(f"{x:.5g}" for x in value), "") for key, value in result["camera"].items()],
        loss=style.inline_svg(_loss(arrays), _CURVE),
        commands=after_shape(folder, result["command"]) if "command" in result else [],
        environment=[(key, value, "") for key, value in result["versions"].items()],
        seconds=[(key, f"{value:.2f}", "s") for key, value in result["seconds"].items()],
    )
    return folder / REPORT


def _summary(result: Mapping[str, Any]) -> list[str]:
    """The verdict on the fit, sentence by sentence, and what its errors are of."""
    before, after = (result["metrics"][state]["rmse"] for state in PICTURE_STATES[1:])
    fell = f"The picture's error went from {before:.4f} to {after:.4f} RMSE, in {counted(result['steps'], 'step')}."
    colours = "sRGB" if result["encoding"] == "srgb" else "linear"
    return [
        # An older run has no verdict.
        *(sentences_of(result) or [fell]),
        f"Errors are of {colours} colours, over {counted(result['metrics']['pixels'], 'pixel')}.",
    ]


def _shown(arrays: Mapping[str, HostArray], result: Mapping[str, Any], state: Any) -> Any:
    image = np.clip(arrays[state], 0, 1)
    seen = image if result["encoding"] == "srgb" else to_srgb(image)
    errors = result["metrics"].get(state)
    return picture(_TITLES[state], seen, f"RMSE {errors['rmse']:.4f}" if errors else "")


def _difference(arrays: Mapping[str, HostArray], state: Any) -> Any:
    """The mean difference of the channels, where it counts."""
    difference = np.where(arrays["mask"], (arrays[state] - arrays["reference"]).mean(axis=-1), 0)
    name = f"{_TITLES[state]} − reference"
    return picture(name, difference, "from −0.25 to 0.25", colours=style.DIFFERENCE, limit=0.25)._replace(slides=False)


def _row(name: str, result: Mapping[str, Any]) -> dict[str, str]:
    bounds = result["bounds"][name]
    text = lambda value: text_within(value, bounds["lower"], bounds["upper"], 5)
    deviation = result["deviations"].get(name)
    return {
        "name": name,
        "initial": text(result["initial"][name]),
        "fitted": text(result["fitted"][name]),
        "deviation": "" if deviation is None else f"± {deviation:.2g}",
        "truth": text(result["truth"][name]) if name in result["truth"] else "",
        "unit": bounds["unit"],
    }


def _loss(arrays: Mapping[str, HostArray]) -> Figure:
    """The error at each evaluation, one colour a phase."""
    figure, (axes,) = style.figure(6.4, 3.1)
    style.chart(axes, "evaluation", "RMSE under the blur")
    error, phase = np.sqrt(np.maximum(arrays["history_loss"], 0)), arrays["history_phase"]
    for number in np.unique(phase):
        at = np.flatnonzero(phase == number)
        axes.plot(at, error[at], linewidth=1.4, marker="o", markersize=3, label=f"phase {number + 1}")
    style.log_scale(axes)
    style.legend(axes)
    return figure
