"""A cache on disk for results, keyed by their inputs, and for the programs that JAX compiled.

A key is a hash of all inputs of the result. Changed inputs have a different key, so an entry is never out of date. The
least recently used entries are removed when a folder grows too large.
"""

import contextlib
import hashlib
import os
import re
import struct
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .._types import HostArray
from ._arrays import read_all_arrays
from ._atomic import atomic_path, check_writable
from ._errors import FileError

# Part of every key. Increase it when entries of older versions must no longer be read.
_FORMAT = 1
CACHE_LIMIT = 2 << 30
"""The limit of all results, and of all compiled programs, in bytes. Beyond it, the least recently used are removed."""
# Scanning a folder takes longer the larger it is, so it is pruned only after this many new bytes.
_BETWEEN = CACHE_LIMIT >> 6
_added: dict[Path, int] = {}
# The names of entries, and of temporary files of killed writers. Other files in the folder are never removed.
_RESULT = re.compile(r"\.?[0-9a-f]{64}(-[0-9a-f]+)?\.npz")
# JAX names programs by function and key.
_PROGRAM = re.compile(r".+-[0-9a-f]{64}-(cache|atime)")


def cached_arrays(
    key_parts: Any,
    compute: Callable[[], Mapping[str, Any]],
    folder: str | os.PathLike[str] | None = None,
) -> dict[str, HostArray]:
    """The arrays that `compute` returns, read from disk if they were computed before.

    **Arguments:**

    - `key_parts`: all inputs of the result: numbers, strings, `None`, arrays, and lists, tuples and mappings of these.
      Include a version of the algorithm.
    - `compute`: called without arguments if there is no entry; returns arrays by name.
    - `folder`: the cache folder; by default `$DIFFSHADOW_CACHE`, or `diffshadow` in the user's cache folder
        (`$XDG_CACHE_HOME` or `~/.cache`).

    **Returns:** the arrays by name, in host memory. An entry that cannot be read is recomputed. If the folder cannot
    be written to, a warning says so and the result is still returned.

    **Raises** `ValueError` if `key_parts` has an object that cannot be hashed by its content.
    """
    key = cache_key(key_parts)
    try:
        where = cache_folder() if folder is None else Path(folder)
        where.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder can be found
        _warn_of_no_cache(folder, error)
        return _on_host(compute())
    entry = where / f"{key}.npz"
    found = _read(entry)
    if found is not None:
        return found
    arrays = _on_host(compute())
    try:
        _write(entry, arrays)
        _has_grown(where, entry.stat().st_size)
    except (OSError, FileError) as error:
        _warn_of_no_cache(where, error)
    return arrays


def cached_content(key: str) -> bytes | None:
    """The file of the entry with this `key` in `cache_folder`, or `None` if there is no readable entry."""
    try:
        return (cache_folder() / f"{key}.npz").read_bytes()
    except (OSError, RuntimeError):
        return None


def keep_content(key: str, content: bytes) -> None:
    """Adds the file of an entry, as `cached_content` returns it, to `cache_folder` unless it is there. Does nothing if
    the folder cannot be written to."""
    with contextlib.suppress(OSError, RuntimeError, FileError):
        entry = cache_folder() / f"{key}.npz"
        if not entry.exists():
            entry.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(entry) as temporary:
                temporary.write_bytes(content)
            _has_grown(entry.parent, len(content))


def cache_folder() -> Path:
    """The folder for cached results, from the environment; it may not exist yet."""
    chosen = os.environ.get("DIFFSHADOW_CACHE")
    if chosen:
        # Expand only the user's own home folder: another user's may be the root of the file system.
        home = chosen == "~" or chosen.startswith("~/")
        return Path(chosen).expanduser() if home else Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "diffshadow"


def cache_key(key_parts: Any) -> str:
    """A hash of `key_parts`, as `cached_arrays` takes them: 64 hexadecimal digits.

    **Raises** `ValueError` if a part cannot be hashed by its content.
    """
    digest = hashlib.sha256()
    _feed(digest.update, ["diffshadow", _FORMAT, key_parts])
    return digest.hexdigest()


def prune_cache(folder: str | os.PathLike[str], limit: int = CACHE_LIMIT) -> None:
    """Removes the least recently used entries of `folder` until the others take at most `limit` bytes.

    Results and compiled programs are entries. The newest is always kept, and so is every file that is not an entry.
    """
    total = 0
    for i, (_, size, path) in enumerate(sorted(_entries(Path(folder)), reverse=True)):
        total += size
        if i > 0 and total > limit:
            path.unlink(missing_ok=True)


def clear_cache(folder: str | os.PathLike[str]) -> None:
    """Removes all entries of `folder`, and no other file."""
    for *_, path in _entries(Path(folder)):
        path.unlink(missing_ok=True)


def cache_size(folder: str | os.PathLike[str]) -> tuple[int, int]:
    """The number of entries in `folder`, and their size in bytes."""
    sizes = [size for _, size, _ in _entries(Path(folder))]
    return len(sizes), sum(sizes)


