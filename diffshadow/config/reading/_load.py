"""Loads and checks configurations."""

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from statistics import median
from typing import Any

from pydantic import ValidationError

from ...settings.techniques import SingleMap
from .._errors import ConfigError, Mistake, Origin
from ..framing._auto import Asked, asked_in
from ..sections._config import Config
from ..sections._section import changed
from ..sections._technique import with_bias
from ._draft import Draft, load_draft, parse_draft
from ._files import resolve_files
from ._mistakes import mistakes_at, mistakes_of
from ._plugins import add_plugins
from ._views import views_of


def load_config(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    *,
    fitting: bool = False,
    files: bool = True,
    finding: bool = True,
) -> Config:
    """Loads the configuration in the YAML file `path`, with `overrides` applied.

    **Arguments:**

    - `path`: the file. Relative paths inside it are relative to its folder.
    - `overrides`: strings `key=value` with a dotted key (`scene.meshes.0.path`) and a YAML value. Relative paths inside
        them are relative to the current folder.
    - `fitting`: whether to check the section `fit` against the other sections. Needed for a fit, not for a render.
    - `files`: whether input files must exist, and the modules of users' classes. A report on a finished run needs only
        the settings.
    - `finding`: whether to find a missing camera, light, ground or bias. This loads the meshes. Without it, everything
      is checked, but the configuration is not complete.

    **Returns:** the configuration, with all paths absolute except `output`.

    **Raises** `ConfigError` with all mistakes in the file and the overrides.
    """
    return _single(checked(load_draft(path, overrides), fitting=fitting, files=files, finding=finding))


def parse_config(
    text: str,
    overrides: Sequence[str] = (),
    *,
    source: str = "configuration",
    folder: str | os.PathLike[str] = ".",
    name: str = "unnamed",
    fitting: bool = False,
    files: bool = True,
) -> Config:
    """Loads the configuration in YAML `text`, with `overrides` applied, like `load_config`.

    **Arguments:**

    - `source`: the name of the text in errors.
    - `folder`: the folder for relative paths in the text.
    - `name`: the run's name if the text does not set one.
    - `fitting`, `files`: as in `load_config`.

    **Raises** `ConfigError` with everything that is wrong.

    !!! Example

        ```python
        text = "scene: {meshes: [{path: builtin:torus}]}"
        settings = config.parse_config(text, ["shadow_map.resolution=[64, 64]"])
        settings.shadow_map.resolution  # (64, 64)
        ```
    """
    draft = parse_draft(text, overrides, source=source, folder=folder, name=name)
    return _single(checked(draft, fitting=fitting, files=files))


def checked(draft: Draft, *, fitting: bool = False, files: bool = True, finding: bool = True) -> Config:
    """Checks `draft` and makes its configuration. Paths in `draft.data` become absolute.

    **Arguments:**

    - `fitting`, `files`, `finding`: as in `load_config`.

    **Raises** `ConfigError` with all mistakes.
    """
    data, origin = draft.data, draft.origin
    missing = resolve_files(data, origin, draft.folder)
    mistakes = [*draft.mistakes, *(missing if files else ())]
    if unusable := add_plugins(data, origin, draft.folder, needed=files):
        # Neither a section nor its fitted numbers can be checked without its class.
        raise ConfigError([*mistakes, *unusable])
    # Views and runs of a sweep may also set a part to auto.
    asked, complete = asked_in(data)
    config = _valid(complete, origin, mistakes)
    if fitting:
        named = "parameters" in data.get("fit", {})
        mistakes += mistakes_at(config.fit_faults(named=named), origin)
    if mistakes:
        raise ConfigError(mistakes)
    if files:
        if finding and any(asked[:3]):
            config, data = _with_found(config, data, complete, asked)
        if finding:
            config, data = _with_bias_for(config, data)
        check = partial(checked, finding=finding)
        config._views, config._validation = views_of(config, draft._replace(data=data), check)
    return config


def _valid(data: dict[str, Any], origin: Origin, mistakes: list[Mistake]) -> Config:
    """The configuration of `data`.

    **Raises** `ConfigError` with `mistakes` and all further mistakes.
    """
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        # An unreadable value is missing, and must not be reported twice.
        reported = {(mistake.key, mistake.place.line) for mistake in mistakes}
        found = (each for each in mistakes_of(error, origin) if (each.key, each.place.line) not in reported)
        raise ConfigError([*mistakes, *found]) from None
    config._origin = origin
    return config


def _with_found(
    config: Config, data: dict[str, Any], complete: dict[str, Any], asked: Asked
) -> tuple[Config, dict[str, Any]]:
    """`config` and `data` with the parts of the scene that are `asked` for. `complete` has other values for them."""
    # Loads JAX, which other configurations do not need.
    from ..framing._find import find

    found = find(config, data["scene"], asked)
    if found is None:
        return config, complete
    data = {**data, "scene": found.scene}
    made = Config.model_validate(data)
    made._origin = replace(config.origin, notes=(*config.origin.notes, *found.notes))
    return made, data


def _with_bias_for(config: Config, data: dict[str, Any]) -> tuple[Config, dict[str, Any]]:
    """`config` and `data` with a constant bias for the size of the casters, if no constant is given."""
    given = "constant" in (data.get("bias") or {})
    # The texels of other layouts depend on the camera's view.
    if given or not config.bias.constant or not isinstance(config.technique, SingleMap):
        return config, data
    # Loads JAX, which other configurations do not need.
    from ..framing._texels import texels_across

    across = texels_across(config)
    if not len(across):
        return config, data
    data = dict(with_bias(data, float(median(across))))
    # Only this section changes. Checking the others again would take as long as the first time.
    made = changed(config, bias=type(config.bias).model_validate(data["bias"]))
    if any(True for _ in made.faults()):
        made = Config.model_validate(data)
    made._origin = config.origin
    return made, data


def _single(config: Config) -> Config:
    """`config`. **Raises** `ConfigError` if it is a sweep."""
    if config.sweep is None:
        return config
    message = (
        "makes this file a sweep of many runs; expected a single run; use diffshadow sweep, or override sweep=null"
    )
    raise ConfigError([Mistake(config.origin.place(("sweep",)), "sweep", message)])
