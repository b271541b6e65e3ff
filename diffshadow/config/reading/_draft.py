"""Reads configurations without checking them."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .._errors import ConfigError, KeyPath, Location, Mistake, Origin, show
from ..framing._auto import spell_out
from ._files import neighbour
from ._overrides import apply_overrides
from ._templates import is_mesh, resolved_path, template_of_mesh
from ._yaml import read_yaml


class Draft(NamedTuple):
    """An unchecked configuration, and the mistakes found so far.

    - `folder`: the folder for relative paths in the file.
    """

    data: dict[str, Any]
    origin: Origin
    folder: Path
    mistakes: list[Mistake]


def load_draft(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Draft:
    """Reads the YAML file `path` and applies `overrides`.

    `path` may also be `builtin:NAME`, a configuration of the package, or a mesh file, which replaces the mesh of
    `builtin:quickstart`.

    **Raises** `ConfigError` if the file cannot be read, or is not YAML.
    """
    file, source = resolved_path(path), str(path)
    if "\0" not in str(file) and is_mesh(file):
        data, notes = template_of_mesh(file)
        # Text that the program writes has no line.
        places: dict[KeyPath, Location] = {(): Location(str(file))}
        mistakes = apply_overrides(data, places, overrides)
        return Draft(data, Origin(str(file), places, notes), file.absolute().parent, mistakes)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        message = f"holds the byte 0x{error.object[error.start]:02x}; expected UTF-8 text; save the file as UTF-8"
        raise ConfigError([Mistake(Location(source, line), "", message)]) from None
    except (OSError, ValueError) as error:
        raise ConfigError([Mistake(Location(source), "", _unreadable(file, error))]) from None
    return parse_draft(text, overrides, source=source, folder=file.absolute().parent, name=file.stem)


def parse_draft(
    text: str, overrides: Sequence[str], *, source: str, folder: str | os.PathLike[str], name: str
) -> Draft:
    """Reads YAML `text` and applies `overrides`. Arguments are as for `parse_config`."""
    data, places, mistakes = read_yaml(text, lambda line, column: Location(source, line, column))
    places[()] = Location(source, 1, 1)
    if data is None:
        data = {}
    if not isinstance(data, dict):
        message = f"holds {show(data)}; expected a section with keys; write 'key: value' lines"
        raise ConfigError([*mistakes, Mistake(places[()], "", message)])
    spell_out(data)
    mistakes += apply_overrides(data, places, overrides)
    data.setdefault("name", name)
    return Draft(data, Origin(source, places), Path(folder), mistakes)


def _unreadable(file: Path, error: OSError | ValueError) -> str:
    match error:
        case FileNotFoundError():
            return f"there is no such file; expected a configuration in YAML; {neighbour(file)}"
        case OSError():
            given = f"cannot be read ({error.strerror})"
            return f"{given}; expected a configuration in YAML; check the path and its permissions"
        case _:  # A null character.
            return "is not the name of a file; expected a configuration in YAML; check the path"
