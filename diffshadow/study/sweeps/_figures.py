"""The figure of a sweep. This module loads Matplotlib, so import it only to draw figures."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ...config import FLICKER, LIMIT_ERROR, PlotConfig, Row
from .. import style
from ._curves import Curve, with_unit

_WIDTH, _HEIGHT = 4.1, 3.9
# The most panels in a row.
_MAX_COLUMNS = 3
_METRICS = {
    "rmse": "RMSE [visibility]",
    "mae": "mean absolute error [visibility]",
    "ssim": "SSIM",
    FLICKER: "flicker [visibility]",
    LIMIT_ERROR: "RMSE against the filter's limit [visibility]",
}


def write_plot(path: Path, curves: Sequence[Curve], plot: PlotConfig, settings: Sequence[Row]) -> None:
    """Draws the curves, with one panel per value of `plot.panels` and slopes in the legends.

    **Arguments:**

    - `path`: the file to write.
    - `curves`: the curves to draw.
    - `plot`: the settings of the figure.
    - `settings`: the settings of any of the runs, for the axis' unit.
    """
    names = with_unit(settings, plot.x), _metric(plot.y)
    panels = list(dict.fromkeys(curve.panel for curve in curves))
    lines = list(dict.fromkeys(curve.line for curve in curves))
    columns = min(len(panels), _MAX_COLUMNS)
    rows = -(-len(panels) // columns)
    figure, axes = style.figure(_WIDTH * columns, _HEIGHT * rows, rows, columns, sharey=True)
    for number, (one, panel) in enumerate(zip(axes, panels, strict=False)):
        style.chart(one, names[0], names[1] if number % columns == 0 else "")
        style.title(one, panel)
        shown = [curve for curve in curves if curve.panel == panel]
        for curve in shown:
            one.plot(curve.x, curve.y, label=style.label(_label(curve)), **style.curve(lines.index(curve.line)))
        _scale(one, shown, plot)
        if any(curve.line for curve in shown):
            title = plot.lines if all(curve.slope is None for curve in shown) else f"{plot.lines}: slope"
            style.legend(one, title=title, title_fontsize=8.5, handlelength=1.6, labelspacing=0.3)
    for one in axes[len(panels) :]:
        one.set_visible(False)
    style.save(figure, path)


def _metric(name: str) -> str:
    """A metric's name with its unit. Metrics of a fit begin with `before.` or `after.`."""
    when, _, metric = name.rpartition(".")
    if metric not in _METRICS:
        return name
    return f"{when}: {_METRICS[metric]}" if when else _METRICS[metric]


def _label(curve: Curve) -> str:
    if curve.slope is None:
        return curve.line
    slope = f"{curve.slope:.3f}".replace("-", "−")
    return f"{curve.line}: {slope}" if curve.error is None else f"{curve.line}: {slope} ± {curve.error:.3f}"


def _scale(axes: style.Axes, curves: Sequence[Curve], plot: PlotConfig) -> None:
    places = sorted({float(x) for curve in curves for x in curve.x})
    ticks = curves[0].ticks
    if ticks is not None:
        style.ticks(axes, ticks)
    elif plot.log and places[0] > 0:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(places))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
    if plot.log and min(float(curve.y.min()) for curve in curves) > 0:
        style.log_scale(axes)
