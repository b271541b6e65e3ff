"""Common code of experiments: drawing a scene and finding its truth, figures in one style, and writing results."""

import csv
import io as text_io
import json
import os
import platform
import shlex
import statistics
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from cyclopts import App, CycloptsError
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.progress import track
from rich.text import Text

from diffshadow import fit, geometry, io, limit_programs, raster, reference, setup
from diffshadow.config import (
    Config,
    ConfigError,
    Location,
    Mistake,
    build_fit,
    build_fittable,
    build_scene,
    load_config,
)
from diffshadow.console import Console
from diffshadow.settings.reference import ImageReference
from diffshadow.study import style

BIAS, RADIUS = "bias.constant", "filter.radius"
"""The two parameters that most experiments study."""

USER_ERROR, INTERRUPTED = 2, 130

# The style of a run's figures.
INK, FAINT = style.INK, style.FAINT
# At import, since experiments make arrays when they are imported. `start` lets compiled programs be kept.
setup(programs=False)

COLOURS, HEAT = style.CYCLE, style.DISTANCE
figure, colour_bar, curve = style.figure, style.colour_bar, style.curve
_DPI = 100


class Case(NamedTuple):
    """A scene as the camera sees it, and its truth.

    - `settings`: the configuration it was made from.
    - `floor`: noise of the truth, in visibility; 0 if it is exact, or from a file.
    """

    settings: Config
    scene: geometry.Scene
    surface: raster.Surface
    truth: reference.Reference
    floor: float


def load(config: Path, overrides: Sequence[str], needs: Sequence[str] = (), *, shape: bool = False) -> Config:
    """The configuration of an experiment, which has one light.

    **Arguments:**

    - `needs`: parameters that its fit must have.
    - `shape`: whether it has a fit of a shape instead, and one light or several.

    **Raises** `ConfigError` if it cannot be used, or its output cannot be written.
    """
    settings = load_config(config, overrides, fitting=shape)
    if shape and settings.fit.shape is None:
        what = "is missing; expected the fit of a shape: add it as in configs/shape_from_shadows.yaml"
        raise mistake(settings, "fit.shape", what)
    if not shape and len(settings.scene.each_light) > 1:
        raise mistake(settings, "scene.lights", "has several lights; expected one light: write it as scene.light")
    for name in needs:
        if name not in settings.fit.parameters:
            what = f"has no {name}; expected it among the fitted parameters: add '{name}: {{lower: 0, upper: 10}}'"
            raise mistake(settings, "fit.parameters", what)
    try:
        io.check_writable(settings.output_folder)
    except io.FileError as error:
        raise mistake(settings, "output", str(error)) from error
    return settings


def mistake(settings: Config, key: str, what: str) -> ConfigError:
    """An error reported for `key` of a configuration."""
    return ConfigError([Mistake(settings.origin.place(tuple(key.split("."))), key, what)])


def expect(option: str, given: Any, fine: bool, expected: str) -> None:
    """**Raises** `ConfigError` unless the value `given` for an option is `fine`."""
    if not fine:
        raise ConfigError([Mistake(Location(f"--{option}"), "", f"is {given}; expected {expected}")])


def listed(option: str, given: str, of: Callable[[str], Any] = str) -> list[Any]:
    """The entries of a comma-separated option, each converted by `of`.

    **Raises** `ConfigError` if an entry cannot be converted.
    """
    try:
        return [of(word.strip()) for word in given.split(",")]
    except ValueError:
        what = {int: "whole numbers", float: "numbers"}[of]  # type: ignore[index]
        message = f"is {given!r}; expected {what} separated by commas, such as 1,2,4"
        raise ConfigError([Mistake(Location(f"--{option}"), "", message)]) from None


def chosen[Name: str](option: str, given: str, among: Collection[Name]) -> list[Name]:
    """The names in a comma-separated option.

    **Raises** `ConfigError` if one is not `among` the known names.
    """
    names = listed(option, given)
    expect(option, given, set(names) <= set(among), f"some of {','.join(among)}")
    return names


def draw(settings: Config) -> Case:
    """The scene of a configuration and its truth.

    **Raises** `ConfigError` if the scene cannot be made, or the camera sees none of it.
    """
    scene = build_scene(settings)
    surface = raster.draw_surface(scene.mesh, scene.camera)
    if not bool(surface.mask.any()):
        raise mistake(settings, "scene.camera", "sees no surface; expected one at some pixel: move or turn it")
    truth = truth_of(settings, scene)
    return Case(settings, scene, surface, truth, truth.noise_floor if truth.samples else 0.0)


def truth_of(settings: Config, scene: geometry.Scene) -> reference.Reference:
    """The truth of a scene with one light; a traced one is cached on disk."""
    section = settings.reference
    if isinstance(section, ImageReference):
        try:
            return reference.reference_from_image(io.read_visibility(section.path), scene)
        except ValueError as error:
            raise mistake(settings, "reference.path", str(error)) from error
    how = section.how(settings.seed)
    traced = lambda: vars(reference.trace_visibility(scene, **how))
    arrays = io.cached_arrays(reference.key_parts(scene, **how), traced)
    return reference.Reference(**{**arrays, "samples": int(arrays["samples"])})  # type: ignore[arg-type]


def problem_of(drawn: Case, settings: Config | None = None, *, fitting: bool = True) -> fit.TechniqueProblem:
    """The problem of fitting the shadow mapping of `settings`, by default the scene's, to the truth.

    **Arguments:**

    - `fitting`: whether the filter's radius may later be set to any value within its bounds.

    **Raises** `ConfigError` if no pixel's surface is seen by both camera and light.
    """
    settings = settings or drawn.settings
    technique = build_fittable(settings, fitting=fitting)
    problem = fit.TechniqueProblem.of(drawn.scene, technique, drawn.truth, surface=drawn.surface)
    if not bool(problem.mask.any()):
        what = "and the camera see no surface together; expected both to see the same part of the scene: move one"
        raise mistake(settings, "scene.light", what)
    return problem


