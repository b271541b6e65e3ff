"""The work of a sweep's worker process: runs, one after another, that share programs, drawings and limits."""

import dataclasses
import json
import os
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Float32
from pydantic import ValidationError

from ... import io, metrics, reference
from ..._memory import limit_programs
from ..._types import HostArray
from ...config import (
    CONFIG_FILE,
    FLICKER,
    LIMIT_ERROR,
    Config,
    SweepConfig,
    SweepRun,
    build_technique,
    changed,
)
from ...settings.filters import RandomDisk
from .._drawn import Drawn
from ..record._files import RESULT, content_of, read_json
from ..record._folder import folder_of, remove, write_whole
from ..record._sweeps import Outcome
from ..runs._fit import fit_technique
from ..runs._measure import combined, noise
from ..runs._progress import Progress
from ..runs._render import SUFFIX, render_drawn
from ..runs._setup import draw, load, visibility_of
from ..runs._write import configs_of_fit, write_run, yaml_of

RUNS, FIGURES, LIMITS = "runs", "figures", "limits"
"""The folders of runs, of their figures, and of filters' limits, inside the sweep's folder."""
OK: Literal["ok"] = "ok"
FAILED: Literal["failed"] = "failed"
FITTED = "fitted."
"""The prefix of the metrics that hold a fit's results."""
VALIDATION = "validation."
"""The prefix of the metrics over the views of `fit.validation`."""
WHOLE = frozenset({"steps", "pixels"})
"""The metrics that are whole numbers."""
# The most bytes of drawings and limits that a process keeps for further runs.
_MAX_KEPT = 256 << 20
# The settings of the limit: the same for all runs, whatever their pattern and seed.
_LIMIT = {"pattern": "sobol", "early_out": False}
_LIMIT_SEED = 0x11317

Measured = dict[str, float | int | None]


class Batch(NamedTuple):
    """Runs that a worker does one after another.

    - `folder`: the sweep's folder, an absolute path.
    - `settings`: the sweep's settings.
    - `runs`: the runs to do.
    - `programs`: the folder of compiled programs, if there is one.
    - `shares`: whether to send its references: other batches need them too, or there are few.
    - `shape`: what the compiled programs of all its runs depend on.
    """

    folder: str
    settings: SweepConfig
    runs: tuple[SweepRun, ...]
    programs: str | None = None
    shares: bool = False
    shape: str = ""


def work(batch: Batch) -> list[Outcome]:
    """Does the runs of `batch` that are not done yet, and writes a folder for each."""
    if batch.programs is not None:
        # If another worker is writing the same program, it is compiled here too.
        warnings.filterwarnings("ignore", "Error reading persistent compilation cache entry")
        io.keep_compiled_programs(batch.programs)
    outcomes = []
    for run in batch.runs:
        outcome = read_outcome(batch.folder, run.id, batch.settings)
        if outcome is None:
            outcome = do(batch, run)
            write_outcome(batch.folder, run, outcome, batch.settings.run)
        outcomes.append(outcome)
    return outcomes


def read_outcome(
    folder: str | os.PathLike[str], id: str, settings: SweepConfig, *, failed: bool = False
) -> Outcome | None:
    """The outcome of the run `id`; `None` if it is not done, its folder is damaged, or it failed.

    **Arguments:**

    - `folder`, `id`: the sweep's folder, and the run's identifier.
    - `settings`: the sweep's settings, which determine the metrics.
    - `failed`: whether to return the outcome of a failed run, too.
    """
    try:
        outcome = Outcome.model_validate(read_json(Path(folder) / RUNS / id / RESULT))
    except (io.FileError, ValidationError):
        return None
    if outcome.id != id or not _is_complete(outcome, settings):
        return None
    return outcome if outcome.status == OK or failed else None


def _is_complete(outcome: Outcome, settings: SweepConfig) -> bool:
    """Whether an outcome has the metrics of a sweep's run, or failed with an error."""
    if (outcome.status == OK) != (outcome.error is None):
        return False
    if outcome.status == FAILED:
        return not outcome.metrics
    kinds, others = _measured(settings)
    return (
        kinds.keys() <= outcome.metrics.keys()
        and all(outcome.metrics[name] is None or isinstance(outcome.metrics[name], kinds[name]) for name in kinds)
        and all(name.startswith(others) for name in outcome.metrics.keys() - kinds.keys())
    )


