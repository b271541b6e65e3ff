"""Finds a user's files."""

import contextlib
import difflib
import os
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType

from ._errors import FileError

_COPIES: ContextVar[Mapping[str, Path]] = ContextVar("copies", default=MappingProxyType({}))


@contextlib.contextmanager
def reading_copies(copies: Mapping[str, Path]) -> Iterator[None]:
    """Reads the files at these absolute paths from their copies inside the block. Messages still name the paths.

    A worker on another machine reads its inputs in this way.
    """
    token = _COPIES.set(copies)
    try:
        yield
    finally:
        _COPIES.reset(token)


def on_disk(file: Path) -> Path:
    """The path from which the content of the absolute path `file` is read: its copy, or the file itself."""
    return _COPIES.get().get(os.path.normpath(file), file)


def existing_file(path: str | os.PathLike[str], what: str) -> Path:
    """The absolute path of `path`. `what` describes its content in messages, such as "mesh".

    **Raises** `FileError` if there is no such file. The message has the absolute path, and the most similar name in its
    folder.
    """
    absolute = Path(os.path.abspath(path))
    if str(absolute) in _COPIES.get():
        return absolute
    if absolute.is_dir():
        raise FileError(f"{absolute} is a folder; expected a {what} file: give the name of a file in it")
    if absolute.is_file():
        return absolute
    if absolute.exists():
        raise FileError(f"{absolute} is a device or a pipe; expected a {what} file: copy its content to a file")
    if not absolute.parent.is_dir():
        raise FileError(f"there is no {what} file {absolute}: the folder {absolute.parent} does not exist")
    try:
        names = {entry.name.lower(): entry.name for entry in absolute.parent.iterdir()}
    except OSError:
        names = {}
    near = difflib.get_close_matches(absolute.name.lower(), list(names), n=1)
    hint = f"did you mean {names[near[0]]!r}?" if near else "check the path"
    raise FileError(f"there is no {what} file {absolute}; {hint}")
