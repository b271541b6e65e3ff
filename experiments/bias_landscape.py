"""Acne against leaks: errors over constant bias and filter radius, and a fit's path through them.

    python experiments/bias_landscape.py configs/bias_landscape.yaml
    python experiments/bias_landscape.py configs/quickstart.yaml filter.samples=64 --size 65

Runs the fit of a configuration, then measures errors under the hard compare on a grid over the bounds of
`bias.constant` and `filter.radius`, with all other fitted parameters fixed at their fitted values. The errors are false
shadow (acne), false light (leaks, peter-panning) and the root mean square error (RMSE), over the pixels that both the
camera and the shadow map see.

The figure has a heat map of each error over bias and radius. The heat map of the RMSE shows the fit's path, with every
evaluation of its loss, from its start (diamond) to its result (star); a cross marks the grid's best point. The fourth
panel plots all points of the grid by false shadow and false light. Its line is the Pareto front: the settings for which
no other has less acne without more leaks.

The table and the summary compare the fit's result with the grid's best. A ratio above one means that the fit missed the
optimum, up to the grid's spacing; below one, the fit's result lies between the grid's points.
"""

import math
import time
from pathlib import Path
from typing import Any

import _common as common
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from rich.table import Table

from diffshadow import metrics
from diffshadow.console import Console
from diffshadow.fit import FitResult, TechniqueProblem, with_values

