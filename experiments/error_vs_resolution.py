"""How fast does each technique's error fall with the shadow map's resolution?

    python experiments/error_vs_resolution.py configs/error_vs_resolution.yaml
    python experiments/error_vs_resolution.py configs/error_vs_resolution.yaml --sizes 64,256,1024 --only bilinear,pcss

Draws the configuration's scene with each technique from square maps of several sizes, and measures the root mean square
error of visibility against the reference, over the pixels that both the camera and the map see. Biases are in texels,
so they shrink with the texel like the error that they prevent. Some filters keep their width in texels and become
sharper; others keep it in world units and cover more texels.

The figure has resolution along x and error along y, both logarithmic. The legend has each technique's slope p of
error ~ resolution^p. A hard shadow's errors lie in a band along its outline that is a texel wide, and the root mean
square error is the root of the band's area: p = -1/2. The grey area is below the reference's own noise, where errors
are meaningless; slopes are fitted to the points above twice the noise.
"""

from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import numpy as np
from cyclopts import App
from rich.table import Table

from diffshadow.config import load_config
from diffshadow.console import Console

NAME = "error_vs_resolution"
NOMINAL = 1024
"""Map size in texels at which a width that grows with the map is given."""
ABOVE_NOISE = 2.0
"""Slopes include only errors above this many times the reference's noise."""


class Technique(NamedTuple):
    """A technique: its title, the values to replace, and the key of a length in texels that grows with the map, so that
    it is constant in world units, with its value for the nominal map."""

    title: str
    overrides: tuple[str, ...]
    growing: tuple[str, float] | None = None


PLAIN = "bias={constant: 0.5, slope: 1}"
WIDE = "bias={constant: 0.5, slope: 2.5}"
"""For kernels of several texels."""
PLANE = "bias={plane: {type: receiver_plane, deepening: 0}}"
"""For kernels so wide that only a receiver plane depth bias prevents acne."""
EDGES = "bias={constant: 1, plane: {type: receiver_plane, deepening: 0}}"
"""For silhouette maps, whose sub-texel outlines a slope bias would shift by texels."""
NO_FIT = "fit.parameters={bias.constant: {lower: 0, upper: 10}}"
"""Replaces the configuration's fit, whose parameters the technique may not have."""
TECHNIQUES = {
    "nearest": Technique("nearest", ("filter={type: nearest}", PLAIN)),
    "silhouettes": Technique(
        "nearest, with silhouettes", ("filter={type: nearest}", "shadow_map.silhouettes=true", EDGES)
    ),
    "bilinear": Technique("bilinear", ("filter={type: bilinear}", PLAIN)),
    "box": Technique("box, 2.5 texels", ("filter={type: pcf, radius: 2.5}", WIDE)),
    "disk": Technique(
        "random disk, constant in world units",
        ("filter={type: random_disk, samples: 32}", PLANE),
        ("filter.radius", 2.0),
    ),
    "pcss": Technique(
        "PCSS", ("filter={type: pcss, samples: 32, search_samples: 16}", PLANE), ("filter.max_radius", 24.0)
    ),
    "evsm": Technique("EVSM, 2 texels", ("filter={type: evsm, radius: 2}", PLAIN)),
}

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    config: Path,
    /,
    *overrides: str,
    sizes: str = "64,128,256,512,1024,2048",
    only: str = ",".join(TECHNIQUES),
) -> dict[str, Any]:
    """Measures the techniques on the scene of CONFIG.

    Parameters
    ----------
    config
        YAML file with the scene, its light and its reference.
    overrides
        KEY=VALUE pairs that replace values of the file.
    sizes
        Widths of the map, in texels, separated by commas.
    only
        Which techniques, separated by commas.
    """
    console = Console()
    widths = sorted(set(common.listed("sizes", sizes, int)))
    common.expect("sizes", sizes, len(widths) > 1 and widths[0] > 0, "two or more, each positive")
    names = common.chosen("only", only, TECHNIQUES)
    drawn = common.draw(common.load(config, overrides))
    rows = []
    for size in common.progress(widths, "drawing", console):
        for name in names:
            settings = load_config(config, [*overrides, *replaced(TECHNIQUES[name], size)])
            error = common.rmse(common.problem_of(drawn, settings, fitting=False))
            rows.append({"technique": name, "resolution": size, "rmse": error})
    slopes = {name: slope(widths, errors_of(rows, name), drawn.floor) for name in names}
    summary = {"config": str(config), "overrides": list(overrides), "reference_noise": drawn.floor, "slopes": slopes}
    show(console, rows, widths, slopes, drawn.floor)
    folder = common.write(drawn.settings, NAME, picture(rows, widths, slopes, drawn.floor), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def replaced(technique: Technique, size: int) -> list[str]:
    """The overrides of a technique with a map of `size` texels."""
    growing = [f"{key}={value * size / NOMINAL:g}" for key, value in filter(None, [technique.growing])]
    return [f"shadow_map.resolution=[{size}, {size}]", *technique.overrides, *growing, NO_FIT]


def errors_of(rows: list[dict[str, Any]], name: str) -> list[float]:
    """A technique's errors, by resolution."""
    return [row["rmse"] for row in rows if row["technique"] == name]


def slope(sizes: list[int], errors: list[float], floor: float) -> float | None:
    """The exponent p of the power law size^p that best fits `errors` in logarithms; none if too few are above the
    noise."""
    above = [(size, error) for size, error in zip(sizes, errors, strict=True) if error > ABOVE_NOISE * floor]
    if len(above) < 2:
        return None
    x, y = np.log(above).T
    return float(np.polyfit(x, y, 1)[0])


def show(console: Console, rows: list[dict[str, Any]], sizes: list[int], slopes: dict[str, Any], floor: float):
    """The table."""
    title = f"RMSE by the map's width in texels; reference noise {floor:.2g}"
    table = Table("", *map(str, sizes), "slope", title=title, title_justify="left")
    for name, of in slopes.items():
        errors = (f"{error:.4f}" for error in errors_of(rows, name))
        table.add_row(TECHNIQUES[name].title, *errors, "" if of is None else f"{of:.2f}")
    console.print(table)


def picture(rows: list[dict[str, Any]], sizes: list[int], slopes: dict[str, Any], floor: float) -> Any:
    """The figure."""
    made, (axes,) = common.figure(7.2, 4.4)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    for i, (name, of) in enumerate(slopes.items()):
        label = TECHNIQUES[name].title + ("" if of is None else f": {of:.2f}")
        axes.plot(sizes, errors_of(rows, name), label=label, **common.curve(i))
    # The power law of a hard shadow, drawn above the worst technique.
    top = 1.25 * max(row["rmse"] for row in rows if row["resolution"] == sizes[0])
    ends = np.array([sizes[0], sizes[-1]])
    axes.plot(ends, top * np.sqrt(sizes[0] / ends), color=common.FAINT, linestyle=":", label="slope −1/2")
    if floor > 0:
        axes.axhspan(floor / 100, floor, color="#e8ebef", linewidth=0, label="reference's noise")
    least = min(row["rmse"] for row in rows)
    axes.set_ylim(bottom=0.6 * min(least, floor or least))
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
    common.chart(axes, "Error against the map's resolution", "map's width [texels]", "RMSE [visibility]")
    common.legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5), title="technique: slope", alignment="left")
    return made


if __name__ == "__main__":
    common.start(app)
