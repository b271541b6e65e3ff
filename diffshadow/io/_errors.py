"""Errors and warnings of file input and output."""

import contextlib
import errno
import os
from collections.abc import Iterator, Sequence
from typing import TypeGuard

# The maximum number of names in one sentence.
_SHOWN = 4


class FileError(ValueError):
    """A file or folder cannot be read or written, or has unexpected content."""


class FullDiskError(FileError):
    """There is no space left for a file or folder."""


# The error codes of systems without space, or with an exhausted quota.
_FULL = (errno.ENOSPC, errno.EDQUOT)


def is_full_disk(error: BaseException | None) -> bool:
    """Whether `error` or its cause says that no space is left."""
    return any(isinstance(each, FullDiskError) or _is_full(each) for each in _chain(error))


@contextlib.contextmanager
def naming_full_disks(path: str | os.PathLike[str], more: str = "") -> Iterator[None]:
    """Wraps a block that writes `path`. `more` follows the message.

    **Raises** `FullDiskError` with this path if there is no space for it.
    """
    try:
        yield
    except Exception as error:  # Libraries raise their own types while they handle the system's error.
        if not is_full_disk(error):
            raise
        reason = next((each.strerror for each in _chain(error) if _is_full(each)), os.strerror(errno.ENOSPC))
        raise FullDiskError(
            f"cannot write {os.path.abspath(path)}: {reason}; expected free space there: free some and run the same "
            f"command again, or write elsewhere{more}"
        ) from error


def _is_full(error: BaseException) -> TypeGuard[OSError]:
    return isinstance(error, OSError) and error.errno in _FULL


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An error and its chain of causes."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


class FileWarning(UserWarning):
    """A file was read, but parts of it were left out or changed."""


class MeshWarning(FileWarning):
    """A mesh file has parts other than triangles, which were left out, or its coordinates are rounded."""


class ImageWarning(FileWarning):
    """An image file has metadata that was ignored, or more content than was read."""


class MeshError(Exception):
    """The fault of a mesh file and its remedy, phrased to follow the file's name.

    The readers of the formats raise it; `load_mesh` adds the name.
    """


class Faults:
    """The faults of omitted parts of a scene."""

    def __init__(self):
        self._names: dict[str, list[str]] = {}

    def add(self, name: str, fault: MeshError) -> None:
        """Adds the part of this name."""
        self._names.setdefault(str(fault), []).append(name)

    @property
    def count(self) -> int:
        """The number of omitted parts."""
        return sum(map(len, self._names.values()))

    def remarks(self) -> list[str]:
        """A sentence for each fault, with the names of its parts."""
        return [f"{some_of(names)}: left out, because the file {fault}" for fault, names in self._names.items()]

    def error(self) -> MeshError | None:
        """The first fault, or `None`."""
        return next((MeshError(f"{fault} (in {names[0]})") for fault, names in self._names.items()), None)


def some_of(names: Sequence[str]) -> str:
    """The first of `names`, and the number of the others."""
    rest = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {rest} others" if rest > 1 else f" and {names[-1]}" if rest == 1 else "")


def damaged(reason: str) -> MeshError:
    return MeshError(f"is damaged: {reason}; export it again")
