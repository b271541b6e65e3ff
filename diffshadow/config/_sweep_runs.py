"""From a file with a sweep to the configuration of every run."""

import copy
import functools
import hashlib
import importlib.metadata
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from ._errors import ConfigError, KeyPath, Origin, Place, Problem, show
from ._filters import MOST_TAPS, RandomDiskConfig
from ._load import Draft, checked, load_draft
from ._overrides import apply_overrides
from ._problems import problems_of
from ._reference import ImageReferenceConfig
from ._schema import Config
from ._sweep import LABEL, QuasiRandomConfig, SweepConfig
from ._technique import ShadowMappingConfig

# Part of every id: to be raised when a run of the same configuration gives other numbers.
_FORMAT = 1
_ID_DIGITS = 16
# Sixteen times as many as those of a run.
_MOST_LIMIT_TAPS = 16 * MOST_TAPS


class SweepRun(NamedTuple):
    """One run of a sweep.

    - `id`: 16 hexadecimal digits, a hash of all that the run's numbers depend on, the content of mesh files included;
        neither the order of the runs nor names and folders are part of it.
    - `values`: what this run has on each axis.
    - `config`: its configuration, without the sweep.
    """

    id: str
    values: Mapping[str, Any]
    config: Config


class Sweep(NamedTuple):
    """A sweep and all of its runs, in the order of its axes, the last of which changes first.

    - `source`, `overrides`: what it was loaded from.
    """

    settings: SweepConfig
    runs: tuple[SweepRun, ...]
    source: str
    overrides: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Names the sweep's folder."""
        return self.runs[0].config.name


class _Choice(NamedTuple):
    """What a run has on one axis, or several that go together: values by key, the keys' paths, and a label."""

    values: Mapping[str, Any]
    paths: Mapping[str, KeyPath]
    label: str | None = None


