"""One set of values for many views: is a joint fit the best there is, and does it generalise?

    python experiments/many_views.py configs/many_views.yaml
    python experiments/many_views.py configs/many_views.yaml --over mean --size 9

Fits bias and radius jointly to all views of a configuration (`fit.views`), once for each loss: the mean square error
over all pixels, and that of the worst view. Every view is then measured under the hard compare on a grid over the
bounds of both parameters. A ratio of the fit's error to the grid's least above one means that the fit missed the
optimum, up to the grid's spacing; below one, the fit's result lies between the grid's points.

Each view is also fitted alone. All fitted values are measured on the views of `fit.validation`, which no fit has seen:
the mean of the root mean square errors (RMSE) of these views, and the greatest. The row of single views has the mean of
both over all single views. The last row is the point of the grid that is best for the validation itself, which no fit
of other views can know.

The figure has a heat map of each loss over bias and radius, with the grid's best (cross), the joint fit (star) and the
start (diamond). The last panel has the mean error over the validation, and a point for the fit of each single view.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from rich.table import Table

from diffshadow.config import FitView, load_config
from diffshadow.console import Console
from diffshadow.fit import TechniqueProblem, with_values

NAME = "many_views"
AXES = (common.BIAS, common.RADIUS)
OVER = {"mean": "over all pixels", "worst": "of the worst view"}
"""The losses, by their names in a configuration."""

Values = tuple[float, float]
"""A bias and a radius, in texels."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


class Views(NamedTuple):
    """Views, each a problem, by name."""

    problems: dict[str, TechniqueProblem]

    def at(self, values: Values) -> Float[np.ndarray, " v"]:
        """The RMSE of each view under the hard compare."""
        technique = with_values(next(iter(self.problems.values())).technique, AXES, jnp.array(values, jnp.float32))
        return np.array([common.rmse(problem, technique) for problem in self.problems.values()])

    def over_all(self, errors: Float[np.ndarray, "*n v"], over: str) -> Float[np.ndarray, "*n"]:
        """The root of a loss of the RMSEs of the views."""
        pixels = np.array([float(problem.count) for problem in self.problems.values()])
        return errors.max(-1) if over == "worst" else np.sqrt(np.average(errors**2, axis=-1, weights=pixels))


