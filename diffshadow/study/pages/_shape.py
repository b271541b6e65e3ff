"""The page of a fit of a shape, made of its folder's files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from ... import io
from ..._types import HostArray
from ...config import CONFIG_FILE, load_config
from .. import style
from ..files._stored import ARRAYS, REPORT, read_result
from ._next import after_shape
from ._page import data_uri, picture, sentences_of, write_page

TURNTABLE, PROGRESS = "turntable.webp", "progress.webp"
_SHOWN = {
    TURNTABLE: "The fitted shape from all sides. Faces that are seen from behind are blue.",
    PROGRESS: "The shape as it was fitted.",
}
_CURVE = "loss"


def report_shape(folder: Path, form: str | None = None, dpi: int | None = None) -> Path:
    """Writes the page of the fit of a shape in `folder`, and the curve of its loss if a format `form` is given.

    **Returns** the page. **Raises** `FileError` if a file of the run is missing or damaged.
    """
    result = read_result(folder)
    shape = load_config(folder / CONFIG_FILE, [], files=False).fit.shape
    if shape is None:
        raise io.FileError(f"{folder / CONFIG_FILE} has no fit.shape; expected the run's own: run it again")
    measured, (height, width) = result["metrics"], shape.resolution
    count = len(measured["lights"])
    images = io.ArrayLayout("f", (count, height, width), bytes=4)
    history = {"history_phase": io.ArrayLayout("iu", (None,)), "history_loss": io.ArrayLayout("f", (None,), bytes=4)}
    arrays = io.read_arrays(folder / ARRAYS, {**dict.fromkeys(("reference", "before", "after"), images), **history})
    if form is not None:
        style.save(_loss(result, arrays), folder / f"{_CURVE}.{form}", dpi or style.DPI)
    write_page(
        folder / REPORT,
        "shape.html.j2",
        name=result["name"],
        # An older run has no verdict.
        summary=sentences_of(result),
        warnings=result.get("warnings") or [],
        lights=[_light(arrays, i, light) for i, light in enumerate(measured["lights"])],
        unseen=measured.get("unseen", []),
        moved=measured.get("moved", []),
        phases=result["phases"],
        chosen=result["chosen_phase"],
        loss=style.inline_svg(_loss(result, arrays), _CURVE),
        animations=[
            (Markup(data_uri((folder / file).read_bytes(), ".webp")), text)
            for file, text in _SHOWN.items()
            if (folder / file).is_file()
        ],
        vertices=result["vertices"],
        commands=after_shape(folder, result["command"]),
        environment=[(name, value, "") for name, value in {**result["versions"], "seed": result["seed"]}.items()],
        seconds=[(name, f"{value:.2f}", "s") for name, value in result["seconds"].items()],
    )
    return folder / REPORT


def _light(arrays: Mapping[str, HostArray], number: int, light: Mapping[str, Any]) -> dict[str, Any]:
    key = light["light"]
    shown = [("Target", "reference", ""), ("Before", "before", light["before"]), ("After", "after", light["map"])]
    note = lambda overlap: f"IoU {overlap:.4f}" if overlap != "" else ""
    pictures = [
        picture(f"{title}, {key}", np.clip(arrays[name][number], 0, 1), note(overlap), title=title)
        for title, name, overlap in shown
    ]
    return {**light, "pictures": pictures}


def _loss(result: Mapping[str, Any], arrays: Mapping[str, HostArray]) -> Figure:
    """The loss at each step, and the judge's at the ends of phases."""
    figure, (axes,) = style.figure(6.4, 3.1)
    style.chart(axes, "step", "RMSE [visibility]")
    error, phase = np.sqrt(np.maximum(arrays["history_loss"], 0)), arrays["history_phase"]
    axes.plot(error, color=style.BLUE, linewidth=1.4, label="blurred")
    ends = [0, *np.cumsum([int((phase == k).sum()) for k in range(len(result["phases"]))])]
    judged = [result["metrics"]["initial_loss"], *(each["loss"] for each in result["phases"])]
    marks: Any = {"color": style.VERMILION, "marker": "D", "markersize": 5, "linestyle": "none", "zorder": 3}
    axes.plot(ends[: len(judged)], np.sqrt(judged), label="judge, without a blur", markerfacecolor=style.PAPER, **marks)
    style.log_scale(axes)
    style.legend(axes)
    return figure