def _measured(settings: SweepConfig) -> tuple[dict[str, type], tuple[str, ...]]:
    """The metrics of every successful run of a sweep with their types, and the prefixes of further metrics."""
    errors = [field.name for field in dataclasses.fields(metrics.ShadowErrors)]
    if settings.run == "fit":
        names = [*(f"{when}.{name}" for when in ("before", "after") for name in errors), "steps"]
    else:
        optional = {LIMIT_ERROR: settings.limit_samples, FLICKER: settings.flicker}
        names = [*errors, *(name for name, given in optional.items() if given is not None)]
    names += ["reference_noise_floor", "pixels"]
    further = (FITTED, VALIDATION) if settings.run == "fit" else ()
    return {name: int if name in WHOLE else float for name in names}, further


def write_outcome(folder: str | os.PathLike[str], run: SweepRun, outcome: Outcome, kind: str) -> None:
    """Writes the run's folder. `kind` is `"fit"` or `"render"`."""
    write_files(Path(folder) / RUNS / run.id, files_of(run, outcome, kind))


def files_of(run: SweepRun, outcome: Outcome, kind: str) -> dict[str, bytes]:
    """The files of the run's folder by name: its configuration, with the layout that it was drawn with, and its
    outcome."""
    found = {name.removeprefix(FITTED): value for name, value in outcome.metrics.items() if name.startswith(FITTED)}
    fitted = {name: value for name, value in found.items() if value is not None}
    configs = configs_of_fit(run.config, fitted) if kind == "fit" else {CONFIG_FILE: run.config}
    files = {name: yaml_of(config) for name, config in configs.items()}
    return {**files, RESULT: content_of(outcome, files)}


def write_files(place: Path, files: Mapping[str, bytes]) -> None:
    """Writes the folder `place` of a run with `files`, by name."""

    def write(draft: Path) -> None:
        for name, content in files.items():
            (draft / name).write_bytes(content)

    # Only the sweep writes here, so anything else under a run's name, such as a file or a broken link, is removed.
    if not place.is_dir():
        remove(place)
    write_whole(place, write)


def shape_of(config: Config) -> str:
    """Everything that the compiled programs of a run depend on, as text: all but real numbers, pattern and seed."""
    without = {"name", "output", "seed", "sweep", "advise", "shading"}
    text = config.model_dump_json(warnings=False, exclude=without)
    data = json.loads(text, parse_float=lambda _: None, parse_constant=lambda _: None)
    data["filter"].pop("pattern", None)
    return json.dumps(data, sort_keys=True)


def drawing_of(config: Config) -> str:
    """Everything that a run's drawings and reference depend on, as text: all settings used before a look-up."""
    without = {"name", "output", "sweep", "advise", "bias", "filter", "compare", "fit", "shading", "technique"}
    # Margins of maps depend on the filter and the bias.
    technique: Any = config.laid_out({})
    return config.model_dump_json(warnings=False, exclude=without) + technique.model_dump_json(warnings=False)


def reference_of(config: Config) -> str:
    """Everything that a run's reference depends on, and more, as text. Mesh files count by name."""
    return config.model_dump_json(warnings=False, include={"scene", "reference", "seed"})


def do(batch: Batch, run: SweepRun) -> Outcome:
    """Does one run, and writes its figures if there are any. An error in the run becomes its outcome.

    **Raises** `FullDiskError` if no space is left for its files.
    """
    started = time.perf_counter()
    if batch.shape not in _shapes:
        _shapes.add(batch.shape)
        limit_programs()
    progress = Progress.quiet()
    try:
        config = run.config
        if batch.settings.figures:
            config = config.model_copy(update={"output": str(Path(batch.folder) / FIGURES), "name": run.id})
        measured = _MEASURES[batch.settings.run](config, batch, progress)
        if run.frames:
            measured[FLICKER] = _flicker(run.frames, progress)
        status, error = OK, None
    except Exception as problem:
        # No run is to blame for that, and the next ones would fail as well.
        if io.is_full_disk(problem):
            raise
        measured, status, error = {}, FAILED, f"{type(problem).__name__}: {problem}"
    seconds = {**progress.seconds, "total": time.perf_counter() - started}
    return Outcome(id=run.id, status=status, error=error, metrics=measured, seconds=seconds)


