"""The style of all figures and pages: colours, sizes and frames. Matplotlib's global settings are not changed."""

import contextlib
import io
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .._types import HostArray
from ..config import printable

INK, FAINT, GRID, BAND, PAPER = "#22272e", "#8b949e", "#e3e7ec", "#f1f4f8", "#ffffff"
NO_SURFACE = "#d5dce4"
"""The colour of pixels without a surface."""
# Okabe & Ito, "Color universal design", 2008: distinguishable with all kinds of colour vision.
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""The colours of curves. Further curves repeat the colours with other dashes: see `dashes`."""
THEME = {
    "ink": (INK, "#e3e7ec"),
    "faint": (FAINT, "#7d8794"),
    "grid": (GRID, "#303843"),
    "band": (BAND, "#262d37"),
    "card": (PAPER, "#1a2027"),
    "blue": (BLUE, "#5fb4ea"),
    "vermilion": (VERMILION, "#f58a4b"),
    "green": (GREEN, "#3cc79f"),
    "purple": (PURPLE, "#e0a0c4"),
    "orange": (ORANGE, "#f0b73c"),
    "sky": (SKY, "#9ad4f5"),
    "page": ("#f6f7f9", "#12161b"),
    "line": ("#d9dfe6", "#333c47"),
    "muted": ("#5b6570", "#9aa4af"),
}
"""The colours of a page and of the curves in it, by name: for the light and the dark theme."""
MARKERS = ("o", "s", "D", "^", "v", "P")
DIFFERENCE = "PuOr"
"""A diverging colour map that is safe for the colour-blind: orange is too dark, and purple is too light."""
DISTANCE = "cividis_r"
DPI = 150
TITLE, TEXT = 10, 8.5
# Embeds TrueType fonts in PDF, because many publishers reject Type 3, and makes ids in SVG the same in every run.
_VECTOR: Any = {"svg.fonttype": "none", "svg.hashsalt": "diffshadow", "pdf.fonttype": 42}


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure of `width` by `height` inches, and its axes in row-major order."""
    made = Figure(figsize=(width, height), dpi=DPI, layout="constrained", facecolor=PAPER)
    FigureCanvasAgg(made)
    return made, list(made.subplots(rows, columns, squeeze=False, **options).ravel())


def title(axes: Axes, text: str, below: str = "") -> None:
    """Sets the title, and a line of text under the axes."""
    axes.set_title(printable(text), fontsize=TITLE, color=INK, loc="left", parse_math=False)
    if below:
        axes.set_xlabel(printable(below), fontsize=TEXT, color=INK, loc="left", parse_math=False)


def heading(axes: Axes, words: str, above: int) -> None:
    """Sets the title of one chart among several, `above` points over it."""
    axes.set_title(printable(words), fontsize=TEXT, color=INK, loc="left", pad=above, parse_math=False)


def text(axes: Axes, x: float, words: str) -> None:
    """Writes words above a chart, centred at `x`."""
    place = axes.get_xaxis_transform()
    look = {"fontsize": TEXT, "color": INK, "parse_math": False}
    axes.text(x, 1.01, printable(words), transform=place, ha="center", va="bottom", **look)


def label(words: str) -> str:
    """The label of a curve. Matplotlib omits labels that begin with `_` from legends, so these get a leading space."""
    return f" {printable(words)}" if words.startswith("_") else printable(words)


def ticks(axes: Axes, words: Sequence[str]) -> None:
    """Writes words along the x-axis, at 0, 1 and so on."""
    axes.set_xticks(range(len(words)), [printable(word) for word in words], parse_math=False)


def picture(axes: Axes, image: Any, **options: Any) -> Any:
    """Draws `image` with row 0 at the bottom, without interpolation and ticks."""
    axes.set_xticks([])
    axes.set_yticks([])
    frame(axes)
    return axes.imshow(image, origin="lower", interpolation="nearest", **options)


def chart(axes: Axes, x: str, y: str) -> None:
    """Prepares axes for curves, with labels `x` and `y`."""
    axes.set_facecolor(PAPER)
    axes.set_xlabel(printable(x), fontsize=TEXT, color=INK, parse_math=False)
    axes.set_ylabel(printable(y), fontsize=TEXT, color=INK, parse_math=False)
    axes.tick_params(labelsize=TEXT, color=FAINT, labelcolor=INK, which="both")
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)


def frame(axes: Axes) -> None:
    """Draws a thin frame around a picture."""
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(FAINT)
        spine.set_linewidth(0.6)


