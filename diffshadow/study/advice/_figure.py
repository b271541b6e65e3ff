"""The figure of a recommendation: errors against times. This module loads Matplotlib, so import it only to draw."""

from collections.abc import Sequence
from typing import Any

from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .. import style
from ._candidates import Candidate, front


def draw_front(candidates: Sequence[Candidate], chosen: Candidate) -> Any:
    """Errors against times on logarithmic scales. Each bias has a colour, and each filter and size of map has a marker.

    The line joins the candidates that no other candidate beats in both. A ring marks the recommended candidate.
    """
    figure, (axes,) = style.figure(7.2, 4.2)
    style.chart(axes, "time of a view, relative to the fastest", "RMSE [visibility]")
    biases = list(dict.fromkeys(each.bias for each in candidates))
    kinds = list(dict.fromkeys((each.filter, each.size) for each in candidates))
    best = front(candidates)
    axes.plot([each.ratio for each in best], [each.rmse for each in best], color=style.FAINT, linewidth=1.2, zorder=1)
    for each in candidates:
        colour = style.CYCLE[biases.index(each.bias) % len(style.CYCLE)]
        marker = style.MARKERS[kinds.index((each.filter, each.size)) % len(style.MARKERS)]
        axes.plot([each.ratio], [each.rmse], linestyle="", markersize=6, color=colour, marker=marker)
    ring = {"marker": "o", "markersize": 14, "markerfacecolor": "none"}
    axes.plot([chosen.ratio], [chosen.rmse], linestyle="", color=style.INK, **ring)  # type: ignore[arg-type]
    for i, bias in enumerate(biases):
        axes.plot([], [], linestyle="-", linewidth=5, color=style.CYCLE[i % len(style.CYCLE)], label=style.label(bias))
    for i, (name, size) in enumerate(kinds):
        marker = style.MARKERS[i % len(style.MARKERS)]
        words = style.label(f"{name}, {size}")
        axes.plot([], [], linestyle="", marker=marker, color=style.FAINT, label=words)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    style.log_scale(axes)
    style.legend(axes, loc="upper left", bbox_to_anchor=(1.01, 1.0), handlelength=1.4, labelspacing=0.4)
    return figure
