"""Atomic writes: a file is written completely or not at all."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from ._errors import FileError, naming_full_disks


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path, which is renamed to `path` when the block ends.

    The temporary file is in the same folder and has the same suffix; its name begins with a dot. If the block raises,
    the temporary file is removed and `path` does not change. A process killed inside the block leaves the temporary
    file behind, but never a partial `path`.

    **Raises** `FileError` if the folder is missing, the block wrote nothing, `path` is a folder, or no space is left.
    """
    target = Path(os.path.abspath(path))
    if not target.parent.is_dir():
        raise FileError(f"cannot write {target}: {target.parent} is not a folder; create it, or write elsewhere")
    if target.is_dir():
        raise FileError(f"cannot write {target}: it is a folder; give the name of a file")
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(6)}{target.suffix}")
    try:
        with naming_full_disks(target):
            yield temporary
        if not temporary.exists():
            raise FileError(f"nothing was written to the temporary file of {target}; write to the path that is yielded")
        os.replace(temporary, target)
    finally:
        # After the rename the temporary file is gone.
        with contextlib.suppress(OSError):
            temporary.unlink()


def check_writable(folder: str | os.PathLike[str]) -> None:
    """Checks that files can be written to `folder`, which may not exist yet. Removes its test file.

    **Raises** `FileError` if the folder cannot be created or written to; the message says why.
    """
    target = Path(os.path.abspath(folder))
    for ancestor in (target, *target.parents):
        if os.path.lexists(ancestor) and not ancestor.is_dir():
            raise FileError(
                f"cannot write to the folder {target}: {ancestor} exists and is not a folder; "
                "rename it, or write elsewhere"
            )
    made: list[Path] = []
    probe = target / f".probe-{secrets.token_hex(6)}"
    try:
        for level in reversed([level for level in (target, *target.parents) if not level.is_dir()]):
            level.mkdir(exist_ok=True)
            made.append(level)
        # A full file system may still accept new names, so write a byte.
        probe.write_bytes(b"\n")
    except OSError as error:
        raise FileError(
            f"cannot write to the folder {target}: {error.strerror or error}; "
            "check its permissions and the free space, or write elsewhere"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            probe.unlink()
        # A folder that another process has written to in the meantime is not empty, so it stays.
        with contextlib.suppress(OSError):
            for level in reversed(made):
                level.rmdir()