def run_fit(settings: Config, problem: fit.TechniqueProblem | Sequence[fit.TechniqueProblem]) -> fit.FitResult:
    """Runs the fit of `settings`, of one problem or jointly of several.

    **Raises** `ConfigError` if nothing in it can be fitted.
    """
    plan = build_fit(settings)
    try:
        return fit.fit(
            problem,
            plan.parameters,
            solver=plan.solver,
            anneal=plan.anneal,
            search=fit.Search(evaluations=plan.search.evaluations),
            loss=plan.loss,
        )
    except ValueError as error:
        raise mistake(settings, "fit", str(error)) from error


def rmse(problem: fit.TechniqueProblem, technique: Any = None) -> float:
    """The error of a problem's technique, or of another one instead, over the pixels that count."""
    return float(jnp.sqrt(_mean_square(problem.padded(), problem.technique if technique is None else technique)))


def visibility(problem: fit.TechniqueProblem, technique: Any = None) -> np.ndarray:
    """The visibility by a problem's technique, or by another one instead: (h, w)."""
    return np.asarray(_visibility(problem.padded(), problem.technique if technique is None else technique))


_visibility = eqx.filter_jit(lambda problem, technique: technique.visibility(problem.shadow_map, problem.surface))
_mean_square = eqx.filter_jit(lambda problem, technique: problem.mean_square_error(technique))


def median_ms(runs: Mapping[str, Callable[[], Any]], repeats: int, console: Console) -> dict[str, float]:
    """The median time of each of several runs in milliseconds, after compilation and warm-up.

    The runs take turns, so that a machine that slows down affects all of them.
    """
    for run in progress(runs.values(), "warming up", console):
        for _ in range(2):
            jax.block_until_ready(run())
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for _ in progress(range(repeats), "timing", console):
        for name, run in runs.items():
            started = time.perf_counter()
            jax.block_until_ready(run())
            seconds[name].append(time.perf_counter() - started)
    return {name: 1e3 * statistics.median(each) for name, each in seconds.items()}


def pareto(x: Sequence[float], y: Sequence[float]) -> list[int]:
    """The indices of the points (x, y) on the Pareto front, from left to right."""
    best, kept = np.inf, []
    for i in np.lexsort((y, x)):
        if y[i] < best:
            best = y[i]
            kept.append(int(i))
    return kept


def machine() -> dict[str, Any]:
    """What times depend on: hardware, load and versions."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if "model name" in line]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "cpu": models[0] if models else platform.processor() or platform.machine(),
        "cores": cores,
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "device": jax.devices()[0].device_kind,
        "python": platform.python_version(),
        **{name: version(name) for name in ("diffshadow", "jax", "jaxlib", "numpy")},
    }


def progress(items: Iterable[Any], what: str, console: Console) -> Iterable[Any]:
    """`items`, with a progress bar that vanishes when they are done; on a terminal only."""
    for item in track(list(items), what, console=console, transient=True, disable=not console.is_terminal):
        limit_programs()
        yield item


def chart(axes: Axes, title: str, x: str, y: str, *, grid: bool = True) -> None:
    """Sets the title of a chart, and the labels of its axes."""
    style.title(axes, title)
    style.chart(axes, x, y)
    if not grid:
        axes.grid(False)
        style.frame(axes)


def legend(axes: Axes, **options: Any) -> None:
    """A legend in small print without a frame."""
    axes.legend(**{"fontsize": style.TEXT - 0.5, "frameon": False, "labelcolor": INK, **options})


def write(
    settings: Config, experiment: str, made: Figure, rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]
) -> Path:
    """Writes a figure, a table and a summary as `<experiment>.png`, `.csv` and `.json`.

    **Arguments:**

    - `rows`: of the table, all with the keys of the first.
    - `summary`: the machine and the command are added to it.

    **Returns:** the folder, `<output>/<name>`, or `<output>/<name>-<experiment>` if the configuration's name is not the
    experiment's. Nothing is written until everything is computed.
    """
    ending = "" if settings.name == experiment else f"-{experiment}"
    folder = settings.output_folder / f"{settings.name}{ending}"
    picture, table = text_io.BytesIO(), text_io.StringIO(newline="")
    made.savefig(picture, format="png", dpi=_DPI, metadata={"Software": "diffshadow"}, pil_kwargs={"optimize": True})
    writer = csv.DictWriter(table, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    command = shlex.join(["python", *sys.argv])
    about = {"experiment": experiment, **summary, "machine": machine(), "command": command}
    files = {
        "png": picture.getvalue(),
        "csv": table.getvalue().encode(),
        "json": (json.dumps(about, indent=1, allow_nan=False) + "\n").encode(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for kind, data in files.items():
        with io.atomic_path(folder / f"{experiment}.{kind}") as temporary:
            temporary.write_bytes(data)
    return folder


def start(app: App) -> NoReturn:
    """Runs an experiment with the process's arguments, and exits; with 2 and one message after a user's mistake."""
    errors = Console(stderr=True)
    setup(cores=False, memory=False, collector=False)
    try:
        app(sys.argv[1:], exit_on_error=False, print_error=False)
    except (CycloptsError, ConfigError, io.FileError, OSError) as error:
        message = " ".join(str(error).split()) + "; see --help" if isinstance(error, CycloptsError) else str(error)
        errors.print(Text.assemble(("error: ", "bold red"), message), soft_wrap=True)
        sys.exit(USER_ERROR)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    sys.exit(0)
