"""Does a fit's result hold in the engine itself? Draws a scene before and after its fit with the real three.js.

    python experiments/in_the_engine.py configs/three_js.yaml
    python experiments/in_the_engine.py configs/three_js.yaml scene.light.elevation=60 --grid 9

Fits the configuration, whose technique is three.js, and then draws the same scene with the engine in headless Chromium:
with the engine's defaults, with the values before the fit, and with the fitted ones. The table compares what the
library predicts with what the engine draws, and both with the ray-traced truth. Pixels are equal if their visibility
differs by at most 1/255: of the library's own picture, and of one at the receivers that the engine's camera sees, which
places vertices at coarser steps.

With `--grid`, the engine also draws a grid over the bounds of all fitted parameters, and the fit's error in the engine
is compared with the least of the grid. Chromium draws without graphics hardware and places vertices at steps of 1/16
texel, so the prediction does so, too (`technique.subpixels`).

It needs node, Chromium and three packages, and says how to install what is missing.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import _common as common
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from engines.engines import draw, missing, vertex_normals
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from diffshadow import fit
from diffshadow.config import ThreeJsConfig
from diffshadow.shadow import ThreeJs, ThreeJsLight
from diffshadow.study import style

NAME = "in_the_engine"
SUBPIXELS = "technique.subpixels=16"
"""What Chromium does without graphics hardware."""
NEAR = 1 / 255
STATES = ("defaults", "before", "after")
SETTINGS = ("bias", "normal_bias", "radius")

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *overrides: str, grid: int = 0, output: Path | None = None) -> dict[str, Any]:
    """Fits CONFIG, and draws it with the engine.

    Parameters
    ----------
    config
        YAML file with the fit; its technique must be three.js.
    overrides
        KEY=VALUE pairs that replace values of the file.
    grid
        Points of the engine's grid along each fitted parameter; 0 for no grid.
    output
        Folder of the results' folder, instead of the configuration's.
    """
    console = Console(highlight=False)
    common.expect("grid", grid, grid == 0 or 2 <= grid <= 32, "0, or 2 to 32 points")
    to = () if output is None else (f"output={output}",)
    settings = common.load(config, (*overrides, SUBPIXELS, *to))
    if not isinstance(settings.technique, ThreeJsConfig):
        what = f"is {settings.technique.type}; expected three.js, which can be drawn here: change it"
        raise common.mistake(settings, "technique.type", what)
    lack = missing()
    if lack is not None:
        raise common.mistake(settings, "technique.type", lack)
    case = common.draw(settings)
    problem = common.problem_of(case)
    result = common.run_fit(settings, problem)
    after = result.technique
    assert isinstance(after, ThreeJs)
    names = list(result.fitted)
    with_values = lambda values: fit.with_values(after, [name.removeprefix("technique.") for name in names], values)
    plain = ThreeJs()
    defaults = eqx.tree_at(_numbers, after, _numbers(plain))
    techniques = {"defaults": defaults, "before": with_values(jnp.array([*result.initial.values()])), "after": after}
    bounds = [settings.fit.parameters[name] for name in names]
    # The last varies fastest. With VSM, the engine blurs a map once for each radius.
    points = [np.linspace(each.lower, each.upper, grid) for each in bounds]
    cells = list(itertools.product(*points)) if grid else []
    on_grid = [with_values(jnp.array(cell)) for cell in cells]
    console.print("drawing with three.js")
    (drawing,) = draw([_job(case, after, [*techniques.values(), *on_grid])])
    pictures = drawing.arrays["grid"]
    mask = np.asarray(problem.mask) & (drawing.arrays["mesh"] >= 0)
    surface = dataclasses.replace(
        case.surface,
        position=jnp.asarray(drawing.arrays["position"]),
        interpolated_normal=jnp.asarray(drawing.arrays["normal"]),
    )
    there = dataclasses.replace(problem, surface=surface)
    error = lambda picture: float(np.sqrt(np.mean((picture - case.truth.visibility)[mask] ** 2)))
    rows = []
    for name, picture in zip(STATES, pictures, strict=False):
        predicted, at_engines = (common.visibility(each, techniques[name]) for each in (problem, there))
        close, same = (np.abs(image - picture)[mask] <= NEAR for image in (predicted, at_engines))
        rows.append(
            {
                "state": name,
                **dict(zip(SETTINGS, map(float, _numbers(techniques[name])), strict=True)),
                "rmse_engine": error(picture),
                "rmse_predicted": error(predicted),
                "within_1_255": float(close.mean()),
                "within_1_255_at_engine": float(same.mean()),
            }
        )
    summary: dict[str, Any] = {
        "config": str(config),
        "overrides": list(overrides),
        "engine": drawing.info["version"],
        "pixels": int(mask.sum()),
    }
    if grid:
        errors = [error(picture) for picture in pictures[len(STATES) :]]
        best = int(np.argmin(errors))
        summary |= {
            "grid_best": errors[best],
            "grid_at": dict(zip(names, map(float, cells[best]), strict=True)),
            "ratio": rows[-1]["rmse_engine"] / errors[best],
        }
    _show(console, rows, summary)
    made = _picture(case.truth.visibility, dict(zip(STATES, pictures, strict=False)), mask, rows)
    folder = common.write(settings, NAME, made, rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def _numbers(technique: ThreeJs) -> list[Any]:
    """What a fit of three.js may change."""
    return [technique.bias, technique.normal_bias, technique.radius]


def _job(case: common.Case, technique: ThreeJs, settings: list[ThreeJs]) -> dict[str, Any]:
    """The scene as the driver takes it, with a drawing for each of `settings`."""
    scene = case.scene
    light = ThreeJsLight.of(scene.light, technique.resolution)
    height, width = technique.resolution
    camera = scene.camera.view()
    sides = lambda given: [given] * len(scene.meshes) if given is None or isinstance(given, str) else list(given)
    meshes = []
    for i, mesh in enumerate(scene.meshes):
        vertices, normals, faces = vertex_normals(mesh.vertices, mesh.faces, mesh.corner_normals)
        meshes.append(
            {
                "vertices": vertices,
                "normals": normals,
                "faces": faces,
                "casts": scene.casts is None or scene.casts[i],
                "side": sides(technique.side)[i],
                "shadowSide": sides(technique.shadow_side)[i],
            }
        )
    given: dict[str, Any] = {
        "type": light.type,
        "position": light.position,
        "mapSize": [width, height],
        "camera": {**(light.window or {}), "near": light.near, "far": light.far},
        **({} if light.target is None else {"target": light.target}),
        **({} if light.angle is None else {"angle": light.angle, "aspect": light.aspect}),
        **_shadow(technique),
    }
    rows, columns = case.surface.mask.shape
    return {
        "engine": "three",
        "width": columns,
        "height": rows,
        "meshes": meshes,
        "light": given,
        "shadowType": technique.shadow_type.removesuffix("ShadowMap"),
        "reversedDepthBuffer": technique.reversed_depth,
        "camera": {"view": np.asarray(camera.world_to_eye), "projection": np.asarray(camera.eye_to_clip)},
        "outputs": ["mesh", "position", "normal"],
        "grid": [_shadow(each) for each in settings],
    }


def _shadow(technique: ThreeJs) -> dict[str, Any]:
    """light.shadow's own settings."""
    return {
        "bias": float(technique.bias),
        "normalBias": float(technique.normal_bias),
        "radius": float(technique.radius),
        "intensity": float(technique.intensity),
        "blurSamples": technique.blur_samples,
    }


