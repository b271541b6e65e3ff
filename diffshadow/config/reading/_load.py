"""Loads and checks configurations."""

import difflib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from ...settings.scene import PIECES
from .._errors import ConfigError, KeyPath, Location, Mistake, Origin, dotted, show
from ..framing._auto import asked_in, spell_out, without_auto
from ..sections._paths import path_of
from ..sections._scene import BUILTIN
from ..whole._between import data_faults_of_fit, fit_faults
from ..whole._schema import Config
from ._draft import Draft
from ._mistakes import mistakes_at, mistakes_of
from ._of_mesh import is_mesh, scene_of_mesh
from ._overrides import apply_overrides
from ._plugins import add_plugins
from ._templates import DEFAULT_TEMPLATE, resolved_path, template_text
from ._views import resolve_views, views_of
from ._yaml import read_yaml

# Engines have no slope-scaled bias, so that a fit without it converts to all of them.
_AS_ENGINES = "bias.slope=0"


def load_config(
    path: str | os.PathLike[str], overrides: Sequence[str] = (), *, fitting: bool = False, files: bool = True
) -> Config:
    """Loads the configuration in the YAML file `path`, with `overrides` applied.

    **Arguments:**

    - `path`: the file. Relative paths inside it are relative to its folder.
    - `overrides`: strings `key=value` with a dotted key (`scene.meshes.0.path`) and a YAML value. Relative paths inside
        them are relative to the current folder.
    - `fitting`: whether to check the section `fit` against the other sections. Needed for a fit, not for a render.
    - `files`: whether input files must exist, and the modules of users' classes. A report on a finished run needs only
        the settings.

    **Returns:** the configuration, with all paths absolute except `output`.

    **Raises** `ConfigError` with everything that is wrong with the file and the overrides.
    """
    return _single(checked(load_draft(path, overrides), fitting=fitting, files=files))


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
    - `folder`: the folder that relative paths in the text start from.
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


