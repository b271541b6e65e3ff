"""Are the standard deviations that fits report correct? Fits lights with known truth, and counts errors within them.

    python experiments/coverage.py configs/coverage.yaml
    python experiments/coverage.py configs/coverage.yaml --lights point --meshes spot_cow.obj,builtin:blob --draws 20

Each draw rotates the mesh, moves the camera and places the light at random, traces the shadow, and fits the light from
a random start near the truth. The error of a fit depends on where outlines fall among pixels and texels. Therefore the
scene is drawn at random, too: different starts in one scene would all have the same error. Sizes and technique come
from the configuration.

The figure has a panel for each light. It shows, for every parameter of every fit, the error over the reported
deviation, sorted, and the cumulative normal distribution. Above that line, deviations are too large; below it, too
small. The table has the fractions of errors within one and two deviations, which are 68 % and 95 % for a normal
distribution. The summary also has the root mean square of errors over deviations, which outliers make large.
"""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _common as common
import numpy as np
from cyclopts import App
from recover_light import angles
from rich.table import Table
from scipy.stats import norm

from diffshadow import fit
from diffshadow.config import build_fit, build_scene
from diffshadow.console import Console
from diffshadow.study import pose_problems

NAME = "coverage"
LIGHTS = ("directional", "spot", "point")
MESHES = ("builtin:torus_knot", "builtin:blob", "builtin:torus")
TILT = 20.0
"""Maximum tilt of a mesh, in degrees; it is rotated about the vertical by any angle."""
AROUND = {"eye": 0.3, "position": 0.4, "target": 0.1}
"""Maximum displacement of each point along each axis, in world units."""
OFF = {"azimuth": 1.0, "elevation": 1.0, "position": 0.04}
"""Standard deviation of a start from the truth, in degrees, or in world units along each axis."""
REACH = {"azimuth": 35.0, "elevation": 20.0, "position": 1.0}
"""Distance of bounds from the truth, in the same units."""
POSITION, TARGET = (-1.5, 2.8, 1.1), (0.1, 0.1, 0.0)

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


@app.default
def main(
    config: Path,
    /,
    *overrides: str,
    lights: str = ",".join(LIGHTS),
    meshes: str = ",".join(MESHES),
    draws: int = 10,
    seed: int = 0,
) -> dict[str, Any]:
    """Fits the lights over the meshes, and counts errors within the reported deviations.

    Parameters
    ----------
    config
        YAML file with the sizes, the technique and the camera.
    overrides
        KEY=VALUE pairs that replace values of the file.
    lights
        Kinds of light, separated by commas: directional, spot, point.
    meshes
        Mesh files, or builtin:NAME, separated by commas.
    draws
        Fits for each mesh and kind of light.
    seed
        Of the draws.
    """
    console = Console()
    kinds = common.chosen("lights", lights, LIGHTS)
    paths = common.listed("meshes", meshes)
    common.expect("draws", draws, draws >= 1, "1 or more")
    settings = common.load(config, overrides)
    jobs = [(kind, path, draw) for kind in kinds for path in paths for draw in range(draws)]
    rows, crossings = [], {}
    for kind, path, draw in common.progress(jobs, "fitting", console):
        rng = np.random.default_rng([seed, LIGHTS.index(kind), paths.index(path), draw])
        drawn = scene_of(kind, path, settings.scene.camera.eye or (0.6, 2.9, 2.4), rng)
        known = crossings.get((kind, path))
        found, crossings[kind, path] = fit_one(config, (*overrides, *drawn), rng, known)
        rows += [{"light": kind, "mesh": path, "draw": draw, **row} for row in found]
    covered = {kind: fractions_within([row for row in rows if row["light"] == kind]) for kind in kinds}
    covered["all"] = fractions_within(rows)
    show(console, covered)
    summary = {"config": str(config), "overrides": list(overrides), "seed": seed, "covered": covered}
    folder = common.write(settings, NAME, picture(rows, kinds), rows, summary)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder)}


