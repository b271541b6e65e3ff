"""How accurately is a light recovered from one image of its shadow? Fits it from random starts, per mesh and light.

A mesh of the library, or from a file, stands on a plane under a directional, a spot or a point light. The target is the
hard shadow, traced with 4 x 4 camera rays per pixel. Starts are 20 degrees off (directional), or 20 % of the light's
distance off in a random direction (spot and point; a spot light's direction also by 20 degrees):

    python experiments/recover_light.py spot_cow.obj builtin:torus_knot
    python experiments/recover_light.py bunny.obj --lights directional --starts 20 --pixels 512

Prints a table, and then one line of JSON with, for each mesh and light: the median and the greatest error, in degrees
for a directional light and in percent of the scene's size for the others; the error's standard deviation as reported by
the fit, below which no fit to this image can be expected to get; and the fraction of starts that converged, that is,
ended within ten times the target of 0.05 degrees or 0.2 percent.
"""

import dataclasses
import json
import math
import sys
import time
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from cyclopts import App
from rich.table import Table

from diffshadow import fit, setup
from diffshadow.config import Config, build_fit, build_scene, parse_config
from diffshadow.console import Console
from diffshadow.study import pose_problems

Kind = Literal["directional", "spot", "point"]
LIGHTS: dict[Kind, dict[str, Any]] = {
    "directional": {"type": "directional", "azimuth": -55, "elevation": 52, "angular_radius": 0},
    "spot": {
        "type": "spot",
        "position": [-1.5, 2.8, 1.1],
        "target": [0.1, 0.1, 0.0],
        "outer_angle": 24,
        "inner_angle": 20,
    },
    "point": {"type": "point", "position": [-1.5, 2.8, 1.1]},
}
BARS = {"directional": 0.05, "spot": 0.2, "point": 0.2}
"""Target for the median error: degrees, or percent of the scene's size."""
CONVERGED = 10
"""A start has converged if its error is at most this many times the target."""
OFF_ANGLE, OFF_FRACTION = 20.0, 0.2

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    *meshes: str,
    lights: Sequence[Kind] = ("directional", "spot", "point"),
    starts: int = 20,
    pixels: int = 512,
    texels: int = 512,
    seed: int = 0,
) -> list[dict[str, Any]]:
    """Fits each light over each mesh.

    Parameters
    ----------
    meshes
        Mesh files, or builtin:NAME.
    lights
        Kinds of light.
    starts
        Random starts for each mesh and light.
    pixels
        Side of the image.
    texels
        Side of the shadow map.
    seed
        Of the starts.
    """
    if not meshes:
        raise ValueError("no mesh is given; expected mesh files, or names such as builtin:torus_knot")
    if starts < 1:
        raise ValueError(f"starts is {starts}; expected 1 or more")
    console = Console()
    rows = []
    for mesh in meshes:
        for kind in lights:
            rows.append(recover(mesh, kind, starts, pixels, texels, seed))
            console.print(f"{mesh}, {kind}: median error {rows[-1]['median']:.4g} {rows[-1]['unit']}")
    show(console, rows)
    print(json.dumps(rows))
    return rows


def configuration(mesh: str, kind: Kind, pixels: int, texels: int) -> Config:
    """The scene of one mesh and one light, and its fit."""
    bounds = {f"scene.light.{name}": limits for name, limits in limits_of(kind).items()}
    data = {
        "scene": {
            "meshes": [
                {"path": mesh, "size": 1.0, "drop_to_ground": True},
                {"path": "builtin:plane", "options": {"size": 4}},
            ],
            "camera": {"resolution": [pixels] * 2, "eye": [0.6, 2.9, 2.4], "target": [0.2, 0.1, -0.1], "fov_y": 42},
            "light": LIGHTS[kind],
        },
        "shadow_map": {"resolution": [texels, texels]},
        "bias": {"constant": 0.5, "plane": {"type": "receiver_plane", "deepening": 0.5}},
        "filter": {"type": "bilinear"},
        "reference": {"type": "traced", "supersampling": 4},
        "fit": {"parameters": bounds},
    }
    return parse_config(json.dumps(data), source=f"the scene of {mesh}")


def limits_of(kind: Kind) -> dict[str, dict[str, float]]:
    """Bounds wide enough for every start."""
    light = LIGHTS[kind]
    if kind == "directional":
        azimuth, elevation = light["azimuth"], light["elevation"]
        # At this elevation, a direction 20 degrees off can differ in azimuth by up to twice as much.
        return {
            "azimuth": {"lower": azimuth - 80, "upper": azimuth + 80},
            "elevation": {"lower": elevation - 32, "upper": elevation + 32},
        }
    position = np.asarray(light["position"])
    reach = 0.4 * float(np.linalg.norm(position))
    limits = {f"position.{a}": {"lower": p - reach, "upper": p + reach} for a, p in zip("xyz", position, strict=True)}
    if kind == "spot":
        limits |= {"azimuth": {"lower": -150.0, "upper": 50.0}, "elevation": {"lower": 15.0, "upper": 95.0}}
    return limits


