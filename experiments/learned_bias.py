"""Does a bias gain by knowing more of the receiver, and a kernel by free weights?

    python experiments/learned_bias.py configs/learned_bias.yaml
    python experiments/learned_bias.py configs/learned_bias.yaml --steps 400 scene.light.angular_radius=1

Fits each model to the training views together, and measures it in the validation views, which have other suns, other
directions of the camera and, half of them, other meshes; all under the hard compare. The models are pairs of a bias and
a kernel, and both are fitted at once:

- biases: `classical`, constant, slope and normal offset; `linear`, a linear combination of all features and a normal
  offset; `perceptron`, the same corrected by a perceptron with one hidden layer.
- kernels: `tent`, whose radius is fitted; `castano`, of 7 x 7 texels, which has nothing to fit; `separable`, of 7 x 7
  texels, with three free weights.

Every model but the first starts from the end of a simpler one that it contains, or nearly so: a kernel cannot start
from another kind of kernel. Adam fits each, and Levenberg-Marquardt then those without a network. By itself the latter
leaves constant and slope bias in a local minimum, and all others would seem better than they are.

The figure has the root mean square error (RMSE) in each validation view over that of the first model, and the view with
the largest gain. The folder also has the perceptron with the separable kernel as GLSL, and as a configuration that
`diffshadow render` draws.
"""

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import _common as common
import equinox as eqx
import jax
import numpy as np
from cyclopts import App
from rich.table import Table

from diffshadow import fit, io, shadow
from diffshadow.config import Config, build_fit, dump_resolved, load_config
from diffshadow.console import Console
from diffshadow.shadow.biases import FEATURES

NAME = "learned_bias"
# Mesh, azimuth and elevation of the camera, azimuth and elevation of the sun.
View = tuple[str, int, int, int, int]
TRAINING: tuple[View, ...] = (
    ("torus_knot", 30, 35, -60, 50),
    ("chair", 100, 20, 10, 35),
    ("blob", 170, 45, 120, 65),
    ("torus", 240, 25, 200, 30),
    ("fence", 310, 35, 280, 55),
    ("box", 20, 50, 60, 25),
    ("torus_knot", 90, 25, 160, 70),
    ("chair", 160, 40, 230, 20),
    ("blob", 230, 20, -20, 40),
    ("torus", 300, 55, 80, 60),
)
VALIDATION: tuple[View, ...] = (
    ("torus_knot", 200, 30, 30, 30),
    ("chair", 330, 30, 110, 55),
    ("blob", 60, 30, 250, 25),
    ("fence", 130, 25, 180, 40),
    ("sphere", 0, 30, -50, 35),
    ("low_poly_sphere", 80, 40, 140, 50),
    ("thin_wall", 150, 25, 70, 45),
    ("sphere", 260, 20, 210, 65),
)
TENT_RADIUS, MAX_RADIUS = 2.0, 4.0
HIDDEN = (8,)
# Of Adam. A few weights, in texels, have farther to go than those of a network.
NETWORK_RATE, RATE = 0.03, 0.1

app = App(help=__doc__, help_format="plaintext", result_action="return_value")


class Model(NamedTuple):
    """A bias and a kernel, and the model from whose end the fit starts; none for the configuration's bias."""

    bias: str
    kernel: str
    start: str | None = None


MODELS = {
    "classical, tent": Model("classical", "tent"),
    "linear, tent": Model("linear", "tent", "classical, tent"),
    "perceptron, tent": Model("perceptron", "tent", "linear, tent"),
    "classical, castano": Model("classical", "castano", "classical, tent"),
    "classical, separable": Model("classical", "separable", "classical, tent"),
    "perceptron, separable": Model("perceptron", "separable", "classical, separable"),
}
FIRST, LAST = next(iter(MODELS)), list(MODELS)[-1]


