"""Makes the fits of a recommendation: a sweep over techniques."""

import itertools
import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pydantic import ValidationError

from ...settings.engines import Engine, EngineName
from ...settings.techniques import Mapped
from .._errors import ConfigError, KeyPath, Mistake, Origin
from ..sections._advise import LISTS, PARAMETERS, AdviseConfig, keys_set
from ..sections._axes import LABEL
from ..sections._config import Config
from ..sections._section import type_of, value_at
from ..sections._sweep import SweepConfig
from ..sections._technique import TECHNIQUES, ShadowMapConfig
from ._draft import Draft, load_draft
from ._mistakes import mistakes_of
from ._sweep_runs import CheckProgress, Sweep, SweepRuns

_SIZE = "shadow_map.resolution"
# Each technique is a fit.
_MAX_TECHNIQUES = 1024
# Settings for more than the best parameters. Techniques are compared at their best parameters.
_OF_ONE_FIT = ("intervals", "prefer", "front")


class AdvisedTechnique(NamedTuple):
    """A technique of a recommendation.

    - `bias`, `filter`: the labels of its entries.
    - `resolution`: resolution of its map, (height, width) in texels.
    """

    bias: str
    filter: str
    resolution: tuple[int, int]


class Advice(NamedTuple):
    """The fits of a recommendation.

    - `sweep`: a fit for each technique; `techniques`: the techniques, in the same order.
    - `engine`: the engine, if the techniques belong to an engine.
    """

    settings: AdviseConfig
    sweep: Sweep
    techniques: tuple[AdvisedTechnique, ...]
    engine: EngineName | None = None


def load_advice(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, progress: CheckProgress | None = None
) -> Advice:
    """Loads the fits of the section `advise` in the YAML file `path`, with `overrides` applied, like `load_sweep`.

    Without this section, the techniques are its defaults.

    **Raises** `ConfigError` with all mistakes in the file, the overrides and the fits.
    """
    draft = load_draft(path, overrides)
    settings = _settings_of(draft)
    sizes = settings.resolutions or _sizes_of(draft)
    pairs = list(itertools.product(*(enumerate(getattr(settings, name)) for name in LISTS)))
    if len(pairs) * len(sizes) > _MAX_TECHNIQUES:
        message = f"makes {len(pairs) * len(sizes):,} fits; expected at most {_MAX_TECHNIQUES:,}; shorten its lists"
        raise ConfigError([Mistake(draft.origin.place(("advise",)), "advise", message)])
    places, entries = dict(draft.origin.places), []
    for n, pair in enumerate(pairs):
        entry, origins = _entry(pair)
        places |= {("sweep", "list", n, key): draft.origin.place(path) for key, path in origins.items()}
        entries.append(entry)
    places |= {("sweep", "grid", _SIZE, i): draft.origin.place(("advise", "resolutions", i)) for i in range(len(sizes))}
    axes = SweepConfig(run="fit", list=tuple(entries), grid={_SIZE: tuple(list(size) for size in sizes)})
    data = {key: value for key, value in draft.data.items() if key != "advise"}
    if isinstance(draft.data.get("fit"), Mapping):
        data["fit"] = {key: value for key, value in draft.data["fit"].items() if key not in _OF_ONE_FIT}
    runs = SweepRuns(axes, draft._replace(data=data, origin=Origin(draft.origin.source, places)))
    runs.check(progress)
    techniques = tuple(
        AdvisedTechnique(bias[LABEL], kind[LABEL], size) for (_, bias), (_, kind) in pairs for size in sizes
    )
    return Advice(settings, Sweep(axes, runs, draft.origin.source, tuple(overrides)), techniques)


def _settings_of(draft: Draft) -> AdviseConfig:
    """The section `advise` of `draft`. The other sections are checked with each technique's values filled in."""
    mistakes = list(draft.mistakes)
    if draft.data.get("sweep") is not None:
        message = "makes this file a sweep; expected one without; override sweep=null"
        mistakes.append(Mistake(draft.origin.place(("sweep",)), "sweep", message))
    technique = TECHNIQUES.of(draft.data.get("technique"))
    # The default lists are for shadow maps.
    has_lists = all(value_at(draft.data, "advise", name) is not None for name in LISTS)
    if not issubclass(technique, Mapped) and not (issubclass(technique, Engine) and has_lists):
        path = ("technique", "type")
        mend = f"add --engine {type_of(technique)}, or change it" if issubclass(technique, Engine) else "change it"
        message = (
            f"is {type_of(technique)}, and advise compares biases and filters of shadow maps; expected a technique "
            f"that has these, such as shadow_map; {mend}"
        )
        mistakes.append(Mistake(draft.origin.place(path), ".".join(path), message))
    for kind in ("views", "validation"):
        if _changes_size(value_at(draft.data, "fit", kind)):
            path = ("fit", kind)
            message = (
                f"changes {_SIZE}, which all views of a technique share; expected other keys; use advise.resolutions"
            )
            mistakes.append(Mistake(draft.origin.place(path), ".".join(path), message))
    try:
        Config.model_validate(draft.data)
    except ValidationError as error:
        mistakes += [m for m in mistakes_of(error, draft.origin) if m.key.split(".")[0] == "advise"]
    if mistakes:
        raise ConfigError(mistakes)
    return AdviseConfig.model_validate(draft.data.get("advise") or {})


def _changes_size(axes: Any) -> bool:
    """Whether a section of views sets the map's resolution."""
    return any(_SIZE in held for held in _mappings(axes))


def _mappings(value: Any) -> list[Mapping[Any, Any]]:
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    own = [value] if isinstance(value, Mapping) else []
    return [*own, *(found for each in inner for found in _mappings(each))]


def _sizes_of(draft: Draft) -> tuple[tuple[int, int], ...]:
    """The configuration's size of the map, and half of it."""
    default = ShadowMapConfig.model_fields["resolution"].default
    try:
        height, width = ShadowMapConfig.model_validate(
            {"resolution": value_at(draft.data, "shadow_map", "resolution", default=default)}
        ).resolution
    except ValidationError:
        # Every fit reports it.
        height, width = default
    return tuple(dict.fromkeys([(height, width), (max(height // 2, 1), max(width // 2, 1))]))


def _entry(pair: Sequence[tuple[int, Mapping[str, Any]]]) -> tuple[dict[str, Any], dict[str, KeyPath]]:
    """The entry of a sweep's list for a bias and a filter, and the path of each of its keys in the file."""
    entry: dict[str, Any] = {LABEL: ", ".join(each[LABEL] for _, each in pair)}
    paths: dict[str, KeyPath] = {}
    parameters: dict[str, Any] = {}
    for name, (i, each) in zip(LISTS, pair, strict=True):
        entry |= {key: each[key] for key in keys_set(each)}
        paths |= {key: ("advise", name, i, key) for key in keys_set(each)}
        if each.get(PARAMETERS):
            parameters |= each[PARAMETERS]
            paths["fit.parameters"] = ("advise", name, i, PARAMETERS)
    # The fit reports an empty section.
    return entry | {"fit.parameters": parameters}, {"fit.parameters": ("advise",), **paths}