def log_scale(axes: Axes) -> None:
    """Makes the y-axis logarithmic, with plain numbers as ticks, even within one decade."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def legend(axes: Axes, **options: Any) -> None:
    """Adds a legend without a frame."""
    made = axes.legend(fontsize=TEXT, labelcolor=INK, frameon=False, **options)
    made.get_title().set_color(INK)
    for words in (made.get_title(), *made.get_texts()):
        words.set_parse_math(False)


def dashes(index: int) -> str:
    """The dashes of the curve at `index`; they change each time `CYCLE` repeats."""
    return ("-", "--", ":", "-.")[index // len(CYCLE) % 4]


def curve(index: int) -> dict[str, Any]:
    """Colour, marker and dashes of the curve at `index`, as arguments of `Axes.plot`."""
    colour, marker = CYCLE[index % len(CYCLE)], MARKERS[index % len(MARKERS)]
    return {"color": colour, "marker": marker, "linestyle": dashes(index), "markersize": 4, "linewidth": 1.3}


def colour_bar(figure: Figure, shown: Any, axes: list[Axes], label: str, **options: Any) -> Colorbar:
    """Adds a colour bar next to `axes`."""
    bar = figure.colorbar(shown, ax=axes, shrink=0.9, aspect=28, pad=0.02, **options)
    bar.set_label(label, fontsize=TEXT, color=INK)
    bar.ax.tick_params(labelsize=TEXT, color=FAINT, labelcolor=INK, which="both")
    bar.outline.set_edgecolor(FAINT)  # type: ignore[operator]
    bar.outline.set_linewidth(0.6)  # type: ignore[operator]
    return bar


def save(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Writes `figure` in the format of the suffix, without a date, so that equal figures give equal files.

    `dpi` is in pixels per inch; in SVG and PDF it applies to embedded images only.
    """
    form = path.suffix.removeprefix(".")
    options: dict[str, Any] = {
        # Half the time of the default level. Charts take a tenth more bytes, and pictures a tenth fewer.
        "png": {"metadata": {"Software": "diffshadow"}, "pil_kwargs": {"compress_level": 3}},
        "svg": {"metadata": {"Date": None}},
        "pdf": {"metadata": {"CreationDate": None}},
    }
    with rc_context(_VECTOR), _without_glyphs():
        _lay_out(figure)
        figure.savefig(path, format=form, dpi=dpi, **options[form])


def _lay_out(figure: Figure) -> None:
    """Finalizes the layout of `figure`. Otherwise Matplotlib draws it an extra time in each format."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


@contextlib.contextmanager
def _without_glyphs() -> Iterator[None]:
    """Silences warnings about characters that Matplotlib's font lacks; these are drawn as boxes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph .* missing from font")
        yield


def inline_svg(figure: Figure, name: str) -> str:
    """A figure as an `<svg>` for a page, with colours that follow the page's theme. `name` is unique on the page."""
    out = io.StringIO()
    with rc_context({**_VECTOR, "svg.hashsalt": name}), _without_glyphs():
        _lay_out(figure)
        figure.savefig(out, format="svg", metadata={"Date": None})
    return themed(out.getvalue())


def themed(svg: str) -> str:
    """The text of Matplotlib's SVG file as an `<svg>` for a page, with colours that follow the page's theme."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    # Matplotlib numbers ids from 1 in each figure; keep only the ids that are referred to.
    svg = re.sub(r' id="([^"]*)"', lambda found: found[0] if f"#{found[1]}" in svg else "", svg)
    for name, (colour, _) in THEME.items():
        svg = svg.replace(colour, f"var(--{name})")
    return svg


def png(image: HostArray, colours: str = "gray", low: float = 0.0, high: float = 1.0) -> bytes:
    """Encodes `image`, (h, w) in `colours` from `low` to `high` or (h, w, 3), as a PNG with one pixel per pixel.

    NaN pixels get the colour `NO_SURFACE`.
    """
    out = io.BytesIO()
    colour_map = colormaps[colours].with_extremes(bad=NO_SURFACE)
    shown = np.ma.masked_invalid(image) if image.ndim == 2 else image
    imsave(out, shown, origin="lower", cmap=colour_map, vmin=low, vmax=high, format="png")
    return out.getvalue()


def gradient(colours: str) -> str:
    """A CSS gradient of `colours` from left to right."""
    stops = ", ".join(to_hex(colour) for colour in colormaps[colours](np.linspace(0, 1, 9)))
    return f"linear-gradient(to right, {stops})"