def recover(mesh: str, kind: Kind, starts: int, pixels: int, texels: int, seed: int) -> dict[str, Any]:
    """Errors of the fits from random starts."""
    config = configuration(mesh, kind, pixels, texels)
    scene = build_scene(config)
    plan = build_fit(config, scene)
    problems = pose_problems(config, plan, scene)
    truth = np.asarray(list(plan.truth.values()))
    low, high = np.asarray(scene.mesh.bounds)
    size = float(np.linalg.norm(high - low))
    rng = np.random.default_rng(seed)
    errors, reported, seconds = [], [], []
    for _ in range(starts):
        begin = start_near(truth, kind, rng)
        pairs = zip(plan.parameters, begin, strict=True)
        parameters = [dataclasses.replace(p, initial=float(b)) for p, b in pairs]
        started = time.perf_counter()
        result = fit.fit(problems, parameters, solver=plan.solver, anneal=plan.anneal)
        seconds.append(time.perf_counter() - started)
        errors.append(error(kind, np.asarray(list(result.fitted.values())), truth, size))
        reported.append(deviation(kind, result, truth, size))
    return {
        "mesh": mesh,
        "light": kind,
        "unit": "degrees" if kind == "directional" else "% of the scene",
        "median": float(np.median(errors)),
        "deviation": float(np.median(reported)),
        "greatest": float(np.max(errors)),
        "converged": float(np.mean(np.asarray(errors) <= CONVERGED * BARS[kind])),
        "seconds": float(np.median(seconds)),
        "errors": errors,
    }


def start_near(truth: np.ndarray, kind: Kind, rng: np.random.Generator) -> np.ndarray:
    """A start off the truth, in a random direction."""
    if kind == "directional":
        return angles(tilted(direction(*truth), rng))
    position = truth[:3]
    aside = rng.normal(size=3)
    place = position + OFF_FRACTION * np.linalg.norm(position) * aside / np.linalg.norm(aside)
    return np.concatenate([place, angles(tilted(direction(*truth[3:]), rng))]) if kind == "spot" else place


def direction(azimuth: float, elevation: float) -> np.ndarray:
    """The unit vector at these angles in degrees."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)])


def angles(unit: np.ndarray) -> np.ndarray:
    """Azimuth and elevation of a unit vector, in degrees."""
    return np.degrees([math.atan2(unit[0], unit[2]), math.asin(np.clip(unit[1], -1, 1))])


def tilted(unit: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`unit` rotated by 20 degrees in a random direction."""
    aside = np.cross(unit, rng.normal(size=3))
    aside /= np.linalg.norm(aside)
    return math.cos(math.radians(OFF_ANGLE)) * unit + math.sin(math.radians(OFF_ANGLE)) * aside


def error(kind: Kind, found: np.ndarray, truth: np.ndarray, size: float) -> float:
    """Degrees between two directions, or the distance of two positions in percent of the scene's `size`."""
    if kind == "directional":
        return float(np.degrees(np.arccos(np.clip(direction(*found) @ direction(*truth), -1, 1))))
    return float(100 * np.linalg.norm(found[:3] - truth[:3]) / size)


def deviation(kind: Kind, result: fit.FitResult, truth: np.ndarray, size: float) -> float:
    """The standard deviation of `error` as reported by the fit, from the residuals of the image's pixels."""
    known = {} if result.precision is None else result.precision.deviations
    each = np.asarray([known.get(name, math.nan) for name in result.fitted])
    if kind == "directional":
        return float(np.hypot(each[0] * math.cos(math.radians(truth[1])), each[1]))
    return float(100 * np.linalg.norm(each[:3]) / size)


def show(console: Console, rows: Sequence[dict[str, Any]]) -> None:
    """The table."""
    table = Table("mesh", "light", "median error", "its deviation", "greatest", "unit", "converged", "seconds per fit")
    for row in rows:
        numbers = *(f"{row[name]:.3g}" for name in ("median", "deviation", "greatest")), row["unit"]
        table.add_row(row["mesh"], row["light"], *numbers, f"{row['converged']:.0%}", f"{row['seconds']:.1f}")
    console.print(table)


if __name__ == "__main__":
    setup()
    try:
        app()
    except (ValueError, OSError) as error_:
        sys.exit(f"error: {error_}")