@app.default
def main(config: Path, /, *overrides: str, views: int = len(TRAINING), steps: int = 150) -> dict[str, Any]:
    """Fits and measures all models on the views of CONFIG.

    Parameters
    ----------
    config
        YAML file with the scene; its camera must have an orbit, and its light must be directional with angles.
    overrides
        KEY=VALUE pairs that replace values of the file.
    views
        How many of the training views, and at most how many of the validation views.
    steps
        Steps of Adam in each phase of a fit.
    """
    console = Console()
    common.expect("views", views, 1 <= views <= len(TRAINING), f"1 to {len(TRAINING)}")
    common.expect("steps", steps, steps >= 1, "1 or more")
    settings = common.load(config, overrides)
    if settings.scene.camera.orbit is None:
        raise common.mistake(settings, "scene.camera", "has an eye; expected an orbit, which is varied: give one")
    training, validation = (
        [problem_of(config, overrides, view) for view in common.progress(chosen[:views], "tracing", console)]
        for chosen in (TRAINING, VALIDATION)
    )
    plan = build_fit(settings)
    found: dict[str, fit.Training] = {}
    rows, errors = [], {}
    for name, model in common.progress(MODELS.items(), "fitting", console):
        began = time.perf_counter()
        base = training[0].technique if model.start is None else found[model.start].technique
        has_network = model.bias == "perceptron"
        adam = fit.Solver("adam", steps, 1e-7, 1e-9, NETWORK_RATE if has_network else RATE)
        made = started(model, settings, base)
        for solver in (adam,) if has_network else (adam, plan.solver):
            starts = [dataclasses.replace(problem, technique=made) for problem in training]
            found[name] = fit.train(starts, fitted, lower=(-np.inf, 0.0, 0.0), solver=solver, anneal=plan.anneal)
            made = found[name].technique
        errors[name] = [common.rmse(problem, made) for problem in validation]
        rows.append(
            {
                "bias": model.bias,
                "kernel": model.kernel,
                "numbers": sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(fitted(made), eqx.is_inexact_array))),
                "training": found[name].loss ** 0.5,
                "validation": fit.mean_square_error(validation, made) ** 0.5,
                "seconds": time.perf_counter() - began,
            }
        )
    show(console, rows)
    summary = {
        "config": str(config),
        "overrides": list(overrides),
        "training_views": TRAINING[:views],
        "validation_views": VALIDATION[:views],
        "rmse_by_view": errors,
        "normal_offset": {name: float(made.technique.bias.normal_offset.value) for name, made in found.items()},
        "terms": {name: linear_weights(made.technique) for name, made in found.items()},
        "weights": {
            name: [float(weight) for weight in made.technique.filter.weights]
            for name, made in found.items()
            if isinstance(made.technique.filter, shadow.Separable)
        },
    }
    drawn = picture(validation, errors, found)
    folder = common.write(settings, NAME, drawn, rows, summary)
    technique = found[LAST].technique
    for ending, text in (
        ("glsl", shadow.to_shader(technique, validation[0].shadow_map.light)),
        ("yaml", as_configuration(config, overrides, technique)),
    ):
        with io.atomic_path(folder / f"{NAME}.{ending}") as temporary:
            temporary.write_text(text)
    console.print(str(folder), soft_wrap=True)
    return {**summary, "rows": rows, "folder": str(folder), "technique": technique, "problems": validation}


def problem_of(config: Path, overrides: Sequence[str], view: View) -> fit.TechniqueProblem:
    """A view's problem. Its technique is the configuration's bias, as terms, under a tent."""
    mesh, *angles = view
    keys = ("camera.orbit.azimuth", "camera.orbit.elevation", "light.azimuth", "light.elevation")
    turned = [f"scene.{key}={angle}" for key, angle in zip(keys, angles, strict=True)]
    named = f"scene.meshes.0.path=builtin:{mesh}", "scene.meshes.0.options={}"
    settings = load_config(config, [*overrides, *turned, *named])
    given, drawn = settings.bias, common.draw(settings)
    terms = shadow.LinearBias({"one": given.constant, "slope": given.slope})
    bias = shadow.Bias(normal_offset=given.normal_offset, terms=terms)
    problem = common.problem_of(drawn, settings)
    kernel = shadow.Tent(TENT_RADIUS, MAX_RADIUS)
    technique = shadow.ShadowMapping(kernel, bias, map=problem.technique.map)
    return dataclasses.replace(problem, technique=technique)