def _measure_render(config: Config, batch: Batch, progress: Progress) -> Measured:
    drawn = _draw(config, progress)
    rendered = render_drawn(config, build_technique(config, fitting=False), drawn, progress)
    measured: Measured = dict(combined(rendered.errors, drawn))
    if batch.settings.limit_samples is not None:
        limits = _limits(config, batch.settings.limit_samples, drawn, batch.folder, progress)
        away = [
            {"rmse": metrics.rmse(image, limit, each.mask) if each.pixels else np.nan}
            for image, limit, each in zip(rendered.visibility, limits, drawn, strict=True)
        ]
        measured[LIMIT_ERROR] = combined(away, drawn)["rmse"]
    if batch.settings.figures:
        with progress.stage("figures"):
            write_run(folder_of(config, SUFFIX), rendered, progress.seconds, "render")
    return {**measured, **_of_reference(drawn)}


def _measure_fit(config: Config, batch: Batch, progress: Progress) -> Measured:
    fitted = fit_technique(config, progress)
    if batch.settings.figures:
        with progress.stage("figures"):
            write_run(folder_of(config), fitted, progress.seconds)
    return {
        **{f"{FITTED}{name}": value for name, value in fitted.result.fitted.items()},
        **{f"{when}.{name}": value for when, errors in fitted.errors.items() for name, value in errors.items()},
        **{
            f"{VALIDATION}{when}.{name}": value
            for when, errors in fitted.validation.items()
            for name, value in errors.items()
        },
        "steps": fitted.result.steps,
        **_of_reference(fitted.drawn),
    }


_MEASURES = {"render": _measure_render, "fit": _measure_fit}


def _of_reference(drawn: list[Drawn]) -> Measured:
    return {"reference_noise_floor": noise(drawn), "pixels": sum(each.pixels for each in drawn)}


def _draw(config: Config, progress: Progress) -> list[Drawn]:
    compute = lambda: draw(config, load(config, progress), build_technique(config, fitting=False), progress)
    return _kept(("drawing", drawing_of(config)), compute)


def _flicker(frames: Sequence[Config], progress: Progress) -> float:
    """How much the shadows of all lights shimmer from frame to frame."""
    drawn = [_draw(frame, progress) for frame in frames]
    with progress.stage("flicker"):
        techniques = [build_technique(frame, fitting=False) for frame in frames]
        found = []
        for lights in zip(*drawn, strict=True):
            images = np.stack([visibility_of(*each) for each in zip(techniques, lights, strict=True)])
            truths = np.stack([each.reference.visibility for each in lights])
            masks = np.stack([each.mask for each in lights])
            found.append({"rmse": metrics.flicker(images, truths, masks)})
        return combined(found, drawn[0])["rmse"]


def _limits(
    config: Config, samples: int, drawn: list[Drawn], folder: str, progress: Progress
) -> list[Float32[HostArray, "h w"]]:
    """The visibility of each light with very many taps; the same for all patterns, numbers of taps and seeds."""
    assert isinstance(config.filter, RandomDisk)
    limit = changed(config, filter=changed(config.filter, **_LIMIT, samples=samples), seed=_LIMIT_SEED)
    parts = {"scene", "technique", "shadow_map", "bias", "compare", "filter"}
    key = json.dumps(limit.model_dump(mode="json", include=parts, warnings=False), sort_keys=True)

    def compute() -> list[HostArray]:
        technique = build_technique(limit, fitting=False)
        make = lambda: {str(i): visibility_of(technique, each) for i, each in enumerate(drawn)}
        # A mesh's file may have changed since another process computed the limit, so its content is in the key.
        mesh = drawn[0].scene.mesh
        found = io.cached_arrays([key, mesh.vertices, mesh.faces], make, Path(folder) / LIMITS)
        return [found[str(i)] for i in range(len(drawn))]

    with progress.stage("limit"):
        return _kept(("limit", key), compute)


_memory: OrderedDict[tuple[str, str], Any] = OrderedDict()
# Of the runs that were done.
_shapes: set[str] = set()
# A worker of a cluster may have several threads.
_lock = threading.Lock()


def _kept(key: tuple[str, str], compute: Callable[[], Any]) -> Any:
    """What `compute` returns, from memory if it was computed before. The least recently used entries are dropped."""
    with _lock:
        if key not in _memory:
            _memory[key] = compute()
            while len(_memory) > 1 and sum(map(_bytes_of, _memory.values())) > _MAX_KEPT:
                _memory.popitem(last=False)
        _memory.move_to_end(key)
        return _memory[key]


def _bytes_of(value: Any) -> int:
    """Bytes of the arrays in `value`. An array that several values share is counted for each."""
    inside = [vars(leaf) if isinstance(leaf, reference.Reference) else leaf for leaf in jax.tree.leaves(value)]
    return sum(getattr(array, "nbytes", 0) for array in jax.tree.leaves(inside))
