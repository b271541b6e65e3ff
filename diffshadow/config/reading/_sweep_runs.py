"""Makes the configurations of a sweep's runs."""

import functools
import hashlib
import importlib.metadata
import json
import math
import os
import pickle
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, overload

from pydantic import ValidationError

from ...settings.patterns import MAX_PATTERN_TAPS
from ...settings.techniques import Mapped
from .._errors import ConfigError, Mistake, Origin, show
from ..sections._axes import LABEL
from ..sections._config import Config
from ..sections._scene import TEXTURE_KEYS
from ..sections._sweep import SweepConfig
from ..sections._technique import RandomDiskConfig
from ._axes import levels_of, steps_of, written
from ._draft import Draft, load_draft
from ._files import files_in
from ._load import checked
from ._mistakes import mistakes_of

# A part of every id. Increase it when the same configuration gives different numbers.
_FORMAT = 1
_ID_BYTES = 8
# Each run takes a millisecond to check, a folder, and a few hundred bytes of memory.
_MAX_RUNS = 1 << 20
# The runs of larger sweeps are stored pickled, in some kilobytes each. Reading a run takes a fifth of the time of
# making it.
_MAX_KEPT = 4096
# The runs of even larger sweeps are not stored in memory, but made again on demand.
_MAX_PICKLED = 1 << 14
# The number of distinct faults after which checking stops.
_MAX_FAULTS = 100

CheckProgress = Callable[[int, int], None]
"""Called with the number of runs checked so far, and the number of all runs."""


class SweepRun(NamedTuple):
    """One run of a sweep.

    - `id`: 16 hexadecimal digits, a hash of all inputs of the run's results, including the content of mesh files. The
      order of the runs, names and folders do not affect it.
    - `values`: the run's value on each axis.
    - `config`: its configuration, without the sweep.
    - `frames`: the configurations along the path of `sweep.flicker`; empty without that section.
    """

    id: str
    values: Mapping[str, Any]
    config: Config
    frames: tuple[Config, ...] = ()