def fitted(technique: Any) -> Any:
    """What is fitted of every model."""
    return technique.bias.terms, technique.bias.normal_offset, technique.filter


def started(model: Model, settings: Config, base: Any) -> Any:
    """The technique that the fit of a model starts from, at the end of another model's."""
    terms = base.bias.terms
    if model.bias != "classical" and isinstance(terms, shadow.LinearBias):
        terms = shadow.LinearBias({name: terms.weights.get(name, 0.0) for name in FEATURES})
    if model.bias == "perceptron":
        terms = shadow.PerceptronBias.correcting(terms, HIDDEN, seed=settings.seed)
    kernel = base.filter
    if model.kernel == "castano":
        kernel = shadow.Castano(7)
    elif model.kernel == "separable" and not isinstance(kernel, shadow.Separable):
        weights = shadow.Castano(7).normalized
        kernel = shadow.Separable([float(weight / weights[0]) for weight in weights[1:]])
    return eqx.tree_at(lambda t: (t.bias.terms, t.filter), base, (terms, kernel))


def linear_weights(technique: Any) -> dict[str, float]:
    """The weights of a bias's linear terms, by feature."""
    return {name: float(weight) for name, weight in technique.bias.terms.weights.items()}


def as_configuration(config: Path, overrides: Sequence[str], technique: Any) -> str:
    """The configuration with a trained perceptron and kernel, every default written out."""
    bias, network = technique.bias, technique.bias.terms
    numbers = lambda array: np.asarray(array, np.float64).tolist()
    section = {
        "normal_offset": numbers(bias.normal_offset.value),
        "terms": linear_weights(technique),
        "network": {
            "hidden": [{"weight": numbers(layer.weight), "bias": numbers(layer.bias)} for layer in network.hidden],
            "last": numbers(network.last),
        },
    }
    kernel = {"type": "separable", "weights": [float(weight) for weight in technique.filter.weights]}
    parts = f"bias={json.dumps(section)}", f"filter={json.dumps(kernel)}", "fit={}"
    return dump_resolved(load_config(config, [*overrides, *parts]))


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """A table of all models."""
    table = Table(
        "bias", "kernel", "numbers", "training", "validation", "gain", "s", title="RMSE", title_justify="left"
    )
    for row in rows:
        gain = 1 - row["validation"] / rows[0]["validation"]
        cells = row["bias"], row["kernel"], row["numbers"], *(f"{row[key]:.4f}" for key in ("training", "validation"))
        table.add_row(*map(str, cells), f"{gain:+.1%}", f"{row['seconds']:.0f}")
    console.print(table)


def picture(
    problems: Sequence[fit.TechniqueProblem], errors: dict[str, list[float]], found: dict[str, fit.Training]
) -> Any:
    """The figure."""
    made, panels = common.figure(14.0, 4.4, 1, 4)
    ratios = {name: np.array(each) / np.maximum(errors[FIRST], 1e-12) for name, each in errors.items()}
    for number, (name, ratio) in enumerate(ratios.items()):
        panels[0].plot(ratio, "o-", color=common.COLOURS[number % len(common.COLOURS)], label=name, lw=0.8, ms=3)
    common.chart(panels[0], "Validation views", "", f"RMSE over that of {FIRST}")
    names = [view[0] for view in VALIDATION[: len(problems)]]
    panels[0].set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor", fontsize=7)
    common.legend(panels[0])
    best = int(np.argmin(ratios[LAST]))
    problem = problems[best]
    images = {"reference": np.asarray(problem.reference)}
    images |= {name: common.visibility(problem, found[name].technique) for name in (FIRST, LAST)}
    for panel, (name, image) in zip(panels[1:], images.items(), strict=True):
        panel.imshow(np.where(problem.mask, image, 1), cmap="gray", vmin=0, vmax=1, origin="lower")
        error = "" if name == "reference" else f", RMSE {errors[name][best]:.4f}"
        common.chart(panel, f"{names[best]}: {name}{error}", "", "", grid=False)
        panel.set_xticks([])
        panel.set_yticks([])
    return made


if __name__ == "__main__":
    common.start(app)
