"""Advice for one engine: which techniques it has, as a section `advise`, and the code to paste."""

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
from ..runs._engine import EngineFit, Lit, babylon_js, code_of, lit_by, three_js
from ..runs._progress import Progress
from ..runs._setup import draw, load
from ._formula_engines import FORMULA_ENGINES, code_of_formula, offered

_LISTS = ("biases", "filters")
_PARAMETERS = "parameters"
_THREE_FILTERS = ("BasicShadowMap", "PCFShadowMap", "VSMShadowMap")
_BABYLON_FILTERS = ("NONE", "POISSONSAMPLING", "PCF", "PCSS")
# Under a point light the engine draws the others as POISSONSAMPLING.
_BABYLON_POINT_FILTERS = ("NONE", "POISSONSAMPLING")
_EXACT = {"three.js": ("bias", "normalBias"), "babylon.js": ("bias", "normalBias")}
_KEYS = ("bias", "normal_bias")


def engine_advice(
    path: str | os.PathLike[str],
    overrides: Sequence[str],
    engine: EngineName,
    *,
    console: Console,
    progress: CheckProgress | None = None,
) -> Advice:
    """The fits of a recommendation among the techniques that `engine` has, like `load_advice`.

    three.js and Babylon.js are fitted as they draw, in their own units. Godot, Bevy, Filament and Unity are fitted as
    shadow maps with their kernels and their profile of the normal offset, to be converted. The scene is drawn first,
    since an engine's units depend on it. Faces cast as in the configuration.

    **Arguments:**

    - `path`, `overrides`: as in `load_config`.
    - `console`: where progress is shown.
    - `progress`: called while fits are checked.

    **Raises** `ConfigError` for a configuration that the engine cannot draw, and what `load_advice` raises.
    """
    config = load_config(path, overrides)
    _check(config, engine)
    seen = [view.config for view in config.views] or [config]
    with Progress(console) as shown:
        lit = [one for each in seen for one in lit_by(each, shown)]
    if engine in FORMULA_ENGINES:
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
    """The size of the smallest map that is fitted."""
    given = None if config.advise is None else config.advise.resolutions
    height, width = config.shadow_map.resolution
    return min(given, key=min) if given else (max(height // 2, 1), max(width // 2, 1))


def _check(config: Config, engine: EngineName) -> None:
    """**Raises** `ConfigError` for lists of techniques, and for a technique that is no single map."""
    for name in _LISTS:
        if config.advise is not None and name in config.advise.model_fields_set:
            what = f"is given, and --engine {engine} has its own; expected one of them; override advise.{name}=null"
            raise _mistake(config, ("advise", name), what)
    if not isinstance(config.technique, SingleMap | Engine):
        what = f"is {config.technique.type}; expected shadow_map or an engine's, since one map is fitted for {engine}"
        raise _mistake(config, ("technique", "type"), f"{what}; override technique.type=shadow_map")


def _exact(
    engine: EngineName, config: Config, lit: Sequence[Lit]
) -> tuple[Mapping[str, Any], dict[str, list[dict[str, Any]]]]:
    """The technique, and the lists of biases and filters, of an engine whose shadows are drawn exactly."""
    is_point = any(each.is_point for each in lit)
    if engine == "three.js":
        one = three_js(config, lit)
        # The engine draws no VSM of a point light.
        kinds = _THREE_FILTERS[:2] if is_point else _THREE_FILTERS
        filters = [_filter(kind, "shadow_type", one, () if kind == "BasicShadowMap" else ("radius",)) for kind in kinds]
    else:
        one, filters = babylon_js(config, lit), []
        for kind in _BABYLON_POINT_FILTERS if is_point else _BABYLON_FILTERS:
            made = babylon_js(config, lit, kind)
            filters.append(_filter(kind, "filter", made, [name for name in made.parameters if name not in _KEYS]))
    bias, offset = _EXACT[engine]
    choices = {bias: _KEYS[:1], offset: _KEYS[1:], f"{bias} + {offset}": _KEYS}
    biases = [
        {
            LABEL: label,
            **{f"technique.{name}": 0.0 for name in _KEYS},
            _PARAMETERS: {f"technique.{name}": one.parameters[name] for name in fitted},
        }
        for label, fitted in choices.items()
    ]
    return one.technique, {"biases": biases, "filters": filters}


def _filter(kind: str, key: str, made: EngineFit, fitted: Sequence[str]) -> dict[str, Any]:
    parameters = {f"technique.{name}": made.parameters[name] for name in fitted}
    entry = {LABEL: kind, f"technique.{key}": kind}
    return {**entry, _PARAMETERS: parameters} if parameters else entry


def engine_code(engine: EngineName, config: Config, filter_label: str) -> dict[str, str]:
    """The code that sets the fitted values of `config`, for each of its lights by key; of several views, for the first.

    `filter_label` is the name of the technique's filter.
    """
    shown = Progress.quiet()
    first = config.views[0].config if config.views else config
    if engine in FORMULA_ENGINES:
        lit = lit_by(first, shown)
        return {".".join(map(str, each.key)): code_of_formula(engine, config, filter_label, each) for each in lit}
    technique: Any = build_technique(config, fitting=False)
    return code_of(technique, first, draw(first, load(first, shown), technique, shown))


def code_file(engine: EngineName) -> str:
    """The file in a recommendation's folder that holds the code."""
    return f"engine.{FORMULA_ENGINES[engine].suffix if engine in FORMULA_ENGINES else 'js'}"


def title_of(engine: EngineName) -> str:
    """What the code is, in words."""
    return f"{code_file(engine)}, for {ENGINES[engine]}"


def _mistake(config: Config, path: tuple[str, ...], what: str) -> ConfigError:
    return ConfigError([Mistake(config.origin.place(path), ".".join(path), what)])
