"""Do fitted values generalise? Fits in one setting, and measures in others.

    python experiments/generalisation.py configs/generalisation.yaml
    python experiments/generalisation.py configs/generalisation.yaml --over light fit.solver.max_steps=10

Varies one part of a configuration at a time: the camera's direction (view), the light's (light), or the first mesh
(mesh). The configuration's fit runs in each variation. The fitted values are then measured in all other variations,
under the hard compare.

The figure has a matrix for each part. A row is the variation where values were fitted, with the values, in texels,
below its name; a column is the variation where they were measured. A number is the root mean square error (RMSE) there
over that of the column's own fit: 1 on the diagonal, 1.5 if the error is half as large again, below 1 if the column's
own fit missed the optimum. A column of large numbers is a setting that needs its own values; a row of small numbers is
a setting whose values work everywhere.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _common as common
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from matplotlib.colors import LogNorm
from rich.table import Table

from diffshadow.config import DirectionalLightConfig, fit_paths, load_config
from diffshadow.console import Console
from diffshadow.fit import TechniqueProblem, with_values

NAME = "generalisation"
MESHES = ("torus_knot", "torus", "sphere", "blob", "fence", "box")
CAMERA, LIGHT = "scene.camera.orbit", "scene.light"


def turned(key: str, azimuth: float, elevation: float) -> tuple[str, ...]:
    """Overrides for the direction of the camera or the light."""
    return f"{key}.azimuth={azimuth}", f"{key}.elevation={elevation}"


VIEWS = ((0, 25), (72, 25), (144, 25), (216, 25), (288, 25), (0, 70))
SUNS = ((-60, 20), (-60, 40), (-60, 60), (-60, 80), (30, 40), (120, 40))
VARIATIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "view": {f"{azimuth}°, {up}° up": turned(CAMERA, azimuth, up) for azimuth, up in VIEWS},
    "light": {f"{azimuth}°, {up}° up": turned(LIGHT, azimuth, up) for azimuth, up in SUNS},
    "mesh": {name: (f"scene.meshes.0.path=builtin:{name}", "scene.meshes.0.options={}") for name in MESHES},
}
"""The overrides of each variation, by what is varied."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *overrides: str, over: str = "view,light,mesh", count: int = 6) -> dict[str, Any]:
    """Fits and measures the variations of CONFIG.

    Parameters
    ----------
    config
        YAML file with the fit; its camera must have an orbit, and its light must be directional with angles.
    overrides
        KEY=VALUE pairs that replace values of the file.
    over
        What to vary, separated by commas: view, light, mesh.
    count
        How many variations of each.
    """
    console = Console()
    kinds = common.chosen("over", over, VARIATIONS)
    common.expect("count", count, 2 <= count <= len(MESHES), f"2 to {len(MESHES)}")
    settings = common.load(config, overrides)
    if "view" in kinds and settings.scene.camera.orbit is None:
        raise common.mistake(settings, "scene.camera", "has an eye; expected an orbit, which is varied: give one")
    light = settings.scene.light
    if "light" in kinds and not (isinstance(light, DirectionalLightConfig) and light.azimuth is not None):
        what = "has no angles; expected a directional light with azimuth and elevation: give these"
        raise common.mistake(settings, "scene.light", what)
    found = {}
    for kind in kinds:
        variations = dict(list(VARIATIONS[kind].items())[:count])
        found[kind] = fit_and_measure(config, overrides, variations, common.progress(variations, kind, console))
    rows = [
        {"over": kind, "fitted_on": fitted, "measured_on": measured, "rmse": float(errors[i, j]), **values[fitted]}
        for kind, (values, errors) in found.items()
        for i, fitted in enumerate(values)
        for j, measured in enumerate(values)
    ]
    ratios = {kind: errors / np.maximum(errors.diagonal(), 1e-12) for kind, (_, errors) in found.items()}
    show(console, ratios, found)
    summary = {
        "config": str(config),
        "overrides": list(overrides),
        "worst": {kind: float(ratio.max()) for kind, ratio in ratios.items()},
        "median": {kind: float(np.median(ratio[~np.eye(len(ratio), dtype=bool)])) for kind, ratio in ratios.items()},
    }
    folder = common.write(settings, NAME, picture(ratios, found), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


Found = tuple[dict[str, dict[str, float]], np.ndarray]
"""The fitted values by where they were fitted, and the errors (fitted on, measured on)."""


def fit_and_measure(
    config: Path, overrides: Sequence[str], variations: dict[str, tuple[str, ...]], names: Any
) -> Found:
    """Fits in each variation, and measures all fitted values in each."""
    values, problems = {}, []
    paths: tuple[str, ...] = ()
    for name in names:
        settings = load_config(config, [*overrides, *variations[name]])
        problem = common.problem_of(common.draw(settings))
        values[name] = common.run_fit(settings, problem).fitted
        paths = tuple(fit_paths(settings)[key] for key in values[name])
        problems.append(problem)
    errors = [[measured(problem, paths, of) for problem in problems] for of in values.values()]
    return values, np.array(errors)


def measured(problem: TechniqueProblem, paths: tuple[str, ...], values: dict[str, float]) -> float:
    """The error of a problem with values that were fitted elsewhere."""
    return common.rmse(problem, with_values(problem.technique, paths, jnp.array(list(values.values()), jnp.float32)))


def show(console: Console, ratios: dict[str, Any], found: dict[str, Found]) -> None:
    """A table for each part that is varied."""
    for kind, ratio in ratios.items():
        names = list(found[kind][0])
        title = f"RMSE over each column's own best, by {kind}: fitted on the row, measured on the column"
        table = Table("", *names, title=title, title_justify="left")
        for name, row in zip(names, ratio, strict=True):
            table.add_row(name, *(f"{x:.2f}" for x in row))
        console.print(table)


def picture(ratios: dict[str, Any], found: dict[str, Found]) -> Any:
    """The figure."""
    made, panels = common.figure(4.4 * len(ratios) + 0.6, 4.6, 1, len(ratios))
    # Symmetric around 1, and clamped at a factor of 2.
    norm, shown = LogNorm(0.5, 2), None
    for panel, (kind, ratio) in zip(panels, ratios.items(), strict=True):
        values, errors = found[kind]
        shown = panel.imshow(ratio, norm=norm, cmap="PuOr_r")
        for (i, j), x in np.ndenumerate(ratio):
            far = abs(np.log2(x)) > 0.7
            panel.text(j, i, f"{x:.2f}", ha="center", va="center", fontsize=8, color="white" if far else common.INK)
        fitted = [f"{name}\n{', '.join(f'{x:.2g}' for x in of.values())}" for name, of in values.items()]
        own = [f"{name}\n{error:.3f}" for name, error in zip(values, errors.diagonal(), strict=True)]
        common.chart(
            panel, f"Over {kind}s", "measured on, and its own best RMSE", "fitted on, and the values", grid=False
        )
        panel.set_xticks(range(len(own)), own, rotation=40, ha="right", rotation_mode="anchor", fontsize=7)
        panel.set_yticks(range(len(fitted)), fitted, fontsize=7)
    bar = common.colour_bar(made, shown, [panels[-1]], "RMSE over the column's own best")
    bar.set_ticks([0.5, 0.7, 1, 1.4, 2], labels=["0.5", "0.7", "1", "1.4", "2"], minor=False)
    bar.minorticks_off()
    return made


if __name__ == "__main__":
    common.start(app)