NAME = "bias_landscape"
AXES = (common.BIAS, common.RADIUS)
BIAS, RADIUS = "bias", "radius"
"""The table's names of the two axes, in texels."""
SHOWN = {
    "false_shadow": "False shadow (acne)",
    "false_light": "False light (leaks)",
    "rmse": "RMSE, and the fit's path",
}

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *overrides: str, size: int = 25) -> dict[str, Any]:
    """Fits CONFIG, and measures errors over its bias and radius.

    Parameters
    ----------
    config
        YAML file with the fit; both bias.constant and filter.radius must be among its parameters.
    overrides
        KEY=VALUE pairs that replace values of the file.
    size
        Points of the grid along each axis.
    """
    console = Console()
    common.expect("size", size, size > 1, "2 or more points along each axis")
    settings = common.load(config, overrides, needs=AXES)
    drawn = common.draw(settings)
    problem = common.problem_of(drawn)
    result = common.run_fit(settings, problem)

    bounds = [settings.fit.parameters[name] for name in AXES]
    biases, radii = (np.linspace(b.lower, b.upper, size) for b in bounds)
    started = time.perf_counter()
    rows = [
        {BIAS: float(bias), RADIUS: float(radius), **errors_at(problem, result, bias, radius)}
        for bias in common.progress(biases, "measuring", console)
        for radius in radii
    ]
    seconds = time.perf_counter() - started
    summary = summarise(problem, result, rows) | {
        "config": str(config),
        "overrides": list(overrides),
        "size": size,
        "spacing": [float(axis[1] - axis[0]) for axis in (biases, radii)],
        "pixels": int(problem.mask.sum()),
        "reference_noise": drawn.floor,
        "seconds_fit": result.seconds_compiling + result.seconds_running,
        "seconds_grid": seconds,
    }
    show(console, summary)
    folder = common.write(settings, NAME, picture(settings, rows, result, summary, (biases, radii)), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def errors_at(problem: TechniqueProblem, result: FitResult, bias: float, radius: float) -> dict[str, float]:
    """The errors under the hard compare with the two axes' parameters at `bias` and `radius`."""
    image = common.visibility(problem, with_values(result.technique, AXES, jnp.array([bias, radius], jnp.float32)))
    truth, mask = np.asarray(problem.reference), np.asarray(problem.mask)
    return {
        "false_shadow": metrics.false_shadow_rate(image, truth, mask),
        "false_light": metrics.false_light_rate(image, truth, mask),
        "rmse": metrics.rmse(image, truth, mask),
    }


def summarise(problem: TechniqueProblem, result: FitResult, rows: list[dict[str, float]]) -> dict[str, Any]:
    """The start, the fit and the grid's best, each with its errors."""

    def at(values: dict[str, float]) -> dict[str, float]:
        bias, radius = (values[name] for name in AXES)
        return {BIAS: bias, RADIUS: radius, **errors_at(problem, result, bias, radius)}

    fitted, best = at(result.fitted), min(rows, key=lambda row: row["rmse"])
    # The start has all parameters at their initial values, not only these two.
    began = with_values(result.technique, tuple(result.initial), jnp.array(list(result.initial.values()), jnp.float32))
    return {
        "start": at(result.initial) | {"rmse": common.rmse(problem, began)},
        "fit": fitted,
        "grid": best,
        "ratio": fitted["rmse"] / best["rmse"] if best["rmse"] > 0 else None,
        "held": {name: value for name, value in result.fitted.items() if name not in AXES},
        "flat": result.flat,
        "steps": result.steps,
        "chosen_phase": result.chosen,
    }


def show(console: Console, summary: dict[str, Any]) -> None:
    """The table."""
    title = f"hard compare, {summary['pixels']:,} pixels, texels; reference noise {summary['reference_noise']:.2g}"
    heads = ("bias", "radius", "false shadow", "false light", "RMSE", "seconds")
    table = Table("", *heads, title=title, title_justify="left")
    for name, label, seconds in (
        ("start", "start", ""),
        ("fit", f"fit, {summary['steps']} steps", f"{summary['seconds_fit']:.1f}"),
        ("grid", f"grid of {summary['size']} x {summary['size']}", f"{summary['seconds_grid']:.1f}"),
    ):
        row = summary[name]
        rates = (f"{row[key]:.3%}" for key in ("false_shadow", "false_light"))
        table.add_row(label, f"{row[BIAS]:.4g}", f"{row[RADIUS]:.4g}", *rates, f"{row['rmse']:.5f}", seconds)
    if summary["ratio"] is not None:
        table.add_row("fit / grid", "", "", "", "", f"{summary['ratio']:.4f}", "")
    table.add_row("grid's spacing", *(f"{step:.3g}" for step in summary["spacing"]), "", "", "", "")
    console.print(table)
    if summary["held"]:
        console.print("fixed on the grid at their fitted values:", summary["held"])
    if summary["flat"]:
        console.print("without a gradient, not fitted:", ", ".join(summary["flat"]))


def picture(
    settings: Any, rows: list[dict[str, float]], result: FitResult, summary: dict[str, Any], axes: tuple[Any, Any]
) -> Any:
    """The figure."""
    made, panels = common.figure(8.6, 7.0, 2, 2)
    one = 1 / summary["pixels"]
    for panel, (key, title) in zip(panels, SHOWN.items(), strict=False):
        values = np.array([row[key] for row in rows]).reshape(len(axes[0]), len(axes[1])).T
        least = max(float(values.min()), one)
        norm = LogNorm(least, max(float(values.max()), 1.01 * least))
        shown = panel.pcolormesh(*axes, np.maximum(values, least), norm=norm, cmap=common.HEAT, shading="nearest")
        common.colour_bar(made, shown, [panel], "RMSE [visibility]" if key == "rmse" else "fraction of pixels")
        common.chart(panel, title, "constant bias [texels]", "radius [texels]", grid=False)
    path(panels[2], list(settings.fit.parameters), result, summary)
    front(panels[3], rows, summary)
    return made


def path(axes: Axes, names: list[str], result: FitResult, summary: dict[str, Any]) -> None:
    """The fit's evaluations, its start and its end, and the grid's best."""
    limits = axes.get_xlim(), axes.get_ylim()
    start = [result.initial[name] for name in AXES]
    steps = np.array([start, *([step.values[names.index(name)] for name in AXES] for step in result.history)])
    axes.plot(*steps.T, color="white", linewidth=2.6, alpha=0.8)
    axes.plot(*steps.T, color=common.COLOURS[1], linewidth=1.2, marker=".", markersize=4)
    marks = {"start": "D", "grid": "x", "fit": "*"}
    for name, mark in marks.items():
        size = 12 if name == "fit" else 6
        point(axes, summary[name][BIAS], summary[name][RADIUS], mark, size, "grid's best" if name == "grid" else name)
    axes.set(xlim=limits[0], ylim=limits[1])
    common.legend(axes, loc="upper right", frameon=True, framealpha=0.85)


def front(axes: Axes, rows: list[dict[str, float]], summary: dict[str, Any]) -> None:
    """All points of the grid by false shadow and false light, and their Pareto front."""
    x, y = (np.array([row[key] for row in rows]) for key in ("false_shadow", "false_light"))
    shown = axes.scatter(x, y, c=[row[BIAS] for row in rows], s=9, cmap=common.HEAT, linewidth=0)
    kept = common.pareto(list(x), list(y))
    axes.plot(x[kept], y[kept], color=common.INK, linewidth=1.0, label="Pareto front")
    for name, mark in {"start": "D", "fit": "*"}.items():
        point(axes, summary[name]["false_shadow"], summary[name]["false_light"], mark, 12 if name == "fit" else 6, name)
    # Linear below about one pixel, so that 0 can be shown, and logarithmic above.
    decade = 10.0 ** math.floor(-math.log10(summary["pixels"]))
    axes.set_xscale("symlog", linthresh=decade, linscale=0.8)
    axes.set_yscale("symlog", linthresh=decade, linscale=0.8)
    common.colour_bar(axes.figure, shown, [axes], "constant bias [texels]")  # type: ignore[arg-type]
    common.chart(axes, "Acne against leaks", "false shadow [fraction of pixels]", "false light [fraction of pixels]")
    common.legend(axes, loc="best")


def point(axes: Axes, x: float, y: float, mark: str, size: float, label: str) -> None:
    """One marked point."""
    edge = {} if mark == "x" else {"markeredgecolor": "white", "markeredgewidth": 0.8}
    colour = common.INK if mark == "x" else common.COLOURS[1]
    axes.plot(x, y, mark, color=colour, markersize=size, linestyle="none", label=label, zorder=5, clip_on=False, **edge)


if __name__ == "__main__":
    common.start(app)
