"""Atomic writes of a run's folder. The folder is written completely or not at all."""

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ... import io
from ...config import RESULT_FILE as RESULT
from ...config import Config, ConfigError, Mistake
from ._files import read_json

# The suffixes that `write_whole` adds to a folder's name: a dot, a dash with a token, and the suffix of an older run.
_TOKEN_BYTES = 6
_OLD = "-old"
_ADDED = len(f".-{'0' * 2 * _TOKEN_BYTES}{_OLD}")
_DRAFT = re.compile(rf"\.(.+)-[0-9a-f]{{{2 * _TOKEN_BYTES}}}", re.DOTALL)
# The longest name of a file in a run's folder, including its temporary names.
_LONGEST_FILE = 80


class _Fault(NamedTuple):
    """The reason why a run cannot be written to its folder.

    - `key`: the key of the configuration that sets this part of the path; `what`: the message.
    - `otherwise`: the keys to change if the existing files are to stay.
    """

    key: str
    what: str
    otherwise: str = ""


def folder_of(config: Config, suffix: str = "") -> Path:
    """The folder of the run of `config`: `<output>/<name><suffix>`.

    **Raises** `ConfigError` if it cannot be written, or if something other than a run is there.
    """
    folder = config.output_folder / f"{config.name}{suffix}"
    fault = _too_long(folder) or _fault_of(folder)
    if fault is not None:
        message = f"{fault.what}, or change {fault.otherwise}" if fault.otherwise else fault.what
        raise ConfigError([Mistake(config.origin.place((fault.key,)), fault.key, message)])
    return folder


def checked_folder(path: str | os.PathLike[str]) -> Path:
    """The folder at `path`, for a run without a configuration.

    **Raises** `FileError` if it cannot be written, or if something other than a run is there; `TypeError` if `path` is
    not a path.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"the folder is of type {type(path).__name__}; expected a path, such as 'runs/mine'")
    folder = Path(path)
    if "\0" in str(folder) or not Path(os.path.abspath(folder)).name:
        raise io.FileError(f"the folder is {str(path)!r}; expected a folder of the run's own, such as runs/mine")
    if (fault := _too_long(folder)) is not None:
        raise io.FileError(f"the folder {folder} {fault.what}")
    if (fault := _fault_of(folder)) is not None:
        raise io.FileError(f"{fault.what}, or choose another folder" if fault.otherwise else fault.what)
    return folder


def _fault_of(folder: Path) -> _Fault | None:
    """The reason why a run cannot be written to `folder`, whose path is not too long. `None` if it can."""
    try:
        io.check_writable(folder.parent)
        is_run = folder.is_dir() and ((folder / RESULT).is_file() or not any(folder.iterdir()))
        taken = os.path.lexists(folder) and not is_run
    except io.FileError as error:
        return _Fault("output", str(error))
    except OSError as error:
        what = f"{folder} cannot be read ({error.strerror}); expected a run's folder, or none; move it"
        return _Fault("name", what, "name")
    if taken:
        what = f"{folder} exists and is not a run's folder: it has no {RESULT}; expected an unused name: move it"
        return _Fault("name", what, "name or output")
    return None


def _too_long(folder: Path) -> _Fault | None:
    """The names or paths of the run in `folder` that are too long for the file system."""
    absolute = Path(os.path.abspath(folder))
    existing = next(level for level in absolute.parents if os.path.isdir(level))
    longest, path = len(os.fsencode(absolute.name)) + _ADDED, len(os.fsencode(absolute)) + _ADDED + _LONGEST_FILE
    for key, what, length, limit in (
        ("name", "names of folders", longest, "PC_NAME_MAX"),
        ("output", "paths of files", path, "PC_PATH_MAX"),
    ):
        most = os.pathconf(existing, limit)
        # Negative if there is no limit.
        if 0 <= most < length:
            return _Fault(key, f"makes {what} of {length} bytes; expected at most {most} in {existing}; shorten it")
    return None


def write_whole(folder: Path, write: Callable[[Path], None]) -> None:
    """Writes `folder` atomically: calls `write` with an empty draft folder, then renames that to `folder`.

    An earlier run at `folder` is kept until `write` has returned. Then its files are removed, and any other files in
    the folder are moved to the new one. If `write` raises, its files are removed. A link to a folder remains a link.

    **Raises** `FullDiskError` if no space is left, and the errors of `write`.
    """
    folder = folder.resolve() if folder.is_dir() else folder
    made: list[Path] = []
    if not folder.parent.is_dir():
        made = [level for level in folder.parents if not level.exists()]
        folder.parent.mkdir(parents=True, exist_ok=True)
    token = secrets.token_hex(_TOKEN_BYTES)
    draft, old = (folder.with_name(f".{folder.name}-{token}{end}") for end in ("", _OLD))
    try:
        with io.naming_full_disks(folder):
            draft.mkdir()
            write(draft)
        if not folder.exists():
            draft.rename(folder)
            return
        folder.rename(old)
        try:
            draft.rename(folder)
        except OSError:
            old.rename(folder)
            raise
        _keep_others(old, folder)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if not folder.exists():
            with contextlib.suppress(OSError):
                for level in made:
                    level.rmdir()


def final_folder(folder: Path) -> Path:
    """The final folder of a draft of `write_whole`; any other folder itself."""
    found = _DRAFT.fullmatch(folder.name)
    return folder.with_name(found[1]) if found else folder


def remove(path: Path) -> None:
    """Removes a file, a link, or a folder with its content. Errors are ignored."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


def _keep_others(old: Path, new: Path) -> None:
    """Moves the files in `old` that its run did not write to `new`."""
    try:
        written = set(read_json(old / RESULT)["files"])
    except (io.FileError, LookupError, TypeError):
        written = set()
    for entry in old.iterdir():
        if entry.name not in written and not os.path.lexists(new / entry.name):
            entry.rename(new / entry.name)
