"""Does a fit's result hold in the engine itself? Draws a scene before and after its fit with the real engine.

    python experiments/in_the_engine.py configs/three_js.yaml
    python experiments/in_the_engine.py configs/babylon_js.yaml scene.light.elevation=60 --grid 9

Fits the configuration, whose technique is three.js or babylon.js, and then draws the same scene with that engine in
headless Chromium: with the engine's defaults, with the values before the fit, and with the fitted ones. The table
compares what the library predicts with what the engine draws, and both with the ray-traced truth. Pixels are equal if
their visibility differs by at most 1/255: of the library's own picture, and of one at the receivers that the engine's
camera sees, which places vertices at coarser steps.

With `--grid`, the engine also draws a grid over the bounds of all fitted parameters, and the fit's error in the engine
is compared with the least of the grid. Chromium draws without graphics hardware and places vertices at steps of 1/16
texel, so the prediction does so, too (`technique.subpixels`).

It needs node, Chromium and three packages, and says how to install what is missing.
"""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _common as common
import jax.numpy as jnp
import numpy as np
from _engine_jobs import NEAR, Engine, engine_job
from cyclopts import App
from engines.engines import draw, missing
from matplotlib.figure import Figure
from rich.table import Table

from diffshadow import fit
from diffshadow.console import Console
from diffshadow.raster import Surface
from diffshadow.settings import engines
from diffshadow.study import style

