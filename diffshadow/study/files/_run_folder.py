"""A run's folder, which is there whole or not at all."""

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path

from ... import io
from ...config import Config, ConfigError, Problem
from ._schema import read_json

RESULT = "result.json"


# What `write_whole` adds to a folder's name: a dot, and a token with its dash and the ending of an older run.
_TOKEN_BYTES = 6
_OLD = "-old"
_ADDED = len(f".-{'0' * 2 * _TOKEN_BYTES}{_OLD}")
# The longest name of a file in a run's folder, of any light, while it is written.
_LONGEST_FILE = 80


def folder_of(config: Config, suffix: str = "") -> Path:
    """Where the run of `config` is to be written: `<output>/<name><suffix>`.

    **Raises** `ConfigError` if it cannot be written there, or something lies there that is no run.
    """
    output = config.output_folder
    folder = output / f"{config.name}{suffix}"
    _check_length(config, folder)
    try:
        io.check_writable(output)
        taken = os.path.lexists(folder) and not _is_run(folder)
    except io.FileError as error:
        raise _error(config, "output", str(error)) from error
    except OSError as error:
        said = f"{folder} cannot be read ({error.strerror}); expected a run's folder, or none; move it, or change name"
        raise _error(config, "name", said) from error
    if taken:
        raise _error(
            config,
            "name",
            f"{folder} exists and is no run's folder: it has no {RESULT}; expected a free name: move it, or change "
            "name or output",
        )
    return folder


def _check_length(config: Config, folder: Path) -> None:
    """**Raises** `ConfigError` if the file system takes no names or paths as long as those of the run in `folder`."""
    absolute = Path(os.path.abspath(folder))
    there = next(level for level in absolute.parents if os.path.isdir(level))
    longest, path = len(os.fsencode(absolute.name)) + _ADDED, len(os.fsencode(absolute)) + _ADDED + _LONGEST_FILE
    for key, what, length, limit in (
        ("name", "names of folders", longest, "PC_NAME_MAX"),
        ("output", "paths of files", path, "PC_PATH_MAX"),
    ):
        most = os.pathconf(there, limit)
        # Negative where there is no limit.
        if 0 <= most < length:
            raise _error(config, key, f"makes {what} of {length} bytes; expected at most {most} in {there}; shorten it")


def write_whole(folder: Path, write: Callable[[Path], None]) -> None:
    """Makes `folder` of what `write` puts into the empty folder that it is given.

    Until `write` has ended, an earlier run at `folder` stays as it was; then its files go, and any others that lie
    beside them move over. Where `write` raises, nothing is left of it. A link to a folder stays one.
    """
    folder = folder.resolve() if folder.is_dir() else folder
    made = [level for level in folder.parents if not level.exists()]
    folder.parent.mkdir(parents=True, exist_ok=True)
    token = secrets.token_hex(_TOKEN_BYTES)
    draft, old = (folder.with_name(f".{folder.name}-{token}{end}") for end in ("", _OLD))
    try:
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


def remove(path: Path) -> None:
    """Removes a file, a link or a folder with all that it holds, as far as that can be done."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


def _is_run(folder: Path) -> bool:
    return folder.is_dir() and ((folder / RESULT).is_file() or not any(folder.iterdir()))


def _keep_others(old: Path, new: Path) -> None:
    """Moves what `old` holds beside the files of its run to `new`."""
    try:
        written = set(read_json(old / RESULT)["files"])
    except (io.FileError, LookupError, TypeError):
        written = set()
    for entry in old.iterdir():
        if entry.name not in written and not os.path.lexists(new / entry.name):
            entry.rename(new / entry.name)


def _error(config: Config, key: str, what: str) -> ConfigError:
    return ConfigError([Problem(config.origin.place((key,)), key, what)])
