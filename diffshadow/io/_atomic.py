"""Files that are there whole or not at all."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from ._errors import FileError


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path to write to, which becomes `path` when the block ends.

    The temporary file lies in the same folder and has the same suffix; its name begins with a dot. Where the block
    raises, it is removed and whatever was at `path` before stays. A process killed inside the block leaves the
    temporary file, never half of `path`.

    **Raises** `FileError` if the folder is missing, the block wrote nothing, or `path` is a folder.
    """
    target = Path(os.path.abspath(path))
    if not target.parent.is_dir():
        raise FileError(f"cannot write {target}: {target.parent} is not a folder; create it, or write elsewhere")
    if target.is_dir():
        raise FileError(f"cannot write {target}: it is a folder; give the name of a file")
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(6)}{target.suffix}")
    try:
        yield temporary
        if not temporary.exists():
            raise FileError(f"nothing was written to the temporary file of {target}; write to the path that is given")
        os.replace(temporary, target)
    finally:
        # After the rename there is nothing left to remove.
        with contextlib.suppress(OSError):
            temporary.unlink()


def check_writable(folder: str | os.PathLike[str]) -> None:
    """Finds out whether files can be written to `folder`, which need not exist yet, and leaves nothing behind.

    **Raises** `FileError` if the folder cannot be created or written to; the message says what is in the way.
    """
    target = Path(os.path.abspath(folder))
    for ancestor in (target, *target.parents):
        if os.path.lexists(ancestor) and not ancestor.is_dir():
            raise FileError(
                f"cannot write to the folder {target}: {ancestor} is in the way and is no folder; "
                "rename it, or write elsewhere"
            )
    made: list[Path] = []
    probe = target / f".probe-{secrets.token_hex(6)}"
    try:
        for level in reversed([level for level in (target, *target.parents) if not level.is_dir()]):
            level.mkdir(exist_ok=True)
            made.append(level)
        # A file system may be full though names can be made: write a byte.
        probe.write_bytes(b"\n")
    except OSError as error:
        raise FileError(
            f"cannot write to the folder {target}: {error.strerror or error}; "
            "check its permissions and the free space, or write elsewhere"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            probe.unlink()
        # A folder that somebody else has begun to use meanwhile is not empty, and stays.
        with contextlib.suppress(OSError):
            for level in reversed(made):
                level.rmdir()
