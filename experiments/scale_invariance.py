"""Do results depend on the scene's scale? Makes the whole scene larger and smaller, and looks for changes.

    python experiments/scale_invariance.py configs/scale_invariance.yaml
    python experiments/scale_invariance.py configs/spot.yaml --scales 0.001,1,1000

Every setting of the configuration in world units is multiplied by a factor, and every mesh is scaled by it. All other
settings, such as biases and radii in texels and angles in degrees, are kept. Then the image, the errors and the fitted
values must not change either. A change reveals a length in the wrong unit, or a constant that should have no unit.

Prints, for each scale, the error before and after the fit and the fitted values. The figure has the scale along x and
the deviations from scale 1 along y, both logarithmic: for errors, the relative difference; for fitted values, the
difference over the distance of their bounds; for the image before the fit, the root mean square difference. Deviations
of zero are drawn at the bottom. The remaining deviations are rounding: single precision has a relative error of
2^-24 = 6e-8, a tap may flip if its receiver is that close to the compare's threshold, and a fit has its tolerance.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _common as common
import numpy as np
from cyclopts import App
from rich.table import Table

from diffshadow.config import Config, describe, fit_units, load_config
from diffshadow.console import Console

NAME = "scale_invariance"
LEAST = 1e-9
"""Where the figure draws deviations of zero."""

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *overrides: str, scales: str = "0.01,0.1,0.5,1,2,10,100") -> dict[str, Any]:
    """Fits CONFIG at several scales.

    Parameters
    ----------
    config
        YAML file with the fit.
    overrides
        KEY=VALUE pairs that replace values of the file.
    scales
        Factors, separated by commas; 1 is always among them.
    """
    console = Console()
    factors = sorted({1.0, *common.listed("scales", scales, float)})
    fine = len(factors) > 1 and all(math.isfinite(factor) and factor > 0 for factor in factors)
    common.expect("scales", scales, fine, "one or more besides 1, each positive")
    settings = common.load(config, overrides)
    kept = [name for name, unit in fit_units(settings).items() if unit == "world units"]
    if any(name in settings.fit.parameters for name in kept):
        what = f"has {kept[0]}, which is in world units and changes with the scale; expected others: leave it out"
        raise common.mistake(settings, "fit.parameters", what)
    made = {}
    for factor in common.progress(factors, "fitting", console):
        made[factor] = measure(load_config(config, [*overrides, *scaled(settings, factor)]))
    rows = [
        {"scale": factor, **result, **deviations(settings, result, image, *made[1.0])}
        for factor, (result, image) in made.items()
    ]
    keys = [key for key in rows[0] if key.startswith("deviation")]
    worst = {key.removeprefix("deviation "): max(row[key] for row in rows) for key in keys}
    summary = {"config": str(config), "overrides": list(overrides), "worst": worst}
    show(console, rows, worst)
    folder = common.write(settings, NAME, picture(rows, keys), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def scaled(settings: Config, factor: float) -> list[str]:
    """The overrides that multiply every length in world units, and therefore the scene, by `factor`."""
    found = []
    directional = settings.scene.light is not None and settings.scene.light.type == "directional"
    for row in describe(settings):
        *holder, last = row.key.split(".")
        is_mesh = holder[:2] == ["scene", "meshes"]
        # A mesh is scaled after it is fitted to its size. A filter's light_size is in world units, too.
        is_length = row.unit == "world units" and not (is_mesh and last == "size")
        if is_length or (is_mesh and last == "scale") or (row.key == "filter.light_size" and not directional):
            found.append(f"{row.key}={_times(_value(settings, row.key), factor)}")
    return found


def _value(settings: Config, key: str) -> Any:
    value: Any = settings
    for step in key.split("."):
        value = value[int(step)] if isinstance(value, Sequence) else getattr(value, step)
    return value


def _times(value: Any, factor: float) -> Any:
    return [float(x) * factor for x in value] if isinstance(value, Sequence) else float(value) * factor


def measure(settings: Config) -> tuple[dict[str, float], Any]:
    """The errors before and after the fit and the fitted values, and the image before the fit where pixels count."""
    problem = common.problem_of(common.draw(settings))
    before = common.rmse(problem)
    image = common.visibility(problem)
    result = common.run_fit(settings, problem)
    errors = {"rmse before": before, "rmse after": common.rmse(problem, result.technique)}
    return errors | result.fitted, np.where(np.asarray(problem.mask), image, np.nan)


def deviations(
    settings: Config, result: dict[str, float], image: Any, result_at_1: dict[str, float], image_at_1: Any
) -> dict[str, float]:
    """The deviations of the results at a scale from those at scale 1."""
    found = {}
    for name, value in result.items():
        bounds = settings.fit.parameters.get(name)
        unit = result_at_1[name] if bounds is None else bounds.upper - bounds.lower
        found[f"deviation {name}"] = abs(value - result_at_1[name]) / max(unit, 1e-12)
    return found | {"deviation picture": float(np.sqrt(np.nanmean((image - image_at_1) ** 2)))}


def show(console: Console, rows: list[dict[str, float]], worst: dict[str, float]) -> None:
    """The table."""
    names = [name for name in rows[0] if name != "scale" and not name.startswith("deviation")]
    title = "values that must not change with the scale; lengths in texels"
    table = Table("scale", *names, "picture", title=title, title_justify="left")
    for row in rows:
        table.add_row(f"{row['scale']:g}", *(f"{row[name]:.6g}" for name in names), f"{row['deviation picture']:.1e}")
    table.add_row("deviation", *(f"{worst[name]:.1e}" for name in [*names, "picture"]))
    console.print(table)


def picture(rows: list[dict[str, float]], keys: list[str]) -> Any:
    """The figure."""
    made, (axes,) = common.figure(7.2, 3.8)
    rows = [row for row in rows if row["scale"] != 1]
    for i, key in enumerate(keys):
        y = [max(row[key], LEAST) for row in rows]
        axes.plot([row["scale"] for row in rows], y, label=key.removeprefix("deviation "), **common.curve(i))
    axes.axhline(2**-24, color=common.FAINT, linestyle="--", linewidth=1, label="single precision")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(LEAST / 2, 1)
    common.chart(axes, "Deviation from the scene at scale 1", "scale of every length", "deviation")
    common.legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return made


if __name__ == "__main__":
    common.start(app)