def load_sweep(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Sweep:
    """The sweep in the YAML file `path`, with `overrides`; as `load_config`.

    **Returns:** every run, each with its checked configuration. Equal files give equal runs in the same order.

    **Raises** `ConfigError` with everything that is wrong with the file, the overrides or any of the runs.
    """
    draft = load_draft(path, overrides)
    settings = _settings_of(draft)
    base = {key: value for key, value in draft.data.items() if key != "sweep"}
    faults: dict[Problem, list[Mapping[str, Any]]] = {}
    runs, count = [], 0
    for values, written in _combined(settings, draft._replace(data=base)):
        count += 1
        try:
            config = checked(written, fitting=settings.run == "fit")
            _check_limit(config, settings, draft.origin)
        except ConfigError as error:
            for problem in error.problems:
                faults.setdefault(problem, []).append(values)
            continue
        # Errors have been told; places of keys would travel to the workers for nothing.
        config._origin = Origin(draft.origin.source)
        runs.append(SweepRun(_id_of(config, settings), values, config))
    if faults:
        # What is wrong with every run does not depend on the values.
        raise ConfigError(p if len(held) == count else _with_values(p, held[0]) for p, held in faults.items())
    return Sweep(settings, tuple(runs), draft.origin.source, tuple(overrides))


def _settings_of(draft: Draft) -> SweepConfig:
    """The section `sweep` of `draft`. What else the file says is checked with each run's values in their places."""
    if draft.data.get("sweep") is None:
        message = "is missing; expected a section that says what changes; add it, or use diffshadow render or fit"
        raise ConfigError([*draft.problems, Problem(draft.origin.place(()), "sweep", message)])
    try:
        Config.model_validate(draft.data)
    except ValidationError as error:
        problems = problems_of(error, draft.origin)
        if any(problem.key.split(".")[0] == "sweep" for problem in problems):
            raise ConfigError([*draft.problems, *problems]) from None
    return SweepConfig.model_validate(draft.data["sweep"])


def _combined(settings: SweepConfig, draft: Draft) -> Iterator[tuple[dict[str, Any], Draft]]:
    """Every run's values on the axes, and the configuration with them."""
    columns, own = settings.axes, draft.data.get("seed", 0)
    for values, written in _nested(_levels(settings, own), {}, draft):
        # What an entry of the list leaves as it is has no value of its own.
        shown = {column: values.get(column) for column in columns}
        shown["seed"] = written.data.get("seed", 0)
        yield shown, written


def _nested(
    levels: Sequence[Sequence[_Choice]], values: Mapping[str, Any], draft: Draft
) -> Iterator[tuple[Mapping[str, Any], Draft]]:
    if not levels:
        yield values, draft
        return
    for choice in levels[0]:
        label = {} if choice.label is None else {LABEL: choice.label}
        yield from _nested(levels[1:], {**values, **label, **choice.values}, _written(draft, choice))


def _levels(settings: SweepConfig, seed: Any) -> list[list[_Choice]]:
    """The choices on each axis, the slowest first."""
    levels = []
    if settings.list is not None:
        levels.append([_entry(i, entry) for i, entry in enumerate(settings.list)])
    for key, values in (settings.grid or {}).items():
        levels.append([_Choice({key: v}, {key: ("sweep", "grid", key, i)}) for i, v in enumerate(values)])
    if settings.zip:
        rows = zip(*settings.zip.values(), strict=True)
        levels.append(
            [
                _Choice(dict(zip(settings.zip, row, strict=True)), {k: ("sweep", "zip", k, i) for k in settings.zip})
                for i, row in enumerate(rows)
            ]
        )
    if settings.qmc is not None:
        paths = {key: ("sweep", "qmc", "axes", key) for key in settings.qmc.axes}
        levels.append([_Choice(point, paths) for point in _points(settings.qmc)])
    if settings.repeats is not None and isinstance(seed, int):
        levels.append([_Choice({"seed": seed + i}, {"seed": ("sweep", "repeats")}) for i in range(settings.repeats)])
    if settings.seeds is not None:
        levels.append([_Choice({"seed": s}, {"seed": ("sweep", "seeds", i)}) for i, s in enumerate(settings.seeds)])
    return levels


def _entry(index: int, entry: Mapping[str, Any]) -> _Choice:
    values = {key: value for key, value in entry.items() if key != LABEL}
    return _Choice(values, {key: ("sweep", "list", index, key) for key in values}, entry.get(LABEL))


def _points(settings: QuasiRandomConfig) -> list[dict[str, Any]]:
    """The points of the sequence, scaled to the axes' ranges."""
    # Here, for SciPy takes long to load, and most sweeps do without.
    from scipy.stats import qmc

    make = {"sobol": qmc.Sobol, "halton": qmc.Halton}[settings.sequence]
    sequence = make(len(settings.axes), scramble=True, rng=settings.seed)
    if settings.sequence == "sobol":
        # SciPy warns of any number that is no power of two.
        unit = sequence.random_base2(math.ceil(math.log2(settings.count)))[: settings.count]
    else:
        unit = sequence.random(settings.count)
    points = []
    for row in unit.tolist():
        point = {}
        for share, (key, axis) in zip(row, settings.axes.items(), strict=True):
            if axis.log:
                value = axis.lower * (axis.upper / axis.lower) ** share
            else:
                value = axis.lower + (axis.upper - axis.lower) * share
            value = min(max(value, axis.lower), axis.upper)
            point[key] = round(value) if axis.integer else value
        points.append(point)
    return points


def _written(draft: Draft, choice: _Choice) -> Draft:
    """`draft` with the values of `choice`, whose places are those in the section `sweep`."""
    data, places, problems = copy.deepcopy(draft.data), dict(draft.origin.places), list(draft.problems)
    for key, value in choice.values.items():
        # JSON is YAML, so a value passes through an override as it is.
        override = f"{key}={json.dumps(value, ensure_ascii=False)}"
        passed, place = Place(f"override {override!r}"), draft.origin.place(choice.paths[key])
        problems += [
            replace(problem, place=place) if problem.place == passed else problem
            for problem in apply_overrides(data, places, [override])
        ]
        places = {path: place if at == passed else at for path, at in places.items()}
    return Draft(data, Origin(draft.origin.source, places), draft.folder, problems)


def _check_limit(config: Config, settings: SweepConfig, origin: Origin) -> None:
    if settings.limit_samples is None:
        return
    if not isinstance(config.filter, RandomDiskConfig) or not isinstance(config.technique, ShadowMappingConfig):
        message = (
            f"is given, and there are runs of technique {config.technique.type} with filter {config.filter.type}; "
            "expected shadow_map with random_disk, which has a limit; remove it, or such runs"
        )
    elif (taps := settings.limit_samples * config.filter.pattern_size**2) > _MOST_LIMIT_TAPS:
        message = (
            f"is {settings.limit_samples}, and with filter.pattern_size {config.filter.pattern_size} there are "
            f"{taps:,} taps of a tile; expected at most {_MOST_LIMIT_TAPS:,}, which take 270 MB; lower one of them"
        )
    else:
        return
    raise ConfigError([Problem(origin.place(("sweep", "limit_samples")), "sweep.limit_samples", message)])


def _with_values(problem: Problem, values: Mapping[str, Any]) -> Problem:
    shown = ", ".join(f"{key} = {value if key == LABEL else show(value)}" for key, value in values.items())
    return replace(problem, message=f"{problem.message} (first in the run with {shown})")


def _id_of(config: Config, settings: SweepConfig) -> str:
    data = config.model_dump(mode="json", exclude={"name", "output", "sweep"})
    for mesh, section in zip(data["scene"]["meshes"], config.scene.meshes, strict=True):
        if section.builtin is None:
            mesh["path"] = _content_of(section.path)
    if isinstance(config.reference, ImageReferenceConfig):
        data["reference"]["path"] = _content_of(config.reference.path)
    whole = {
        "format": _FORMAT,
        "version": _version(),
        "run": settings.run,
        "limit_samples": settings.limit_samples,
        "config": data,
    }
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:_ID_DIGITS]


@functools.cache
def _version() -> str:
    return importlib.metadata.version("diffshadow")


@functools.cache
def _content_of(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
