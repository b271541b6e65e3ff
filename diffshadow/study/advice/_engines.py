"""Advice for one engine: its techniques as a section `advise`, and code to paste."""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from ...config import (
    LABEL,
    Advice,
    CheckProgress,
    Config,
    ConfigError,
    Mistake,
    build_technique,
    load_advice,
    load_config,
)
from ...settings.engines import ENGINES, Engine, EngineName
from ...settings.techniques import SingleMap
from ...shadow import ENGINE_TECHNIQUES
from ..runs._engine import EngineFit, Lit, code_of, engine_fit, lit_by
from ..runs._engine import code_file as suffixed
from ..runs._formula_engines import FORMULA_ENGINES, code_of_formula, offered
from ..runs._progress import Progress
from ..runs._setup import draw, load

_LISTS = ("biases", "filters")
_PARAMETERS = "parameters"


def engine_advice(
    path: str | os.PathLike[str],
    overrides: Sequence[str],
    engine: EngineName,
    *,
    console: Console,
    progress: CheckProgress | None = None,
) -> Advice:
    """The fits of a recommendation among the techniques of `engine`. Like `load_advice` otherwise.

    Engines whose shadows this package draws are fitted in their own units. Other engines are fitted as shadow maps with
    the engine's kernels and profile of the normal offset, and the result is converted. The scene is drawn first,
    because an engine's units depend on it. The casting faces stay as in the configuration.

    **Arguments:**

    - `path`, `overrides`: as in `load_config`.
    - `console`: the console for progress.
    - `progress`: called while fits are checked.

    **Raises** `ConfigError` for a configuration that the engine cannot draw, and the errors of `load_advice`.
    """
    config = load_config(path, overrides)
    _check(config, engine)
    seen = [view.config for view in config.views] or [config]
    with Progress(console) as shown:
        lit = [one for each in seen for one in lit_by(each, shown)]
    if not is_drawn(engine, config):
        try:
            lists = offered(engine, lit, _least_size(config))
        except ValueError as error:
            raise _mistake(config, ("scene",), str(error)) from error
        technique: Mapping[str, Any] = {"type": "shadow_map"}
    else:
        technique, lists = _exact(engine, config, lit)
    made = [f"technique={json.dumps(technique)}", *(f"advise.{name}={json.dumps(lists[name])}" for name in _LISTS)]
    advice = load_advice(path, [*overrides, *made], progress=progress)
    return advice._replace(sweep=advice.sweep._replace(overrides=tuple(overrides)), engine=engine)


def _least_size(config: Config) -> tuple[int, int]:
    """The side of the smallest map that is fitted."""
    given = None if config.advise is None else config.advise.resolutions
    height, width = config.shadow_map.resolution
    return min(given, key=min) if given else (max(height // 2, 1), max(width // 2, 1))


def _check(config: Config, engine: EngineName) -> None:
    """**Raises** `ConfigError` for lists of techniques, and for techniques other than a single map."""
    for name in _LISTS:
        if config.advise is not None and name in config.advise.model_fields_set:
            what = f"is given, and --engine {engine} has its own; expected one of them; override advise.{name}=null"
            raise _mistake(config, ("advise", name), what)
    if not isinstance(config.technique, SingleMap | Engine):
        what = f"is {config.technique.type}; expected a single map for {engine}: shadow_map or an engine's technique"
        raise _mistake(config, ("technique", "type"), f"{what}; override technique.type=shadow_map")


def is_drawn(engine: EngineName, config: Config) -> bool:
    """Whether this package draws the shadows of `engine` under the lights of `config`."""
    if engine not in ENGINE_TECHNIQUES:
        return False
    kinds = {light.type for light in config.scene.each_light.values()}
    return engine not in FORMULA_ENGINES or kinds.issubset(ENGINE_TECHNIQUES[engine].settings.kinds)


def _exact(
    engine: EngineName, config: Config, lit: Sequence[Lit]
) -> tuple[Mapping[str, Any], dict[str, list[dict[str, Any]]]]:
    """The technique, and the lists of biases and filters, of an engine whose shadows this package draws exactly."""
    settings = ENGINE_TECHNIQUES[engine].settings
    kinds = settings.point_filters if any(each.is_point for each in lit) else settings.filters
    made = {kind: engine_fit(engine, config, lit, kind) for kind in kinds}
    filters = [_filter(kind, settings.filter_key, one, settings.biases) for kind, one in made.items()]
    one, (bias, offset), keys = engine_fit(engine, config, lit), settings.bias_names, settings.biases
    choices = {bias: keys[:1], offset: keys[1:], f"{bias} + {offset}": keys}
    biases = [
        {
            LABEL: label,
            **{f"technique.{name}": 0.0 for name in keys},
            _PARAMETERS: {f"technique.{name}": one.parameters[name] for name in fitted},
        }
        for label, fitted in choices.items()
    ]
    return one.technique, {"biases": biases, "filters": filters}


def _filter(kind: str, key: str, made: EngineFit, biases: Sequence[str]) -> dict[str, Any]:
    entry: dict[str, Any] = {LABEL: kind, f"technique.{key}": kind}
    # A single texel has no width.
    fitted = [name for name in made.parameters if name not in biases and kind != "BasicShadowMap"]
    parameters = {f"technique.{name}": made.parameters[name] for name in fitted}
    return {**entry, _PARAMETERS: parameters} if parameters else entry


def engine_code(engine: EngineName, config: Config, filter_label: str) -> dict[str, str]:
    """The code that sets the fitted values of `config`, for each of its lights by key. With several views, the code is
    for the first view.

    `filter_label` is the name of the technique's filter.
    """
    shown = Progress.quiet()
    first = config.views[0].config if config.views else config
    if not is_drawn(engine, first):
        lit = lit_by(first, shown)
        return {".".join(map(str, each.key)): code_of_formula(engine, config, filter_label, each) for each in lit}
    technique: Any = build_technique(config, fitting=False)
    return code_of(technique, first, draw(first, load(first, shown), technique, shown))


def code_file(engine: EngineName) -> str:
    """The name of the file with the code, in a recommendation's folder."""
    known = FORMULA_ENGINES.get(engine)
    return suffixed(ENGINE_TECHNIQUES[engine].settings.suffix if known is None else known.suffix)


def title_of(engine: EngineName) -> str:
    """A description of the code."""
    return f"{code_file(engine)}, for {ENGINES[engine]}"


def _mistake(config: Config, path: tuple[str, ...], what: str) -> ConfigError:
    return ConfigError([Mistake(config.origin.place(path), ".".join(path), what)])
