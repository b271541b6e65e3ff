"""Does a fit find the best constant bias and filter radius? Compares it with a grid over both.

Runs the fit of a configuration, then measures the hard compare's error at each point of a grid that spans the bounds of
`bias.constant` and `filter.radius`, with all other fitted parameters held at their fitted values:

    python experiments/bias_radius_grid.py configs/quickstart.yaml
    python experiments/bias_radius_grid.py configs/quickstart.yaml filter.samples=64 --size 65

Prints a table, and after it one line of JSON. Errors are root mean squares over the pixels that both the camera and the
shadow map see, against the reference that the configuration names.
"""

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from cyclopts import App
from rich.console import Console
from rich.table import Table

from diffshadow.config import Config, build_casting, build_fit, build_technique, load_config
from diffshadow.fit import FitResult, Problem, fit, with_values
from diffshadow.geometry import Scene
from diffshadow.io import cached_arrays, read_visibility
from diffshadow.raster import draw_surface
from diffshadow.reference import Reference, cache_key, reference_from_image, trace_visibility
from diffshadow.shadow import ShadowMapping
from diffshadow.study import draw_from_light

AXES = ("bias.constant", "filter.radius")

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(config: Path, /, *overrides: str, size: int = 33) -> dict[str, Any]:
    """Fits CONFIG, and compares the fit with the best of a grid.

    Parameters
    ----------
    config
        YAML file that says what to fit; both bias.constant and filter.radius must be among its parameters.
    overrides
        KEY=VALUE pairs that replace values of the file.
    size
        Points of the grid along each axis.
    """
    settings = load_config(config, overrides)
    missing = [name for name in AXES if name not in settings.fit.parameters]
    if missing:
        raise ValueError(f"{config} does not fit {' and '.join(missing)}; expected both {AXES[0]} and {AXES[1]}")
    if size < 2:
        raise ValueError(f"size is {size}; expected 2 or more points along each axis")
    problem, noise = make_problem(settings)
    plan = build_fit(settings)
    result = fit(problem, plan.parameters, solver=plan.solver, anneal=plan.anneal)

    bounds = [settings.fit.parameters[name] for name in AXES]
    axes = [np.linspace(b.lower, b.upper, size) for b in bounds]
    started = time.perf_counter()
    errors = grid_of_errors(problem, result.technique, *axes)
    seconds = time.perf_counter() - started
    summary = summarise(problem, result, axes, errors) | {
        "config": str(config),
        "overrides": list(overrides),
        "size": size,
        "pixels": int(problem.mask.sum()),
        "reference_noise": noise,
        "seconds_fit": result.seconds_compiling + result.seconds_running,
        "seconds_grid": seconds,
    }
    show(summary)
    print(json.dumps(summary))
    return summary


def make_problem(settings: Config) -> tuple[Problem, float]:
    """The problem of a configuration, and the noise of its reference."""
    casting = build_casting(settings)
    scene = casting.scene
    technique = build_technique(settings)
    reference = make_reference(settings, scene)
    surface = draw_surface(scene.mesh, scene.camera)
    shadow_map = draw_from_light(settings, technique, casting)
    mask = technique.covered(shadow_map, surface) & jnp.asarray(reference.mask)
    return Problem(technique, shadow_map, surface, jnp.asarray(reference.visibility), mask), reference.noise_floor


def make_reference(settings: Config, scene: Scene) -> Reference:
    """The reference of a configuration; a traced one is kept on disk and found again."""
    wanted = settings.reference
    if wanted.type == "image":
        return reference_from_image(read_visibility(wanted.path), scene)
    sampling = (wanted.samples, wanted.sampler, settings.seed)
    arrays = cached_arrays(cache_key(scene, *sampling), lambda: dataclasses.asdict(trace_visibility(scene, *sampling)))
    return Reference(**{**arrays, "samples": int(arrays["samples"])})


@eqx.filter_jit
def hard_rmse(problem: Problem, technique: ShadowMapping, values: Any) -> Any:
    """The error with the two axes' parameters at `values` (2,)."""
    return jnp.sqrt(problem.mean_square_error(with_values(technique, AXES, values)))


def grid_of_errors(problem: Problem, technique: ShadowMapping, biases: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(biases, radii), the error at each point of the grid."""
    # Queued one after another and read at the end, so that the device never waits for Python.
    rows = [[hard_rmse(problem, technique, jnp.array([b, r], jnp.float32)) for r in radii] for b in biases]
    return np.array([[float(error) for error in row] for row in rows])


def summarise(problem: Problem, result: FitResult, axes: list[np.ndarray], errors: np.ndarray) -> dict[str, Any]:
    """The start, the fit and the grid's best, each with its error."""

    def point(values: Any) -> dict[str, float]:
        values = jnp.asarray([float(v) for v in values], jnp.float32)
        found = dict(zip(AXES, values.tolist(), strict=True))
        return found | {"rmse": float(hard_rmse(problem, result.technique, values))}

    b, r = np.unravel_index(np.argmin(errors), errors.shape)
    fitted = point([result.fitted[name] for name in AXES])
    best = point([axes[0][b], axes[1][r]])
    others = {name: value for name, value in result.fitted.items() if name not in AXES}
    return {
        "start": {**result.initial, "rmse": float(jnp.sqrt(start_error(problem, result)))},
        "fit": fitted,
        "grid": best,
        "ratio": fitted["rmse"] / best["rmse"] if best["rmse"] > 0 else None,
        "spacing": [float(axis[1] - axis[0]) for axis in axes],
        "held": others,
        "flat": result.flat,
        "steps": result.steps,
        "chosen_phase": result.chosen,
    }


def start_error(problem: Problem, result: FitResult) -> Any:
    """The mean square error where the fit began, all parameters at their initial values."""
    names = tuple(result.initial)
    return problem.mean_square_error(with_values(result.technique, names, jnp.array(list(result.initial.values()))))


def show(summary: dict[str, Any]) -> None:
    """The table."""
    spacing = summary["spacing"]
    title = f"hard RMSE over {summary['pixels']:,} pixels; reference noise {summary['reference_noise']:.2g}"
    table = Table("", *(f"{name} [texels]" for name in AXES), "RMSE", "seconds", title=title, title_justify="left")
    for name, label, seconds in (
        ("start", "start", ""),
        ("fit", f"fit, {summary['steps']} steps", f"{summary['seconds_fit']:.1f}"),
        ("grid", f"grid of {summary['size']} x {summary['size']}", f"{summary['seconds_grid']:.1f}"),
    ):
        row = summary[name]
        table.add_row(label, *(f"{row[axis]:.4g}" for axis in AXES), f"{row['rmse']:.5f}", seconds)
    if summary["ratio"] is not None:
        table.add_row("fit / grid", "", "", f"{summary['ratio']:.4f}", "")
    table.add_row("grid's spacing", *(f"{step:.3g}" for step in spacing), "", "")
    console = Console(highlight=False)
    console.print(table)
    if summary["held"]:
        console.print("held on the grid at their fitted values:", summary["held"])
    if summary["flat"]:
        console.print("without a gradient, not fitted:", ", ".join(summary["flat"]))


if __name__ == "__main__":
    try:
        app()
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
