"""How does the soft compare's width affect the image and the gradient? Measures both errors for each kernel.

    python experiments/soft_width.py configs/soft_width.yaml
    python experiments/soft_width.py configs/soft_width.yaml --kernels logistic,linear --widths 5 --points 2

A fit follows the gradient of the soft loss, but the goal is a small hard loss. This measures how far the two are apart
for each kernel, as a function of the soft compare's width. Kernels define their width differently: ramps extend from
-width to width, and the Gaussian's width is its standard deviation. To make them comparable, all are plotted over the
standard deviation of the step, in texels; the table also has the configuration's width.

Image error is measured at the configuration's values: the root mean square error (RMSE) of the soft image against the
hard image and against the reference, together with the hard image's own error.

Gradient error is measured at the points of a regular grid inside the bounds of `bias.constant` and `filter.radius`. The
soft loss has a derivative, but what is the derivative of the hard loss? Over the bias, the hard loss of finitely many
pixels is a staircase: its derivative is zero or does not exist, and a central difference over a small step counts the
few taps that flip in it. Only a derivative at a scale is meaningful, so the truth here is the least-squares slope of
the hard loss at 2 m + 1 even steps over +-h. With L_k the loss at k steps d = h / m from the point, it is

    sum_k k (L_k - L_-k) / (2 d sum_k k^2),    k = 1 .. m:

a mean of central differences weighted by the squares of their steps, so that the widest difference, which includes the
most taps, has the largest weight. For many steps it is the derivative smoothed by Epanechnikov's kernel,
(3 / 4h)(1 - (s / h)^2). It is computed in float64, where a loss that changes in its seventh digit still has a slope.
The error of each parameter is the sum over the points of |soft - truth|, over that of |truth|. The grey line is the
same for the truth at half its scale instead of the soft gradient: errors below it are not significant.

What to expect: for each tap, the soft compare is the hard compare averaged over biases, distributed around the tap's
own like the kernel's density. If the loss were linear in visibility, soft gradients would be smoothed hard gradients,
and the width only a scale. But the loss is quadratic, so the soft loss lacks the variance of visibility over these
biases: it does not see acne that its width averages to an even grey. If the width is too small, it contains too few
taps to average, and the gradient is noise. The best width lies in between. The radius is different: with bilinear
look-ups the hard loss is smooth in it, and the error falls with the width until it reaches that of the truth itself.
"""

import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import _common as common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from rich.table import Table

from diffshadow.config import Config
from diffshadow.console import Console
from diffshadow.fit import TechniqueProblem, with_values
from diffshadow.shadow import HardCompare, SoftCompare, SoftKernel

