"""Arrays from `.npz` archives that somebody may have damaged: what an archive claims is checked before memory is taken.

`np.load` takes as much memory as a member's header asks for, whether the archive holds that much or not.
"""

import math
import os
import warnings
import zipfile
from collections.abc import Mapping
from io import BufferedIOBase
from typing import IO, Any, NamedTuple

import numpy as np

from .._types import HostArray
from ._errors import FileError

_SUFFIX = ".npy"
_READ_HEADER = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_KINDS = {"f": "real numbers", "i": "whole numbers", "u": "whole numbers", "b": "booleans"}
# Of an axis whose length the layout leaves open.
_LONGEST = 1 << 24


class Layout(NamedTuple):
    """What an array must look like.

    - `kinds`: the `kind` of its NumPy type, one of these letters: `f` real, `i` and `u` whole, `b` boolean.
    - `shape`: its lengths along each axis; `None` for any length from 1 to 2²⁴.
    - `required`: whether it must be there.
    - `bytes`: of each number, if only that size will do.
    """

    kinds: str
    shape: tuple[int | None, ...]
    required: bool = True
    bytes: int | None = None

    def fault(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> str | None:
        """What is wrong with an array of this shape and type, with what is expected; `None` if it is right."""
        if dtype.kind not in self.kinds or dtype.itemsize != (self.bytes or dtype.itemsize):
            size = "" if self.bytes is None else f" of {8 * self.bytes} bits"
            return f"holds {dtype}; expected {_KINDS[self.kinds[0]]}{size}"
        fits = len(shape) == len(self.shape) and all(
            1 <= length <= _LONGEST if expected is None else length == expected
            for length, expected in zip(shape, self.shape, strict=True)
        )
        if fits:
            return None
        words = " × ".join("n" if length is None else str(length) for length in self.shape)
        return f"has the shape {' × '.join(map(str, shape)) or '()'}; expected {words}"


def read_arrays(path: str | os.PathLike[str], layouts: Mapping[str, Layout]) -> dict[str, HostArray]:
    """The arrays of the `.npz` archive `path` that `layouts` names; others are not looked at.

    Types and shapes are checked, and compared with the sizes of the archive's members, before memory is taken.

    **Raises** `FileError` if the archive cannot be read or is damaged, lacks a required array, or holds one that does
    not suit its layout.
    """
    try:
        with open(path, "rb") as stream, zipfile.ZipFile(stream) as archive:
            there = [
                name for name, each in layouts.items() if each.required or f"{name}{_SUFFIX}" in archive.namelist()
            ]
            return {name: _array(archive, name, layouts[name]) for name in there}
    except FileError as error:
        raise FileError(f"{path} is damaged: {error}") from None
    except Exception as error:  # zip files and NumPy's headers raise what they like
        reason = str(error).strip() or type(error).__name__
        raise FileError(f"{path} is damaged ({reason}); expected an archive of arrays") from error


def read_all_arrays(stream: IO[bytes]) -> dict[str, HostArray]:
    """All arrays of an `.npz` archive, whose members hold what their headers say.

    **Raises** whatever `zipfile` and NumPy raise, and `FileError`, if it is damaged.
    """
    with zipfile.ZipFile(stream) as archive:
        names = [name.removesuffix(_SUFFIX) for name in archive.namelist()]
        return {name: _array(archive, name) for name in names}


def read_header(stream: IO[bytes] | BufferedIOBase, what: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether it is in Fortran's order, and type of the `.npy` array that `stream` begins with.

    **Raises** `FileError`, which calls it `what`, for a version that is not read; and what NumPy raises for a header
    that is damaged.
    """
    version = np.lib.format.read_magic(stream)
    if version not in _READ_HEADER:
        raise FileError(f"{what} is of NumPy's format {version}; expected 1.0 or 2.0")
    return _READ_HEADER[version](stream)


def _array(archive: zipfile.ZipFile, name: str, layout: Layout | None = None) -> HostArray:
    try:
        info = archive.getinfo(f"{name}{_SUFFIX}")
    except KeyError:
        raise FileError(f"it has no array {name}; expected one") from None
    with archive.open(info) as member, warnings.catch_warnings():
        # Of a header that Python 2 wrote.
        warnings.simplefilter("ignore")
        shape, is_fortran, dtype = read_header(member, f"the array {name}")
        fault = None if layout is None else layout.fault(shape, dtype)
        if fault is not None:
            raise FileError(f"the array {name} {fault}")
        if dtype.hasobject or min(shape, default=0) < 0:
            raise FileError(f"the array {name} holds {dtype} of the shape {shape}; expected numbers")
        size, there = math.prod(shape) * dtype.itemsize, info.file_size - member.tell()
        if size != there:
            raise FileError(f"the array {name} has {there:,} bytes; expected the {size:,} of its shape {shape}")
        content = member.read(size)
        # What the archive says of a member's size may be wrong, too; at its end, its checksum is looked at.
        if len(content) != size or member.read(1):
            raise FileError(f"the array {name} has {len(content):,} bytes; expected {size:,}")
    # A bytearray, since an array on top of bytes cannot be written to.
    return np.ndarray(shape, dtype, bytearray(content), order="F" if is_fortran else "C")