@app.default
def main(config: Path, /, *overrides: str, over: str = "mean,worst", size: int = 33) -> dict[str, Any]:
    """Fits the views of CONFIG jointly and one by one, and measures them on a grid.

    Parameters
    ----------
    config
        YAML file with the fit, which must have views and a validation, and fit bias.constant and filter.radius alone.
    overrides
        KEY=VALUE pairs that replace values of the file.
    over
        The losses, separated by commas: mean, worst.
    size
        Points of the grid along each axis.
    """
    console = Console()
    losses = common.chosen("over", over, OVER)
    common.expect("size", size, size > 1, "2 or more points along each axis")
    settings = common.load(config, overrides, needs=AXES)
    if len(settings.fit.parameters) > len(AXES):
        raise common.mistake(settings, "fit.parameters", f"has others; expected {' and '.join(AXES)} alone")
    for kind in ("views", "validation"):
        if getattr(settings.fit, kind) is None:
            raise common.mistake(settings, f"fit.{kind}", "is missing; expected views: add a section of axes")
    seen, unseen = drawn(settings.views, "views", console), drawn(settings.validation, "validation", console)

    problems = list(seen.problems.values())
    joint = {}
    for name in common.progress(losses, "fitting jointly", console):
        found = common.run_fit(load_config(config, [*overrides, f"fit.loss.over={name}"]), problems)
        joint[name] = found.fitted[AXES[0]], found.fitted[AXES[1]]
    alone = {}
    for name, problem in common.progress(seen.problems.items(), "fitting one by one", console):
        found = common.run_fit(settings, problem)
        alone[name] = found.fitted[AXES[0]], found.fitted[AXES[1]]

    bounds = [settings.fit.parameters[name] for name in AXES]
    biases, radii = (np.linspace(b.lower, b.upper, size) for b in bounds)
    grid = [(float(bias), float(radius)) for bias in biases for radius in radii]
    errors = np.array([seen.at(values) for values in common.progress(grid, "measuring", console)])
    errors_unseen = np.array([unseen.at(values) for values in common.progress(grid, "validating", console)])

    start = settings.initial(AXES[0]), settings.initial(AXES[1])
    fits = {name: against_grid(seen, joint[name], grid, errors, name) for name in losses}
    validation = {
        "start": unseen_errors(unseen.at(start)),
        **{f"joint, {name}": unseen_errors(unseen.at(values)) for name, values in joint.items()},
    }
    each = [unseen_errors(unseen.at(values)) for values in alone.values()]
    single = {key: float(np.mean([one[key] for one in each])) for key in ("mean", "worst")}
    best = int(errors_unseen.mean(axis=1).argmin())
    validation |= {"single view": single, "grid": unseen_errors(errors_unseen[best])}
    rows = [
        {"fitted_on": name, "bias": values[0], "radius": values[1], "rmse_unseen": one["mean"]}
        for (name, values), one in zip(alone.items(), each, strict=True)
    ]
    summary = {
        "config": str(config),
        "overrides": list(overrides),
        "size": size,
        "views": len(seen.problems),
        "unseen_views": len(unseen.problems),
        "spacing": [float(axis[1] - axis[0]) for axis in (biases, radii)],
        "fits": fits,
        "validation": validation,
        "gain": {name: validation[f"joint, {name}"]["mean"] / single["mean"] for name in losses},
    }
    show(console, summary)
    panels = {f"RMSE {OVER[name]}": (seen.over_all(errors, name), joint[name]) for name in losses}
    panels["mean RMSE, validation"] = errors_unseen.mean(axis=1), None
    folder = common.write(settings, NAME, picture((biases, radii), panels, start, rows), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def drawn(views: Sequence[FitView], what: str, console: Console) -> Views:
    """The views as problems, with their references."""
    return Views(
        {view.name: common.problem_of(common.draw(view.config)) for view in common.progress(views, what, console)}
    )


def against_grid(
    views: Views, fitted: Values, grid: Sequence[Values], errors: Float[np.ndarray, "n v"], over: str
) -> dict[str, Any]:
    """The fitted values and the grid's best, with the roots of their losses."""
    of_grid, of_fit = views.over_all(errors, over), float(views.over_all(views.at(fitted), over))
    best = int(of_grid.argmin())
    return {
        "fit": {"bias": fitted[0], "radius": fitted[1], "rmse": of_fit},
        "grid": {"bias": grid[best][0], "radius": grid[best][1], "rmse": float(of_grid[best])},
        "ratio": of_fit / float(of_grid[best]),
    }


def unseen_errors(errors: Float[np.ndarray, " v"]) -> dict[str, float]:
    """The mean of the errors of views, and the greatest."""
    return {"mean": float(errors.mean()), "worst": float(errors.max())}


def show(console: Console, summary: dict[str, Any]) -> None:
    """The tables."""
    title = f"{summary['views']} views, hard compare, values in texels"
    table = Table("loss", "", "bias", "radius", "RMSE", "fit / grid", title=title, title_justify="left")
    for name, found in summary["fits"].items():
        for row, ratio in (("fit", f"{found['ratio']:.4f}"), ("grid", "")):
            at = found[row]
            label = f"grid of {summary['size']} x {summary['size']}" if row == "grid" else "fit"
            table.add_row(OVER[name], label, f"{at['bias']:.4g}", f"{at['radius']:.4g}", f"{at['rmse']:.5f}", ratio)
    console.print(table)
    title = f"{summary['unseen_views']} views that no fit has seen"
    single = summary["validation"]["single view"]["mean"]
    table = Table("values", "mean RMSE", "greatest", "mean / single view", title=title, title_justify="left")
    for name, errors in summary["validation"].items():
        table.add_row(name, f"{errors['mean']:.5f}", f"{errors['worst']:.5f}", f"{errors['mean'] / single:.3f}")
    console.print(table)


def picture(
    axes: tuple[Any, Any],
    panels: dict[str, tuple[Float[np.ndarray, " n"], Values | None]],
    start: Values,
    rows: Sequence[dict[str, Any]],
) -> Any:
    """The figure."""
    made, charts = common.figure(4.3 * len(panels), 3.7, 1, len(panels))
    for chart, (title, (errors, fitted)) in zip(charts, panels.items(), strict=True):
        values = errors.reshape(len(axes[0]), len(axes[1]))
        shown = chart.pcolormesh(*axes, values.T, norm=LogNorm(), cmap=common.HEAT, shading="nearest")
        common.colour_bar(made, shown, [chart], "RMSE [visibility]")
        common.chart(chart, title, "constant bias [texels]", "radius [texels]", grid=False)
        i, j = np.unravel_index(values.argmin(), values.shape)
        point(chart, axes[0][i], axes[1][j], "x", "grid's best")
        point(chart, *start, "D", "start")
        if fitted is not None:
            point(chart, *fitted, "*", "joint fit")
        else:
            for k, row in enumerate(rows):
                point(chart, row["bias"], row["radius"], "o", "" if k else "fits of single views")
        common.legend(chart, loc="upper right", frameon=True, framealpha=0.85)
    return made


def point(axes: Axes, x: float, y: float, mark: str, label: str) -> None:
    """One marked point."""
    edge = {} if mark == "x" else {"markeredgecolor": "white", "markeredgewidth": 0.8}
    colour, size = common.INK if mark == "x" else common.COLOURS[1], {"*": 12, "o": 4}.get(mark, 6)
    axes.plot(
        x,
        y,
        mark,
        color=colour,
        markersize=size,
        linestyle="none",
        label=label or None,
        zorder=5,
        clip_on=False,
        **edge,
    )


if __name__ == "__main__":
    common.start(app)