NAME = "in_the_engine"
SUBPIXELS = "technique.subpixels=16"
"""What Chromium does without graphics hardware."""
STATES = ("defaults", "before", "after")

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *overrides: str, grid: int = 0, output: Path | None = None) -> dict[str, Any]:
    """Fits CONFIG, and draws it with the engine.

    Parameters
    ----------
    config
        YAML file with the fit; its technique must be three.js or babylon.js.
    overrides
        KEY=VALUE pairs that replace values of the file.
    grid
        Points of the engine's grid along each fitted parameter; 0 for no grid.
    output
        Folder of the results' folder, instead of the configuration's.
    """
    console = Console()
    common.expect("grid", grid, grid == 0 or 2 <= grid <= 32, "0, or 2 to 32 points")
    to = () if output is None else (f"output={output}",)
    settings = common.load(config, overrides)
    if not isinstance(settings.technique, engines.Engine):
        what = f"is {settings.technique.type}; expected three.js or babylon.js, which can be drawn here: change it"
        raise common.mistake(settings, "technique.type", what)
    settings = common.load(config, (*overrides, SUBPIXELS, *to))
    lack = missing()
    if lack is not None:
        raise common.mistake(settings, "technique.type", lack)
    case = common.draw(settings)
    problem = common.problem_of(case)
    result = common.run_fit(settings, problem)
    after: Any = result.technique
    names = [name.removeprefix("technique.") for name in result.fitted]
    with_values = lambda values: fit.with_values(after, names, jnp.array(values))
    techniques = {
        "defaults": with_values([float(getattr(type(after)(), name)) for name in names]),
        "before": with_values([*result.initial.values()]),
        "after": after,
    }
    bounds = settings.fit.parameters.values()
    # The last varies fastest. With VSM, the engine blurs a map once for each radius.
    points = [np.linspace(each.lower, each.upper, grid) for each in bounds]
    cells = list(itertools.product(*points)) if grid else []
    console.print(f"drawing with {settings.technique.type}")
    drawn = [*techniques.values(), *map(with_values, cells)]
    (drawing,) = draw([engine_job(case, after, drawn)])
    pictures = drawing.arrays["grid"].clip(0, 1)
    mask = np.asarray(problem.mask) & (drawing.arrays["mesh"] >= 0)
    surface = dataclasses.replace(
        case.surface,
        position=jnp.asarray(drawing.arrays["position"]),
        interpolated_normal=jnp.asarray(drawing.arrays["normal"]),
    )
    error = lambda picture: float(np.sqrt(np.mean((picture - case.truth.visibility)[mask] ** 2)))
    rows = [
        _row(name, names, techniques[name], problem, surface, picture, mask, error)
        for name, picture in zip(STATES, pictures, strict=False)
    ]
    summary: dict[str, Any] = {"config": str(config), "overrides": list(overrides), "engine": drawing.info["version"]}
    if grid:
        errors = [error(picture) for picture in pictures[len(STATES) :]]
        best = int(np.argmin(errors))
        at = dict(zip(names, map(float, cells[best]), strict=True))
        summary |= {"grid_best": errors[best], "grid_at": at, "ratio": rows[-1]["rmse_engine"] / errors[best]}
    _show(console, names, rows, summary)
    shown = dict(zip(STATES, pictures, strict=False))
    made = _picture(settings.technique.type, case.truth.visibility, shown, mask, rows)
    folder = common.write(settings, NAME, made, rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def _row(
    state: str,
    names: list[str],
    technique: Engine,
    problem: fit.TechniqueProblem,
    surface: Surface,
    picture: np.ndarray,
    mask: np.ndarray,
    error: Callable[[np.ndarray], float],
) -> dict[str, Any]:
    """The errors of the engine's picture and of the predicted one, and how many of the pixels in `mask` are equal: of
    the library's own surface, and of `surface`, which the engine's camera sees."""
    own = problem.laid_out(technique)
    there = dataclasses.replace(own, surface=surface)
    predicted, at_engines = (common.visibility(each, technique) for each in (own, there))
    close, same = (np.abs(image - picture)[mask] <= NEAR for image in (predicted, at_engines))
    return {
        "state": state,
        **{key: float(getattr(technique, key)) for key in names},
        "rmse_engine": error(picture),
        "rmse_predicted": error(predicted),
        "within_1_255": float(close.mean()),
        "within_1_255_at_engine": float(same.mean()),
    }


def _show(console: Console, names: list[str], rows: list[dict[str, Any]], summary: dict[str, Any]) -> None:
    """Prints the errors, and how well they were predicted."""
    table = Table()
    table.add_column("", no_wrap=True)
    for title in (*names, "RMSE, engine", "RMSE, predicted", "equal", "equal, at its receivers"):
        table.add_column(title, justify="right")
    for row in rows:
        numbers = [f"{row[key]:.3g}" for key in names]
        errors = [f"{row[key]:.4f}" for key in ("rmse_engine", "rmse_predicted")]
        shares = [f"{row[key]:.2%}" for key in ("within_1_255", "within_1_255_at_engine")]
        table.add_row(row["state"], *numbers, *errors, *shares)
    console.print(table)
    if "ratio" in summary:
        at = ", ".join(f"{name} {value:.4g}" for name, value in summary["grid_at"].items())
        console.print(
            f"the least error of the engine's grid is {summary['grid_best']:.4f}, at {at}; the fit's is "
            f"{summary['ratio']:.3f} times as large"
        )


def _picture(
    engine: str, truth: np.ndarray, pictures: dict[str, np.ndarray], mask: np.ndarray, rows: list[dict[str, Any]]
) -> Figure:
    """The truth beside what the engine draws."""
    titles = {row["state"]: f"{engine}, {row['state']}, RMSE {row['rmse_engine']:.4f}" for row in rows}
    panels = {"ray-traced": truth} | {titles[state]: picture for state, picture in pictures.items()}
    height, width = truth.shape
    made, axes = common.figure(2.9 * len(panels), 2.9 * height / width + 0.3, 1, len(panels))
    for one, (title, image) in zip(axes, panels.items(), strict=True):
        shown = np.where(mask, image, np.nan)
        one.imshow(shown, origin="lower", cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        one.set_xticks([])
        one.set_yticks([])
        style.title(one, title)
    return made


if __name__ == "__main__":
    common.start(app)