def _show(console: Console, rows: list[dict[str, Any]], summary: dict[str, Any]) -> None:
    """Prints the errors, and how well they were predicted."""
    table = Table()
    table.add_column("", no_wrap=True)
    for title in (
        "bias",
        "normalBias",
        "radius",
        "RMSE, engine",
        "RMSE, predicted",
        "equal",
        "equal, at its receivers",
    ):
        table.add_column(title, justify="right")
    for row in rows:
        numbers = [f"{row[key]:.4g}" for key in SETTINGS]
        errors = [f"{row[key]:.4f}" for key in ("rmse_engine", "rmse_predicted")]
        shares = [f"{row[key]:.2%}" for key in ("within_1_255", "within_1_255_at_engine")]
        table.add_row(row["state"], *numbers, *errors, *shares)
    console.print(table)
    if "ratio" in summary:
        at = ", ".join(f"{name.removeprefix('technique.')} {value:.4g}" for name, value in summary["grid_at"].items())
        console.print(
            f"the least error of the engine's grid is {summary['grid_best']:.4f}, at {at}; the fit's is "
            f"{summary['ratio']:.3f} times as large"
        )


def _picture(
    truth: np.ndarray, pictures: dict[str, np.ndarray], mask: np.ndarray, rows: list[dict[str, Any]]
) -> Figure:
    """The truth beside what the engine draws."""
    panels = {"ray-traced": truth} | pictures
    height, width = truth.shape
    made, axes = common.figure(2.9 * len(panels), 2.9 * height / width + 0.3, 1, len(panels))
    errors = {row["state"]: f", RMSE {row['rmse_engine']:.4f}" for row in rows}
    for one, (name, image) in zip(axes, panels.items(), strict=True):
        shown = np.where(mask, image, np.nan)
        one.imshow(shown, origin="lower", cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        one.set_xticks([])
        one.set_yticks([])
        style.title(one, f"{'' if name == 'ray-traced' else 'three.js, '}{name}{errors.get(name, '')}")
    return made


if __name__ == "__main__":
    common.start(app)
