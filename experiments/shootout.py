"""Which technique has the least error for a given time?

    python experiments/shootout.py configs/shootout.yaml
    python experiments/shootout.py configs/shootout.yaml --only disk,box --repeats 50

Each technique is tried at several settings of increasing cost: numbers of taps, or widths of a kernel. For each
setting, the configuration's fit first finds the bias, and the radius if it does not affect the cost, so that each
setting is measured at its best. Then the computation of visibility from the map is timed; filters that blur the map do
so each time. Drawing the map is the same for all, and timed separately. Times are medians, after compilation and two
warm-up runs. Techniques take turns, so that a machine that slows down affects all of them. The figure and the summary
name the machine and its load: compare only times of one run.

The figure has milliseconds along x and the root mean square error (RMSE) under the hard compare along y. A line joins
the settings of a technique. The grey line is the Pareto front: settings that no other setting beats in both.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import jax
import numpy as np
from cyclopts import App
from rich.table import Table

from diffshadow import metrics
from diffshadow.config import Config, build_technique, load_config
from diffshadow.console import Console

NAME = "shootout"
BOUNDS = {
    common.BIAS: "{initial: 2, lower: 0, upper: 40}",
    "bias.slope": "{initial: 0.5, lower: 0, upper: 6}",
    common.RADIUS: "{initial: 2, lower: 0, upper: 10}",
    "filter.light_bleeding": "{initial: 0.1, lower: 0, upper: 0.9}",
}
"""Initial values and bounds of fits, in texels, or in visibility for light bleeding."""


class Technique(NamedTuple):
    """A technique: its title, its filter with `{}` for the setting, the settings, fitted parameters, and its bias."""

    title: str
    filter: str
    settings: tuple[float, ...]
    fitted: tuple[str, ...] = (common.BIAS, "bias.slope")
    bias: str = "{constant: 2, slope: 0.5}"


TECHNIQUES = {
    "nearest": Technique("nearest", "{{type: nearest}}", (0,)),
    "bilinear": Technique("bilinear", "{{type: bilinear}}", (0,)),
    "castano": Technique("Castaño, size", "{{type: castano, size: {:g}}}", (3, 5, 7)),
    "box": Technique("box, radius", "{{type: pcf, radius: {:g}}}", (1, 2, 4)),
    "disk": Technique(
        "random disk, taps",
        "{{type: random_disk, samples: {:g}}}",
        (4, 8, 16, 32),
        (common.BIAS, "bias.slope", common.RADIUS),
    ),
    "pcss": Technique(
        "PCSS, taps",
        "{{type: pcss, samples: {:g}, search_samples: 8, max_radius: 12}}",
        (8, 32),
        (common.BIAS,),
        "{constant: 1, plane: {type: receiver_plane, deepening: 0}}",
    ),
    "vsm": Technique("VSM, radius", "{{type: vsm, radius: {:g}}}", (1, 3), (common.BIAS, "filter.light_bleeding")),
    "evsm": Technique("EVSM, radius", "{{type: evsm, radius: {:g}}}", (1, 3), (common.BIAS, "filter.light_bleeding")),
    "msm": Technique("MSM, radius", "{{type: msm, radius: {:g}}}", (1, 3), (common.BIAS, "filter.light_bleeding")),
}

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    config: Path, /, *overrides: str, only: str = ",".join(TECHNIQUES), repeats: int = 25, most: int = 4
) -> dict[str, Any]:
    """Fits and times the techniques on the scene of CONFIG.

    Parameters
    ----------
    config
        YAML file with the scene, the map and the solver.
    overrides
        KEY=VALUE pairs that replace values of the file.
    only
        Which techniques, separated by commas.
    repeats
        Number of runs per time, which is their median.
    most
        Number of settings of each technique, the cheapest first.
    """
    console = Console()
    names = common.chosen("only", only, TECHNIQUES)
    common.expect("repeats", repeats, repeats > 0, "1 or more")
    common.expect("most", most, most > 0, "1 or more")
    drawn = common.draw(common.load(config, overrides))
    cases = [(name, setting) for name in names for setting in TECHNIQUES[name].settings[:most]]
    rows, runs = [], {}
    for name, setting in common.progress(cases, "fitting", console):
        row, runs[f"{name} {setting:g}"] = fitted(config, overrides, drawn, name, setting)
        rows.append(row)
    # Drawing the map is the same for all techniques: the first one is timed.
    first = load_config(config, [*overrides, *replaced(TECHNIQUES[names[0]], cases[0][1])])
    runs["map"] = lambda: build_technique(first, fitting=False).prepare(drawn.scene)
    times = common.median_ms(runs, repeats, console)
    for (name, setting), row in zip(cases, rows, strict=True):
        row["milliseconds"] = times[f"{name} {setting:g}"]
    kept = common.pareto([row["milliseconds"] for row in rows], [row["rmse"] for row in rows])
    for i, row in enumerate(rows):
        row["pareto"] = i in kept
    summary = {
        "config": str(config),
        "overrides": list(overrides),
        "reference_noise": drawn.floor,
        "map_milliseconds": times["map"],
        "repeats": repeats,
        "pixels": list(drawn.settings.scene.camera.resolution),
    }
    show(console, rows, summary)
    folder = common.write(drawn.settings, NAME, picture(rows, kept, summary), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def replaced(technique: Technique, setting: float) -> list[str]:
    """The overrides of a technique at a setting, with its fitted parameters."""
    bounds = ", ".join(f"{name}: {BOUNDS[name]}" for name in technique.fitted)
    return [
        f"filter={technique.filter.format(setting)}",
        f"bias={technique.bias}",
        "compare={type: hard}",
        f"fit.parameters={{{bounds}}}",
    ]


def fitted(
    config: Path, overrides: tuple[str, ...], drawn: common.Case, name: str, setting: float
) -> tuple[dict[str, Any], Callable[[], Any]]:
    """Fits a technique at a setting: its row of the table, and the function to time."""
    technique = TECHNIQUES[name]
    given = [*overrides, *replaced(technique, setting)]
    settings = load_config(config, given)
    problem = common.problem_of(drawn, settings)
    result = common.run_fit(settings, problem)
    bounds = settings.fit.parameters
    # Rounding to single precision may exceed a bound.
    values = {key: min(max(value, bounds[key].lower), bounds[key].upper) for key, value in result.fitted.items()}
    runs = [
        visibility_of(drawn, load_config(config, [*given, *(f"{key}={value:.8g}" for key, value in of.items())]))
        for of in (result.initial, values)
    ]
    before, after = (metrics.rmse(np.asarray(run()), drawn.truth.visibility, np.asarray(problem.mask)) for run in runs)
    row = {"technique": name, "setting": setting, "rmse": after, "rmse_before": before}
    return row | {key: values.get(key) for key in BOUNDS}, runs[1]


def visibility_of(drawn: common.Case, settings: Config) -> Callable[[], Any]:
    """The function to time: it computes visibility from a map that is already drawn."""
    technique = build_technique(settings, fitting=False)
    state = jax.block_until_ready(technique.prepare(drawn.scene))
    return functools.partial(technique.visibility, state, drawn.surface)


def show(console: Console, rows: list[dict[str, Any]], summary: dict[str, Any]) -> None:
    """The table."""
    title = f"medians of {summary['repeats']}; drawing the map takes {summary['map_milliseconds']:.1f} ms"
    table = Table("", "setting", "bias", "radius", "RMSE", "ms", "front", title=title, title_justify="left")
    for row in rows:
        values = ("" if row[key] is None else f"{row[key]:.3g}" for key in (common.BIAS, common.RADIUS))
        setting = f"{row['setting']:g}" if len(TECHNIQUES[row["technique"]].settings) > 1 else ""
        errors = (f"{row['rmse']:.4f}", f"{row['milliseconds']:.2f}", "*" if row["pareto"] else "")
        table.add_row(TECHNIQUES[row["technique"]].title, setting, *values, *errors)
    console.print(table)


def picture(rows: list[dict[str, Any]], kept: list[int], summary: dict[str, Any]) -> Any:
    """The figure."""
    made, (axes,) = common.figure(8.2, 4.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    front = [rows[i] for i in kept]
    x, y = ([row[key] for row in front] for key in ("milliseconds", "rmse"))
    axes.plot(x, y, color="#cfd5dc", linewidth=6, solid_capstyle="round", label="Pareto front")
    for i, name in enumerate(dict.fromkeys(row["technique"] for row in rows)):
        of, technique = [row for row in rows if row["technique"] == name], TECHNIQUES[name]
        x, y = ([row[key] for row in of] for key in ("milliseconds", "rmse"))
        style = common.curve(i)
        axes.plot(x, y, label=technique.title, **style)
        for row in of if len(technique.settings) > 1 else []:
            at = (row["milliseconds"], row["rmse"])
            offset = {"xytext": (4, 4), "textcoords": "offset points"}
            axes.annotate(f"{row['setting']:g}", at, fontsize=7, color=style["color"], **offset)
    about, (height, width) = common.machine(), summary["pixels"]
    common.chart(
        axes,
        "Error against time, each at its best bias",
        f"visibility of {width} × {height} pixels [ms]; {about['cpu']}, {about['cores']} cores, load {about['load']}",
        "RMSE [visibility]",
    )
    axes.grid(True, which="minor", color="#f0f2f5", linewidth=0.4)
    common.legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return made


if __name__ == "__main__":
    common.start(app)