NAME = "soft_width"
AXES = (common.BIAS, common.RADIUS)
KERNELS: tuple[SoftKernel, ...] = get_args(SoftKernel)
DEVIATION = {
    "logistic": math.pi / math.sqrt(3),
    "linear": 1 / math.sqrt(3),
    "smoothstep": 1 / math.sqrt(5),
    "gaussian": 1.0,
    "exponential": 1.0,
}
"""Standard deviation of each kernel's density, the derivative of its step, at a width of 1."""
STEPS = 8
"""Number of central differences in the truth's slope."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    config: Path,
    /,
    *overrides: str,
    kernels: str = ",".join(KERNELS),
    widths: int = 14,
    least: float = 0.001,
    most: float = 8.0,
    points: int = 4,
    scale: float = 0.25,
) -> dict[str, Any]:
    """Measures the soft compare on the scene of CONFIG.

    Parameters
    ----------
    config
        YAML file with the technique and the bounds of bias.constant and filter.radius.
    overrides
        KEY=VALUE pairs that replace values of the file.
    kernels
        Which kernels, separated by commas.
    widths
        Number of widths, in geometric steps.
    least, most
        Range of the step's standard deviation, in texels.
    points
        Number of points along each of bias and radius at which gradients are measured.
    scale
        The scale h of the truth's derivative, in texels.
    """
    console = Console()
    names = common.chosen("kernels", kernels, KERNELS)
    common.expect("widths", widths, widths > 1, "2 or more")
    common.expect("least", least, 0 < least < most, f"more than 0, and less than most, {most}")
    common.expect("points", points, points > 0, "1 or more along each axis")
    common.expect("scale", scale, scale > 0, "more than 0 texels")
    settings = common.load(config, overrides, needs=AXES)
    drawn = common.draw(settings)
    problem = eqx.tree_at(lambda p: p.technique.compare, common.problem_of(drawn), HardCompare())
    cases: list[tuple[SoftKernel, float]] = [
        (kernel, float(spread)) for kernel in names for spread in np.geomspace(least, most, widths)
    ]
    rows, of_hard = measure_all(problem, cases, grid_of(settings, points), scale, console)
    summary = {
        "config": str(config),
        "overrides": list(overrides),
        "reference_noise": drawn.floor,
        **of_hard,
        "best": {kernel: best(rows, kernel) for kernel in names},
    }
    show(console, summary)
    folder = common.write(settings, NAME, picture(rows, names, summary), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def grid_of(settings: Config, points: int) -> np.ndarray:
    """The points at which gradients are measured, (n, 2): `points` along each axis, inside its bounds."""
    inside = (np.arange(points) + 0.5) / points
    bounds = [settings.fit.parameters[name] for name in AXES]
    return np.stack(np.meshgrid(*(b.lower + (b.upper - b.lower) * inside for b in bounds)), -1).reshape(-1, 2)


def measure_all(
    hard: TechniqueProblem, cases: Sequence[tuple[SoftKernel, float]], grid: np.ndarray, scale: float, console: Console
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A row for each kernel and standard deviation of `cases`, and the values of the hard loss at `scale`."""
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda x: x.astype(jnp.float64) if eqx.is_inexact_array(x) else x, hard)
        both = [
            (slopes(exact, at, scale), slopes(exact, at, scale / 2))
            for at in common.progress(grid, "hard loss", console)
        ]
        truth, finer = np.array(both).swapaxes(0, 1)
        rows = [
            measure(exact, kernel, spread, grid, truth)
            for kernel, spread in common.progress(cases, "soft loss", console)
        ]
        rmse = float(jnp.sqrt(_loss(exact, None)))
    return rows, {
        "hard_rmse": rmse,
        "scale": scale,
        "points": grid.tolist(),
        "truth": truth.tolist(),
        "truth_uncertain": dict(zip(AXES, relative(finer, truth), strict=True)),
    }


@eqx.filter_jit
def _loss(problem: TechniqueProblem, values: Any) -> Any:
    """The mean square error with the two axes' parameters at `values`, or unchanged if these are none."""
    technique = problem.technique if values is None else with_values(problem.technique, AXES, values)
    return problem.mean_square_error(technique)


@eqx.filter_jit
def _gradient(problem: TechniqueProblem, values: Any) -> Any:
    return jax.jacfwd(functools.partial(_loss, problem))(values)


@eqx.filter_jit
def _images(soft: TechniqueProblem, hard: TechniqueProblem) -> Any:
    """The root mean square of soft minus hard, and of soft minus truth."""
    rms = lambda difference: jnp.sqrt(jnp.sum(difference**2) / hard.count)
    to_truth = soft.difference(soft.technique)
    return rms(to_truth - hard.difference(hard.technique)), rms(to_truth)


def slopes(hard: TechniqueProblem, at: Any, scale: float) -> list[float]:
    """The derivatives of the hard loss at `scale` by each of the axes' parameters: least-squares slopes."""
    found = []
    for axis in np.eye(len(AXES)):
        steps = np.arange(1, STEPS + 1)
        loss = lambda k, axis=axis: float(_loss(hard, jnp.asarray(at + k * scale / STEPS * axis)))
        differences = np.array([loss(k) - loss(-k) for k in steps])
        found.append(float(np.sum(steps * differences) / (2 * scale / STEPS * np.sum(steps**2))))
    return found


