"""How every figure looks: one set of colours, sizes and frames. Matplotlib's own settings are left alone."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure

INK, FAINT, PAPER = "#22272e", "#8b949e", "#ffffff"
NO_SURFACE = "#d5dce4"
"""Where a picture has nothing to show."""
# Okabe & Ito, "Color universal design", 2008: told apart by all kinds of colour vision.
BLUE, ORANGE, GREEN, VERMILION = "#0072b2", "#e69f00", "#009e73", "#d55e00"
DIFFERENCE = "PuOr"
"""Diverging and safe for the colour-blind: orange too dark, purple too light."""
DISTANCE = "cividis_r"
DPI = 150
_TITLE, _TEXT = 10, 8.5


def figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure of `width` by `height` inches, and its axes row by row."""
    made = Figure(figsize=(width, height), dpi=DPI, layout="constrained", facecolor=PAPER)
    FigureCanvasAgg(made)
    return made, list(made.subplots(rows, columns, squeeze=False).ravel())


def title(axes: Axes, text: str, below: str = "") -> None:
    """A title, and a fainter line of numbers under the axes."""
    axes.set_title(text, fontsize=_TITLE, color=INK, loc="left")
    if below:
        axes.set_xlabel(below, fontsize=_TEXT, color=INK, loc="left")


def picture(axes: Axes, image: Any, **options: Any) -> Any:
    """`image` with row 0 at the bottom, pixel by pixel, without ticks."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(FAINT)
        spine.set_linewidth(0.6)
    return axes.imshow(image, origin="lower", interpolation="nearest", **options)


def chart(axes: Axes, x: str, y: str) -> None:
    """Axes for curves, with what is along them and its unit."""
    axes.set_xlabel(x, fontsize=_TEXT, color=INK)
    axes.set_ylabel(y, fontsize=_TEXT, color=INK)
    axes.tick_params(labelsize=_TEXT, colors=INK, which="both")
    axes.grid(True, color="#e3e7ec", linewidth=0.6)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)


def colour_bar(figure: Figure, shown: Any, axes: list[Axes], label: str) -> Colorbar:
    """A colour bar beside `axes`."""
    bar = figure.colorbar(shown, ax=axes, shrink=0.9, aspect=28, pad=0.02)
    bar.set_label(label, fontsize=_TEXT, color=INK)
    bar.ax.tick_params(labelsize=_TEXT, colors=INK)
    bar.outline.set_edgecolor(FAINT)  # type: ignore[operator]
    bar.outline.set_linewidth(0.6)  # type: ignore[operator]
    return bar


def save(figure: Figure, path: Any) -> None:
    """Writes `figure` as a PNG without a date, so that equal figures are equal files."""
    figure.savefig(path, format="png", metadata={"Software": "diffshadow"})