def scene_of(kind: str, mesh: str, eye: Sequence[float], rng: np.random.Generator) -> tuple[str, ...]:
    """A random scene, as overrides."""
    turn = [*rng.uniform(-TILT, TILT, 1), *rng.uniform(0, 360, 1), *rng.uniform(-TILT, TILT, 1)]
    position = POSITION + rng.uniform(-1, 1, 3) * AROUND["position"]
    target = TARGET + rng.uniform(-1, 1, 3) * AROUND["target"]
    azimuth, elevation = angles((position - target) / np.linalg.norm(position - target)).tolist()
    light: dict[str, Any] = {"type": kind}
    if kind == "directional":
        light |= {"azimuth": azimuth, "elevation": elevation, "angular_radius": 0}
    else:
        light["position"] = position.tolist()
    if kind == "spot":
        light |= {"target": target.tolist(), "outer_angle": 24, "inner_angle": 20}
    truth = {} if kind == "point" else {"azimuth": azimuth, "elevation": elevation}
    truth |= (
        {} if kind == "directional" else {f"position.{a}": p for a, p in zip("xyz", position.tolist(), strict=True)}
    )
    bounds = {f"scene.light.{name}": within(name, value) for name, value in truth.items()}
    values = {
        "scene.meshes.0.path": mesh,
        "scene.meshes.0.rotate": [float(angle) for angle in turn],
        "scene.camera.eye": (eye + rng.uniform(-1, 1, 3) * AROUND["eye"]).tolist(),
        "scene.light": light,
        "fit.parameters": bounds,
    }
    return tuple(f"{key}={json.dumps(value)}" for key, value in values.items())


def within(name: str, value: float) -> dict[str, float]:
    """Bounds around the truth."""
    reach = REACH[name.split(".")[0]]
    return {"lower": value - reach, "upper": min(value + reach, 89.0) if name == "elevation" else value + reach}


def fit_one(
    config: Path, overrides: Sequence[str], rng: np.random.Generator, crossings: int | None
) -> tuple[list[Any], int]:
    """A row for each parameter of one fit, and its memory for `crossings`, which the next fit starts with."""
    settings = common.load(config, overrides)
    scene = build_scene(settings)
    plan = build_fit(settings, scene)
    (problem,) = pose_problems(settings, plan, scene)
    off = {p.name: OFF[p.name.split(".")[2]] * rng.normal() for p in plan.parameters}
    parameters = [dataclasses.replace(p, initial=plan.truth[p.name] + off[p.name]) for p in plan.parameters]
    # Twice what is planned here, so that few other draws need more and recompile.
    crossings = 2 * problem.planned().crossings if crossings is None else crossings
    problem = dataclasses.replace(problem, crossings=crossings)
    result = fit.fit(
        problem, parameters, solver=plan.solver, anneal=plan.anneal, search=fit.Search(blurs=plan.search.blurs)
    )
    deviations = {} if result.precision is None else result.precision.deviations
    rows = []
    for name, truth in plan.truth.items():
        error, deviation = result.fitted[name] - truth, deviations.get(name)
        ratio = error / deviation if deviation else None
        rows.append({"parameter": name, "truth": truth, "error": error, "deviation": deviation, "ratio": ratio})
    return rows, result.problems[0].crossings  # type: ignore[union-attr]


def fractions_within(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The fractions of errors within one and two deviations, and their number; errors without a deviation are counted
    separately."""
    ratios = np.abs([row["ratio"] for row in rows if row["ratio"] is not None])
    known = len(ratios) > 0
    return {
        "one": float(np.mean(ratios < 1)) if known else None,
        "two": float(np.mean(ratios < 2)) if known else None,
        "rms": float(np.sqrt(np.mean(ratios**2))) if known else None,
        "fits": len({(row["light"], row["mesh"], row["draw"]) for row in rows}),
        "values": len(ratios),
        "without": len(rows) - len(ratios),
    }


def show(console: Console, covered: dict[str, dict[str, Any]]) -> None:
    """The table."""
    table = Table("light", "fits", "values", "within 1", "within 2", "rms", "no deviation")
    text = lambda value, form: "" if value is None else format(value, form)
    for kind, row in covered.items():
        numbers = text(row["one"], ".0%"), text(row["two"], ".0%"), text(row["rms"], ".2f")
        table.add_row(kind, str(row["fits"]), str(row["values"]), *numbers, str(row["without"]))
    console.print(table)


def picture(rows: Sequence[dict[str, Any]], kinds: Sequence[str]) -> Any:
    """The figure."""
    made, panels = common.figure(3.6 * len(kinds), 3.6, 1, len(kinds))
    for panel, kind in zip(np.atleast_1d(panels), kinds, strict=True):
        ratios = np.sort([abs(row["ratio"]) for row in rows if row["light"] == kind and row["ratio"] is not None])
        panel.plot(ratios, (np.arange(len(ratios)) + 0.5) / max(len(ratios), 1), ".-", ms=3, lw=1, label="errors")
        normal = np.linspace(0, 4, 200)
        panel.plot(normal, 2 * norm.cdf(normal) - 1, color=common.FAINT, lw=1, label="normal distribution")
        common.chart(panel, kind, "error over reported deviation", "fraction of errors below")
        panel.set(xlim=(0, 4), ylim=(0, 1.02))
        common.legend(panel, loc="lower right")
    return made


if __name__ == "__main__":
    common.start(app)