class SweepRuns(Sequence[SweepRun]):
    """The runs of a sweep, in the order of its axes. The last axis varies fastest.

    Runs are made on demand, because a million of them would fill the memory. Only the runs of small sweeps are stored.
    Making a run **raises** `ConfigError` if its configuration is invalid; `check` tries all of them.
    """

    def __init__(self, settings: SweepConfig, draft: Draft):
        self._settings, self._origin = settings, draft.origin
        # Each run copies the places of all keys outside of the section `sweep`, which may have thousands of keys.
        places = {path: place for path, place in draft.origin.places.items() if path[:1] != ("sweep",)}
        data = {key: value for key, value in draft.data.items() if key != "sweep"}
        self._base = draft._replace(data=data, origin=Origin(draft.origin.source, places))
        self._axes, self._seed = settings.axes, data.get("seed", 0)
        self._levels = levels_of(settings, draft)
        self._steps = steps_of(settings.flicker)
        counts = [len(level) for level in self._levels]
        self._count = math.prod(counts)
        # For each level, the distance between the runs of neighbouring choices.
        self._strides = [math.prod(counts[depth + 1 :]) for depth in range(len(counts))]
        # Results of `check`: all identifiers, concatenated, and the runs of a small sweep.
        self._ids: bytes | None = None
        self._kept: list[SweepRun] | None = None
        self._pickled: list[bytes] | None = None

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> SweepRun: ...
    @overload
    def __getitem__(self, index: slice) -> list[SweepRun]: ...
    def __getitem__(self, index: int | slice) -> SweepRun | list[SweepRun]:
        chosen = range(self._count)[index]
        if isinstance(chosen, int):
            return next(self.at((chosen,)))
        return list(self.at(chosen)) if chosen.step > 0 else list(self.at(chosen[::-1]))[::-1]

    def __iter__(self) -> Iterator[SweepRun]:
        return self.at(range(self._count))

    def at(self, indices: Sequence[int]) -> Iterator[SweepRun]:
        """The runs at the increasing `indices`. Work that the runs share is done once."""
        if self._kept is not None:
            yield from (self._kept[index] for index in indices)
            return
        if self._pickled is not None:
            yield from (pickle.loads(self._pickled[index]) for index in indices)
            return
        for index, draft in self._drafts(indices):
            yield self._made(index, draft)

    def id(self, index: int) -> str:
        """The identifier of the run at `index`."""
        if self._ids is None:
            return self[index].id
        return self._ids[index * _ID_BYTES : (index + 1) * _ID_BYTES].hex()

    def column(self, axis: str) -> list[Any]:
        """The value of each run on one axis."""
        return [self._value(axis, index) for index in range(self._count)]

    def choices(self, axis: str) -> list[Any]:
        """The distinct values on one axis, in order of first use."""
        found = [choice.shown[axis] for level in self._levels for choice in level if axis in choice.shown]
        return list({repr(value): value for value in found or [self._seed]}.values())

    def check(self, progress: CheckProgress | None = None) -> None:
        """Makes every run once, and computes its identifier.

        **Raises** `ConfigError` with the mistakes of all runs. Checking stops after a hundred distinct faults.
        """
        if self._ids is not None:
            return
        # For each fault, the first run that has it, and the number of runs that have it.
        faults: dict[Mistake, tuple[int, int]] = {}
        ids, kept, pickled, checked = bytearray(), [], [], 0
        made = self._count * (1 + len(self._steps))
        for index, draft in self._drafts(range(self._count)):
            try:
                run = self._made(index, draft)
            except ConfigError as error:
                for mistake in error.mistakes:
                    first, count = faults.get(mistake, (index, 0))
                    faults[mistake] = first, count + 1
            else:
                ids += bytes.fromhex(run.id)
                if made <= _MAX_KEPT:
                    kept.append(run)
                elif made <= _MAX_PICKLED:
                    pickled.append(pickle.dumps(run))
            checked += 1
            if progress is not None:
                progress(checked, self._count)
            if len(faults) >= _MAX_FAULTS:
                break
        if faults:
            # A fault of all runs does not depend on the values.
            raise ConfigError(
                mistake if count == checked else _with_values(mistake, self._values(first))
                for mistake, (first, count) in faults.items()
            )
        self._ids, self._kept, self._pickled = bytes(ids), kept or None, pickled or None

    def _values(self, index: int) -> dict[str, Any]:
        return {axis: self._value(axis, index) for axis in self._axes}

    def _value(self, axis: str, index: int) -> Any:
        for level, stride in zip(self._levels, self._strides, strict=True):
            shown = level[index // stride % len(level)].shown
            if axis in shown:
                return shown[axis]
        # An entry of the list may leave out keys that other entries set.
        return self._seed if axis == "seed" else None

    def _drafts(self, indices: Sequence[int]) -> Iterator[tuple[int, Draft]]:
        """The indices and drafts of the runs at `indices`."""

        def walk(depth: int, first: int, draft: Draft, low: int, high: int) -> Iterator[tuple[int, Draft]]:
            """The drafts at `indices[low:high]`. `draft` has the choices above `depth`; its first run is `first`."""
            if depth == len(self._levels):
                yield first, draft
                return
            for choice in self._levels[depth]:
                end = bisect_left(indices, first + self._strides[depth], low, high)
                if end > low:
                    yield from walk(depth + 1, first, written(draft, choice, self._origin), low, end)
                low, first = end, first + self._strides[depth]

        return walk(0, 0, self._base, 0, len(indices))

    def _made(self, index: int, draft: Draft) -> SweepRun:
        config = checked(draft, fitting=self._settings.run == "fit")
        _check_limit(config, self._settings, self._origin)
        frames = tuple(checked(written(draft, step, self._origin)) for step in self._steps)
        # The checks are done, so the workers do not need the places of keys.
        for each in (config, *frames):
            each._origin = Origin(self._origin.source)
        id = _id_of(config, self._settings) if self._ids is None else self.id(index)
        return SweepRun(id, self._values(index), config, frames)


class Sweep(NamedTuple):
    """A sweep and its runs.

    - `source`, `overrides`: the file and overrides that the sweep was loaded from.
    """

    settings: SweepConfig
    runs: SweepRuns
    source: str
    overrides: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of the sweep's folder."""
        return self.runs[0].config.name


def load_sweep(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    *,
    check: bool = True,
    progress: CheckProgress | None = None,
) -> Sweep:
    """Loads the sweep in the YAML file `path`, with `overrides` applied, like `load_config`.

    **Arguments:**

    - `path`, `overrides`: as in `load_config`.
    - `check`: whether to check all runs, at about a millisecond each, or only the section `sweep`.
    - `progress`: called while runs are checked.

    **Returns:** the sweep. Equal files give equal runs in the same order.

    **Raises** `ConfigError` with all mistakes in the file, the overrides and the runs.
    """
    draft = load_draft(path, overrides)
    try:
        settings = _settings_of(draft)
    except ConfigError as error:
        raise ConfigError([*error.mistakes, *_faults_beside_plot(draft, error)]) from None
    runs = SweepRuns(settings, draft)
    if len(runs) > _MAX_RUNS:
        message = (
            f"makes {len(runs):,} runs; expected at most {_MAX_RUNS:,}, because each is checked and gets a folder; "
            "shorten its lists, or split it into several sweeps"
        )
        raise ConfigError([Mistake(draft.origin.place(("sweep",)), "sweep", message)])
    if check:
        runs.check(progress)
    return Sweep(settings, runs, draft.origin.source, tuple(overrides))


def _settings_of(draft: Draft) -> SweepConfig:
    """The section `sweep` of `draft`. The other sections are checked with each run's values filled in."""
    if draft.data.get("sweep") is None:
        message = "is missing; expected a section with the values to vary; add it, or use diffshadow render or fit"
        raise ConfigError([*draft.mistakes, Mistake(draft.origin.place(()), "sweep", message)])
    try:
        Config.model_validate(draft.data)
    except ValidationError as error:
        mistakes = mistakes_of(error, draft.origin)
        if any(mistake.key.split(".")[0] == "sweep" for mistake in mistakes):
            raise ConfigError([*draft.mistakes, *mistakes]) from None
    return SweepConfig.model_validate(draft.data["sweep"])


def _faults_beside_plot(draft: Draft, error: ConfigError) -> Sequence[Mistake]:
    """The faults of a sweep's runs, for a sweep whose own section has only faults of its plot."""
    if not all(mistake.key.startswith("sweep.plot") for mistake in error.mistakes):
        return ()
    settings = {key: value for key, value in draft.data["sweep"].items() if key != "plot"}
    rest = draft._replace(data={**draft.data, "sweep": settings})
    try:
        runs = SweepRuns(_settings_of(rest), rest)
        if len(runs) <= _MAX_RUNS:
            runs.check()
    except ConfigError as more:
        return more.mistakes
    return ()


def _check_limit(config: Config, settings: SweepConfig, origin: Origin) -> None:
    if settings.limit_samples is None:
        return
    if not (isinstance(config.filter, RandomDiskConfig) and isinstance(config.technique, Mapped)):
        message = (
            f"is given, but there are runs of technique {config.technique.type} with filter {config.filter.type}; "
            "expected shadow_map with random_disk, which has a limit; remove it, or these runs"
        )
    elif (taps := settings.limit_samples * config.filter.pattern_size**2) > MAX_PATTERN_TAPS:
        message = (
            f"is {settings.limit_samples}, and with filter.pattern_size {config.filter.pattern_size} there are "
            f"{taps:,} taps per tile; expected at most {MAX_PATTERN_TAPS:,}, which take 270 MB; lower one of them"
        )
    else:
        return
    raise ConfigError([Mistake(origin.place(("sweep", "limit_samples")), "sweep.limit_samples", message)])


def _with_values(mistake: Mistake, values: Mapping[str, Any]) -> Mistake:
    shown = ", ".join(f"{key} = {value if key == LABEL else show(value)}" for key, value in values.items())
    return replace(mistake, message=f"{mistake.message} (first in the run with {shown})")


def _id_of(config: Config, settings: SweepConfig) -> str:
    data = config.model_dump(mode="json", warnings=False, exclude={"name", "output", "sweep", "advise"})
    for mesh in data["scene"]["meshes"]:
        # Absent, as before there were textures.
        for key in TEXTURE_KEYS:
            if mesh[key] is None:
                del mesh[key]
    for kind, views in (("views", config.views), ("validation", config.validation)):
        data["fit"][kind] = [_id_of(view.config, settings) for view in views]
    for path, holder, file in [*files_in(data)]:
        holder[path[-1]] = _content_of(file)
    whole = {
        "format": _FORMAT,
        "version": _version(),
        "run": settings.run,
        "limit_samples": settings.limit_samples,
        "config": data,
    }
    if settings.flicker is not None:
        whole["flicker"] = settings.flicker.model_dump(mode="json")
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[: 2 * _ID_BYTES]


@functools.cache
def _version() -> str:
    return importlib.metadata.version("diffshadow")


@functools.cache
def _content_of(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
