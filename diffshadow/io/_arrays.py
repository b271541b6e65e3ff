"""Reads arrays from `.npz` archives that may be damaged. Headers are checked before memory is allocated.

`np.load` allocates the memory that a member's header requests, even if the archive is smaller.
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
# The longest axis that is accepted if the layout does not fix its length.
_LONGEST = 1 << 24


class ArrayLayout(NamedTuple):
    """The layout of an array.

    - `kinds`: the accepted `kind` letters of its dtype: `f` real, `i` and `u` whole, `b` boolean.
    - `shape`: its length along each axis; `None` for any length from 1 to 2²⁴.
    - `required`: whether the archive must have it.
    - `bytes`: bytes per number; `None` accepts any size.
    """

    kinds: str
    shape: tuple[int | None, ...]
    required: bool = True
    bytes: int | None = None

    def fault(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> str | None:
        """The fault of an array with this shape and type, and the expected layout; `None` if it fits."""
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


def read_arrays(path: str | os.PathLike[str], layouts: Mapping[str, ArrayLayout]) -> dict[str, HostArray]:
    """Reads the arrays named in `layouts` from the `.npz` archive `path` and ignores all others.

    Types and shapes are checked against `layouts` and against the sizes of the archive's members before memory is
    allocated.

    **Raises** `FileError` if the archive cannot be read, is damaged, lacks a required array, or has an array that does
    not match its layout.
    """
    try:
        with open(path, "rb") as stream, zipfile.ZipFile(stream) as archive:
            names = [
                name for name, each in layouts.items() if each.required or f"{name}{_SUFFIX}" in archive.namelist()
            ]
            return {name: _array(archive, name, layouts[name]) for name in names}
    except FileError as error:
        raise FileError(f"{path} is damaged: {error}") from None
    except Exception as error:  # zipfile and NumPy's header parser raise many types
        reason = str(error).strip() or type(error).__name__
        raise FileError(f"{path} is damaged ({reason}); expected an archive of arrays") from error


def read_all_arrays(stream: IO[bytes]) -> dict[str, HostArray]:
    """Reads all arrays of an `.npz` archive, and checks the length of each member against its header.

    **Raises** `FileError`, or whatever `zipfile` and NumPy raise, if the archive is damaged.
    """
    with zipfile.ZipFile(stream) as archive:
        names = [name.removesuffix(_SUFFIX) for name in archive.namelist()]
        return {name: _array(archive, name) for name in names}


def read_header(stream: IO[bytes] | BufferedIOBase, what: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Reads the `.npy` header at the start of `stream`: shape, whether the order is Fortran's, and dtype.

    `what` names the array in messages.

    **Raises** `FileError` for an unsupported format version, and whatever NumPy raises for a damaged header.
    """
    version = np.lib.format.read_magic(stream)
    if version not in _READ_HEADER:
        raise FileError(f"{what} is of NumPy's format {version}; expected 1.0 or 2.0")
    return _READ_HEADER[version](stream)


def _array(archive: zipfile.ZipFile, name: str, layout: ArrayLayout | None = None) -> HostArray:
    try:
        info = archive.getinfo(f"{name}{_SUFFIX}")
    except KeyError:
        raise FileError(f"it has no array {name}; expected one") from None
    with archive.open(info) as member, warnings.catch_warnings():
        # NumPy warns about headers written by Python 2.
        warnings.simplefilter("ignore")
        shape, is_fortran, dtype = read_header(member, f"the array {name}")
        fault = None if layout is None else layout.fault(shape, dtype)
        if fault is not None:
            raise FileError(f"the array {name} {fault}")
        if dtype.hasobject or min(shape, default=0) < 0:
            raise FileError(f"the array {name} holds {dtype} of the shape {shape}; expected numbers")
        size, actual = math.prod(shape) * dtype.itemsize, info.file_size - member.tell()
        if size != actual:
            raise FileError(f"the array {name} has {actual:,} bytes; expected the {size:,} of its shape {shape}")
        content = member.read(size)
        # The member's size in the archive may be wrong too. Reading to the end also verifies the checksum.
        if len(content) != size or member.read(1):
            raise FileError(f"the array {name} has {len(content):,} bytes; expected {size:,}")
    # A bytearray, because an array backed by bytes is read-only.
    return np.ndarray(shape, dtype, bytearray(content), order="F" if is_fortran else "C")