def programs_folder() -> Path:
    """The folder for compiled programs: JAX's setting (`JAX_COMPILATION_CACHE_DIR`), or a folder in `cache_folder`."""
    return Path(jax.config.jax_compilation_cache_dir or cache_folder() / "xla")


def keep_compiled_programs(folder: str | os.PathLike[str] | None = None) -> None:
    """Lets JAX keep compiled programs in `folder`, by default `programs_folder`, so that the next process starts
    sooner.

    If the user has set a folder (`JAX_COMPILATION_CACHE_DIR`), it is used unchanged. Any other folder is pruned.
    Nothing is kept if the folder cannot be written to.
    """
    if jax.config.jax_compilation_cache_dir:
        return
    with contextlib.suppress(OSError, RuntimeError, FileError):
        folder = programs_folder() if folder is None else Path(folder)
        check_writable(folder)
        folder.mkdir(parents=True, exist_ok=True)
        prune_cache(folder)
        jax.config.update("jax_compilation_cache_dir", str(folder))
        # Small programs are also faster to read than to compile.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _entries(folder: Path) -> list[tuple[int, int, Path]]:
    """Time of last use in nanoseconds, size in bytes and path of each entry. Empty if there is no folder."""
    entries = []
    for path in folder.iterdir() if folder.is_dir() else ():
        is_program = _PROGRAM.fullmatch(path.name) is not None
        if is_program or _RESULT.fullmatch(path.name):
            with contextlib.suppress(FileNotFoundError):  # another process removed it
                status = path.stat()
                # Reading a result sets its modification time. For programs, most file systems record the day of last
                # use.
                used = max(status.st_mtime_ns, status.st_atime_ns if is_program else 0)
                entries.append((used, status.st_size, path))
    return entries


def _feed(update: Callable[[bytes], None], part: Any) -> None:
    """Hashes one part. A tag and a length precede each part, so that different parts cannot produce the same bytes."""
    match part:
        # Arrays come first, because some NumPy scalars are also Python scalars.
        case np.ndarray() | np.generic() | jax.Array():
            _feed_array(update, np.asarray(part))
        case None | bool() | str():
            _tagged(update, type(part).__name__, str(part).encode())
        case int():
            _tagged(update, "int", str(part).encode())
        case float():
            _tagged(update, "float", struct.pack("<d", part))
        case bytes():
            _tagged(update, "bytes", part)
        case list() | tuple():
            _tagged(update, "sequence", str(len(part)).encode())
            for inner in part:
                _feed(update, inner)
        case Mapping():
            _tagged(update, "mapping", str(len(part)).encode())
            for name in sorted(part, key=str):
                _feed(update, name)
                _feed(update, part[name])
        case _:
            raise ValueError(
                f"a cache key holds a {type(part).__name__}, whose content cannot be hashed; "
                "expected numbers, strings, arrays, and lists or mappings of these"
            )


def _feed_array(update: Callable[[bytes], None], array: HostArray) -> None:
    if array.dtype.hasobject:
        raise ValueError(f"a cache key holds an array of {array.dtype}, whose content cannot be hashed")
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    _tagged(update, "array", f"{little.dtype.str}{little.shape}".encode())
    update(np.ascontiguousarray(little).tobytes())


def _tagged(update: Callable[[bytes], None], tag: str, data: bytes) -> None:
    update(f"{tag}:{len(data)}:".encode())
    update(data)


def _on_host(arrays: Mapping[str, Any]) -> dict[str, HostArray]:
    return {name: np.asarray(array) for name, array in arrays.items()}


def _has_grown(folder: Path, size: int) -> None:
    """Prunes `folder` from time to time, given the `size` of a new entry in bytes."""
    _added[folder] = _added.get(folder, _BETWEEN) + size
    if _added[folder] > _BETWEEN:
        prune_cache(folder)
        _added[folder] = 0


def _read(entry: Path) -> dict[str, HostArray] | None:
    """The entry's arrays, or `None` if it is missing or damaged."""
    try:
        with entry.open("rb") as file:
            arrays = {name.removeprefix("_"): array for name, array in read_all_arrays(file).items()}
    except Exception:  # zipfile and NumPy's header parser raise many types
        return None
    # Pruning uses the modification time as the time of last use. The file may belong to another user.
    with contextlib.suppress(OSError):
        os.utime(entry)
    return arrays


def _write(entry: Path, arrays: dict[str, HostArray]) -> None:
    with atomic_path(entry) as temporary:
        # The underscore keeps the names from clashing with `savez`'s own arguments.
        np.savez(temporary, allow_pickle=False, **{f"_{name}": array for name, array in arrays.items()})


def _warn_of_no_cache(folder: Any, error: Exception) -> None:
    where = "the cache folder" if folder is None else f"the cache folder {folder}"
    warnings.warn(
        f"{where} cannot be used ({error}); results are recomputed each time: set DIFFSHADOW_CACHE to a folder "
        "that can be written to",
        stacklevel=3,
    )