def measure(hard: TechniqueProblem, kernel: SoftKernel, spread: float, grid: Any, truth: Any) -> dict[str, Any]:
    """A kernel at the width that gives it the standard deviation `spread`."""
    width = spread / DEVIATION[kernel]
    soft = eqx.tree_at(lambda p: p.technique.compare, hard, SoftCompare(width, kernel))
    to_hard, to_truth = _images(soft, hard)
    gradients = np.array([_gradient(soft, jnp.asarray(at)) for at in grid])
    by_bias, by_radius = relative(gradients, truth)
    return {
        "kernel": kernel,
        "deviation": spread,
        "width": width,
        "rmse_to_hard": float(to_hard),
        "rmse_to_truth": float(to_truth),
        "gradient_error_bias": by_bias,
        "gradient_error_radius": by_radius,
    }


def relative(found: Any, truth: Any) -> list[float]:
    """The sum of |found - truth| over that of |truth|, for each parameter."""
    return (np.abs(found - truth).sum(axis=0) / np.maximum(np.abs(truth).sum(axis=0), 1e-300)).tolist()


def best(rows: list[dict[str, Any]], kernel: str) -> dict[str, float]:
    """The width of a kernel at which its gradient by the bias is closest to the truth's, and its errors."""
    row = min((row for row in rows if row["kernel"] == kernel), key=lambda row: row["gradient_error_bias"])
    return {key: value for key, value in row.items() if key != "kernel"}


def show(console: Console, summary: dict[str, Any]) -> None:
    """The table of each kernel's best width."""
    title = "each kernel at the width whose gradient by the bias is best: its step's deviation and width in texels, "
    title += f"RMSE to the hard image and to the truth ({summary['hard_rmse']:.4f} hard), and errors of gradients"
    heads = ("deviation", "width", "to hard", "to truth", "by bias", "by radius")
    table = Table("", *heads, title=title, title_justify="left")
    for kernel, row in summary["best"].items():
        *lengths, hard, truth, bias, radius = row.values()
        errors = (f"{x:.1%}" for x in (bias, radius))
        table.add_row(kernel, *(f"{x:.3g}" for x in lengths), f"{hard:.4f}", f"{truth:.4f}", *errors)
    console.print(table)


def picture(rows: list[dict[str, Any]], kernels: Sequence[str], summary: dict[str, Any]) -> Any:
    """The figure."""
    made, panels = common.figure(9.0, 6.8, 2, 2)
    titles = {
        "rmse_to_hard": ("Image: soft against hard", "RMSE [visibility]"),
        "rmse_to_truth": ("Image: soft against the traced truth", "RMSE [visibility]"),
        "gradient_error_bias": ("Gradient by the constant bias", "error over the hard loss's gradient"),
        "gradient_error_radius": ("Gradient by the radius", "error over the hard loss's gradient"),
    }
    for panel, (key, (title, along)) in zip(panels, titles.items(), strict=True):
        for i, kernel in enumerate(kernels):
            of = [row for row in rows if row["kernel"] == kernel]
            x, y = ([row[name] for row in of] for name in ("deviation", key))
            panel.plot(x, y, label=kernel, **common.curve(i))
        panel.set_xscale("log")
        panel.set_yscale("log")
        common.chart(panel, title, "standard deviation of the step [texels]", along)
    level(panels[1], summary["hard_rmse"], "hard image")
    for panel, name in zip(panels[2:], AXES, strict=True):
        level(panel, summary["truth_uncertain"][name], "of the truth itself")
        panel.axhline(1, color=common.FAINT, linewidth=0.8, linestyle=":")
    common.legend(panels[0])
    for panel in panels[1:3]:
        handles, labels = panel.get_legend_handles_labels()
        common.legend(panel, handles=handles[-1:], labels=labels[-1:])
    return made


def level(axes: Any, height: float, label: str) -> None:
    """A labelled horizontal line."""
    if height > 0:
        axes.axhline(height, color=common.FAINT, linewidth=1.2, linestyle="--", label=label)


if __name__ == "__main__":
    common.start(app)
