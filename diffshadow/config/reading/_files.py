"""The files that a configuration names, found by the mark `InputFile` on their keys."""

import difflib
import functools
import importlib.metadata
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic_core import PydanticCustomError

from ...settings import InputFile
from ...settings.scene import PIECES
from .._errors import KeyPath, Mistake, Origin, dotted
from ..sections._config import Config, path_of
from ..sections._scene import BUILTIN, MeshConfig
from ..sections._section import Section
from ._keys import file_marks
from ._plugins import COLON

_VIEWS = (("fit", "views"), ("fit", "validation"))


def files_in(value: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any, str]]:
    """Each path of an input file in the `value` at the key `path`: its key, the section that contains it, and the path.

    **Arguments:**

    - `value`: a configuration, or the unchecked data of one. In sections of views, dotted keys name files.
    """
    entries: Any = enumerate(value)
    if isinstance(value, dict | Section):
        entries = value.items() if isinstance(value, dict) else vars(value).items()
    for step, inner in entries:
        here = (*path, step)
        if isinstance(inner, str):
            mark = _mark_at(here)
            if mark is not None and mark.names(inner):
                yield here, value, inner
        elif isinstance(inner, dict | list | tuple | Section):
            yield from files_in(inner, here)


# Thousands of runs have the same keys.
@functools.lru_cache(maxsize=4096)
def _mark_at(path: KeyPath) -> InputFile | None:
    """The mark of the key at `path`. In a section of views, it is the mark of the key that views set."""
    steps = path[3:] if path[:2] in _VIEWS else path
    words = ".".join(step for step in steps if isinstance(step, str)).split(".")
    return file_marks().get(".".join(word for word in words if not word.isdecimal()))


def resolve_files(data: Any, origin: Origin, folder: Path) -> list[Mistake]:
    """Makes the paths of input files in `data` absolute.

    **Returns** a mistake for each file that does not exist. Files of views are checked together with their view.
    """
    mistakes = []
    for path, holder, given in [*files_in(data)]:
        # Paths in overrides are relative to the current folder.
        base = folder if origin.place(path).line is not None else Path()
        file = Path(given)
        try:
            file = Path(os.path.abspath(base / path_of(given)))
            holder[path[-1]] = str(file)
            what = None if file.is_file() else _missing(file)
            str(file).encode()
        except PydanticCustomError as error:
            what = error.message()
        except UnicodeEncodeError:
            what = f"is {file}, whose name is not UTF-8; expected a name in UTF-8; rename the file or a folder"
        except OSError as error:
            what = f"cannot be read ({error.strerror}); expected a file; check the path and its permissions"
        if what is not None and path[:2] not in _VIEWS:
            mistakes.append(Mistake(origin.place(path), dotted(path), what))
    return mistakes


def _missing(file: Path) -> str:
    if file.is_dir():
        return f"is the folder {file}; expected a file; give the name of a file in it"
    mend = f"did you mean {BUILTIN + file.name!r}?" if file.name in PIECES else neighbour(file)
    return f"there is no file {file}; expected a readable file; {mend}"


def neighbour(file: Path) -> str:
    """A question that suggests the file with the nearest name in the same folder."""
    try:
        names = [entry.name for entry in file.absolute().parent.iterdir()]
    except OSError:
        return f"check the path: there is no folder {file.absolute().parent}"
    near = difflib.get_close_matches(file.name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else "check the path"


def input_files(config: Config) -> list[Path]:
    """The absolute paths of all meshes and images that `config` and its views read."""
    from ...io import files_of_mesh

    found: dict[Path, None] = {}
    for path, holder, file in files_in(config):
        is_mesh = isinstance(holder, MeshConfig) and path[-1] == "path"
        if path[:2] not in _VIEWS:
            found |= dict.fromkeys(files_of_mesh(file) if is_mesh else [Path(file)])
    for view in (*config.views, *config.validation):
        found |= dict.fromkeys(input_files(view.config))
    return [*found]


@functools.cache
def _installed() -> frozenset[str]:
    return frozenset(importlib.metadata.packages_distributions())


def user_modules(config: Config) -> list[Path]:
    """The files of modules, and the folders of packages, that define classes of `config` and are not installed."""
    words = [getattr(section, "type", None) for section in (config.technique, config.filter, config.fit.loss)]
    names = {word.partition(COLON)[0].split(".")[0] for word in words if isinstance(word, str) and COLON in word}
    found = []
    # Searching the installed packages takes a second.
    for name in sorted(names - _installed()) if names else ():
        file = Path(getattr(sys.modules[name], "__file__", None) or "")
        found.append(file.parent if file.name == "__init__.py" else file)
    return found