def load_draft(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Draft:
    """Reads the YAML file `path` and applies `overrides`, without checking the result.

    `path` may also be `builtin:NAME`, a configuration that comes with the package, or a mesh file, which is put into
    the scene of `builtin:quickstart`.

    **Raises** `ConfigError` if the file cannot be read, or is not YAML.
    """
    file = resolved_path(path)
    if "\0" not in str(file) and is_mesh(file):
        return _draft_of_mesh(file, overrides)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        message = f"holds the byte 0x{error.object[error.start]:02x}; expected UTF-8 text; save the file as UTF-8"
        raise ConfigError([Mistake(Location(str(path), line), "", message)]) from None
    except OSError as error:
        raise ConfigError([Mistake(Location(str(path)), "", _unreadable(file, error))]) from None
    except ValueError:  # a null character
        message = "is not the name of a file; expected a configuration in YAML; check the path"
        raise ConfigError([Mistake(Location(str(path)), "", message)]) from None
    return parse_draft(text, overrides, source=str(path), folder=file.absolute().parent, name=file.stem)


def _draft_of_mesh(file: Path, overrides: Sequence[str]) -> Draft:
    """A draft with a mesh file in the scene of the default template."""
    made = scene_of_mesh(file)
    name = file.stem.strip() or "mesh"
    text = template_text(DEFAULT_TEMPLATE, source=str(file), file=f"{name}.yaml", scene=made.scene, side=made.side)
    text = re.sub(r"^name: .*\n", "", text, count=1, flags=re.MULTILINE)
    draft = parse_draft(text, [_AS_ENGINES, *overrides], source=str(file), folder=file.absolute().parent, name=name)
    # Lines would be of the template.
    places = {path: replace(place, line=None, column=None) for path, place in draft.origin.places.items()}
    return draft._replace(origin=Origin(str(file), places, made.notes))


def parse_draft(
    text: str, overrides: Sequence[str], *, source: str, folder: str | os.PathLike[str], name: str
) -> Draft:
    """Reads YAML `text` and applies `overrides`, without checking the result. Arguments are as for `parse_config`."""
    data, places, mistakes = read_yaml(text, lambda line, column: Location(source, line, column))
    places = {**places, (): Location(source, 1, 1)}
    if data is None:
        data = {}
    if not isinstance(data, dict):
        message = f"holds {show(data)}; expected a section with keys; write 'key: value' lines"
        raise ConfigError([*mistakes, Mistake(places[()], "", message)])
    spell_out(data)
    mistakes += apply_overrides(data, places, overrides)
    data.setdefault("name", name)
    return Draft(data, Origin(source, places), Path(folder), mistakes)


def checked(draft: Draft, *, fitting: bool = False, files: bool = True) -> Config:
    """Checks `draft` and makes its configuration. Paths in `draft.data` become absolute.

    **Arguments:**

    - `fitting`, `files`: as in `load_config`.

    **Raises** `ConfigError` with everything that is wrong.
    """
    data, origin = draft.data, draft.origin
    missing = _resolve_files(data, origin, draft.folder)
    resolve_views(data, origin, draft.folder)
    # Views and runs of a sweep may set a part to auto.
    spell_out(data)
    mistakes = [*draft.mistakes, *(missing if files else ())]
    if unusable := add_plugins(data, origin, draft.folder, needed=files):
        # A section cannot be checked without its class, and neither can the numbers that are fitted in it.
        raise ConfigError([*mistakes, *unusable])
    config = _valid(without_auto(data), origin, mistakes, fitting)
    if not files:
        return config
    config, data = _found(config, data)
    config._views, config._validation = views_of(config, draft._replace(data=data), checked)
    return config


def _valid(data: dict[str, Any], origin: Origin, mistakes: list[Mistake], fitting: bool) -> Config:
    """The configuration of `data`.

    **Raises** `ConfigError` with `mistakes` and everything that is wrong with it.
    """
    # Checked on the data, so that messages quote numbers as they were written.
    of_fit = mistakes_at(data_faults_of_fit(data), origin) if fitting else []
    try:
        config = Config.model_validate(data)
    except ValidationError as error:
        found = [*mistakes_of(error, origin), *of_fit]
        # A value that could not be read is missing, and must not be reported twice.
        reported = {(mistake.key, mistake.place.line) for mistake in mistakes}
        raise ConfigError([*mistakes, *(p for p in found if (p.key, p.place.line) not in reported)]) from None
    config._origin = origin
    if fitting:
        mistakes = [*mistakes, *of_fit, *mistakes_at(fit_faults(config), origin)]
    if mistakes:
        raise ConfigError(mistakes)
    return config


def _found(config: Config, data: dict[str, Any]) -> tuple[Config, dict[str, Any]]:
    """`config` and `data` with the parts of the scene that `data` leaves to the program."""
    asked = asked_in(data)
    if not any(asked):
        return config, data
    # It loads JAX, which other configurations do without.
    from ..framing._find import find

    found = find(config, data["scene"], asked)
    if found is None:
        return config, without_auto(data)
    data = {**data, "scene": found.scene}
    complete = Config.model_validate(data)
    complete._origin = replace(config.origin, notes=(*config.origin.notes, *found.notes))
    return complete, data


def _single(config: Config) -> Config:
    """`config`. **Raises** `ConfigError` if it is a sweep."""
    if config.sweep is None:
        return config
    message = (
        "makes this file a sweep of many runs; expected a single run; use diffshadow sweep, or override sweep=null"
    )
    raise ConfigError([Mistake(config.origin.place(("sweep",)), "sweep", message)])


def _resolve_files(data: dict[str, Any], origin: Origin, folder: Path) -> list[Mistake]:
    """Makes the paths of input files in `data` absolute. **Returns** a mistake for each file that does not exist."""
    mistakes = []
    for path, holder in _file_keys(data):
        place, key = origin.place(path), path[-1]
        # Paths in overrides are relative to the current folder.
        base = folder if place.line is not None else Path()
        file = Path(holder[key])
        try:
            file = Path(os.path.abspath(base / path_of(holder[key])))
            holder[key] = str(file)
            what = None if file.is_file() else _missing(file)
            holder[key].encode()
        except PydanticCustomError as error:
            what = error.message()
        except UnicodeEncodeError:
            what = f"is {holder[key]}, whose name is not UTF-8; expected one that is; rename the file or a folder"
        except OSError as error:
            what = f"cannot be read ({error.strerror}); expected a file; check the path and its permissions"
        if what is not None:
            mistakes.append(Mistake(place, dotted(path), what))
    return mistakes


def _file_keys(data: dict[str, Any]) -> Iterator[tuple[KeyPath, Any]]:
    """The paths of the keys of input files, and the sections or lists that hold them."""
    scene, reference, fit = data.get("scene"), data.get("reference"), data.get("fit")
    shape = fit.get("shape") if isinstance(fit, dict) else None
    meshes: list[tuple[KeyPath, Any]] = []
    for start, holder, key in ((("scene",), scene, "meshes"), (("fit", "shape"), shape, "targets")):
        entries: Any = holder.get(key) if isinstance(holder, dict) else None
        meshes += [((*start, key, i), mesh) for i, mesh in enumerate(entries)] if isinstance(entries, list) else []
    if isinstance(shape, dict):
        meshes.append((("fit", "shape", "start"), shape.get("start")))
        for key in ("images", "masks"):
            files: Any = shape.get(key)
            listed = enumerate(files) if isinstance(files, list) else ()
            yield from ((("fit", "shape", key, i), files) for i, file in listed if file and isinstance(file, str))
    for path, mesh in meshes:
        file = mesh.get("path") if isinstance(mesh, dict) else None
        if isinstance(file, str) and file and not file.startswith(BUILTIN):
            yield (*path, "path"), mesh
        texture = mesh.get("texture") if isinstance(mesh, dict) else None
        if isinstance(texture, str) and texture:
            yield (*path, "texture"), mesh
    if isinstance(reference, dict):
        given = [key for key in ("path", "mask") if reference.get(key) and isinstance(reference[key], str)]
        yield from ((("reference", key), reference) for key in given)


def _missing(file: Path) -> str:
    if file.is_dir():
        return f"is the folder {file}; expected a file; give the name of a file in it"
    mend = f"did you mean {BUILTIN + file.name!r}?" if file.name in PIECES else _neighbour(file)
    return f"there is no file {file}; expected one that can be read; {mend}"


def _unreadable(file: Path, error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return f"there is no such file; expected a configuration in YAML; {_neighbour(file)}"
    return f"cannot be read ({error.strerror}); expected a configuration in YAML; check the path and its permissions"


def _neighbour(file: Path) -> str:
    """A question that suggests the file with the nearest name in the same folder."""
    try:
        names = [entry.name for entry in file.absolute().parent.iterdir()]
    except OSError:
        return f"check the path: there is no folder {file.absolute().parent}"
    near = difflib.get_close_matches(file.name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else "check the path"
