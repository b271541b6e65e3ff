"""The data in a glTF file's buffers.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.6 and 4.4.
"""

import base64
import os
import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from jaxtyping import Shaped
from pydantic import BaseModel, ValidationError

from .._types import HostArray
from ._errors import MeshError, damaged
from ._gltf_schema import Document, parse, unknown
from ._paths import on_disk
from ._text import excerpt, listed

_MAGIC = b"glTF"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
Form = Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT4"]
_WIDTHS: Mapping[Form, int] = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# A sparse accessor can declare any number of zeros without storing them. Real files declare fewer than this.
_MAX_ZEROS = 2**24


def chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON of a glTF or GLB file, and the binary buffer of a GLB file if it has one.

    **Raises** `MeshError` if a GLB file is damaged or has another version.
    """
    if not data.startswith(_MAGIC):
        return data, None
    if len(data) < 12:
        raise damaged("it ends within its header")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise MeshError(f"is of glTF version {version}, which cannot be read; convert it to glTF 2.0")
    # Some writers pad the last block of bytes.
    if length > len(data) or data[length:].strip(b"\0 "):
        raise damaged(f"it has {len(data)} bytes; expected {length}")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise damaged("it ends within a chunk")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON not in found:
        raise damaged("it has no chunk of JSON")
    # Some writers pad the text with zeros instead of spaces.
    return found[_JSON].rstrip(b"\0"), found.get(_BINARY)


def item[T](items: Sequence[T], index: int, what: str) -> T:
    """`items[index]`. **Raises** `MeshError` if there is no such item."""
    if index >= len(items):
        raise damaged(f"it refers to {what} {index}, but has {len(items)}")
    return items[index]


def entry_of[T: BaseModel](model: type[T], entries: Sequence[Any], number: int) -> T | None:
    """An entry of the file. `None` if there is no such entry, or if it breaks the specification."""
    try:
        return model.model_validate(entries[number]) if 0 <= number < len(entries) else None
    except ValidationError:
        return None


class NoDataError(Exception):
    """An accessor has no data because an extension provides it."""


class Buffers:
    """Reads a file's accessors. A buffer is loaded on first use."""

    def __init__(self, document: Document, binary: bytes | None, folder: Path):
        self._document = document
        self._folder = folder
        self._binary = binary
        self._loaded: dict[int, bytes] = {}

    def values(self, index: int, form: Form) -> Shaped[HostArray, "n width"]:
        """The accessor's n rows. Normalized integers are mapped to [-1, 1] or [0, 1].

        **Raises** `MeshError` if they cannot be read, and `NoDataError` if an extension provides them.
        """
        accessor = item(self._document.accessors, index, "accessor")
        if accessor.type != form:
            raise damaged(f"its accessor {index} holds {excerpt(accessor.type)}; expected {form}")
        kind, width = np.dtype(_COMPONENTS[accessor.component_type]), _WIDTHS[form]
        sparse = accessor.sparse
        if accessor.buffer_view is not None:
            rows = self._rows(accessor.buffer_view, accessor.byte_offset, kind, accessor.count, width)
        elif sparse is None:
            raise NoDataError
        elif accessor.count > _MAX_ZEROS:
            raise damaged(f"its accessor {index} declares {accessor.count} zeros; expected at most {_MAX_ZEROS}")
        else:
            rows = np.zeros((accessor.count, width), kind)
        if sparse is not None:
            at, new = sparse.indices, sparse.values
            places = self._rows(
                at.buffer_view, at.byte_offset, np.dtype(_COMPONENTS[at.component_type]), sparse.count, 1
            )
            if places.max() >= accessor.count:
                raise damaged(f"its accessor {index} replaces row {places.max()}, but has {accessor.count}")
            rows = rows.copy()
            rows[places[:, 0]] = self._rows(new.buffer_view, new.byte_offset, kind, sparse.count, width)
        if accessor.normalized and kind.kind in "iu":
            return np.maximum(rows / np.iinfo(kind).max, -1)
        return rows

    def view(self, index: int) -> memoryview:
        """The bytes of a buffer view.

        **Raises** `MeshError` if they cannot be read.
        """
        view = item(self._document.buffer_views, index, "buffer view")
        buffer = self._buffer(view.buffer, view.extensions)
        end = view.byte_offset + view.byte_length
        if end > len(buffer):
            raise damaged(f"buffer view {index} ends beyond its buffer, which has {len(buffer)} bytes")
        return memoryview(buffer)[view.byte_offset : end]

    def count(self, index: int) -> int:
        """The number of rows of the accessor."""
        return item(self._document.accessors, index, "accessor").count

    def form(self, index: int) -> Form | None:
        """The type of the accessor, or `None` if the accessor cannot be read."""
        found = item(self._document.accessors, index, "accessor").type
        return next((form for form in _WIDTHS if form == found), None)

    def file(self, uri: str) -> bytes:
        """The content of a file inside the glTF file or next to it.

        **Raises** `MeshError` if it cannot be read.
        """
        return _embedded(uri) if uri.startswith("data:") else self._beside(uri)

    def _rows(
        self, view_index: int, offset: int, kind: np.dtype, count: int, width: int
    ) -> Shaped[HostArray, "n width"]:
        view, data = item(self._document.buffer_views, view_index, "buffer view"), self.view(view_index)
        row = kind.itemsize * width
        stride = view.byte_stride or row
        end = offset + (count - 1) * stride + row
        if end > view.byte_length:
            raise damaged(f"an accessor needs {end} bytes of buffer view {view_index}, which has {view.byte_length}")
        return np.ndarray((count, width), kind, data, offset, (stride, kind.itemsize))

    def _buffer(self, index: int, extensions: Iterable[str]) -> bytes:
        """The buffer's bytes. If the buffer has no data, the message names `extensions`, which are its view's."""
        if index not in self._loaded:
            buffer = item(self._document.buffers, index, "buffer")
            own = self._binary if index == 0 else None
            content = own if buffer.uri is None else self.file(buffer.uri)
            if content is None:
                raise unread(extensions) or damaged(f"its buffer {index} has no data")
            if len(content) < buffer.byte_length:
                raise damaged(f"its buffer {index} has {len(content)} bytes; expected {buffer.byte_length}")
            self._loaded[index] = content
        return self._loaded[index]

    def _beside(self, uri: str) -> bytes:
        """The content of a file that the glTF file refers to."""
        if "://" in uri:
            raise MeshError(f"keeps its data at {excerpt(uri)}; download that file, and set the uri to its local path")
        for name in _names(uri):
            try:
                return on_disk(self._folder / name).read_bytes()
            except FileNotFoundError:
                continue
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or str(error)
                raise MeshError(
                    f"needs the file {excerpt(uri)} in the same folder, which cannot be read: {reason}"
                ) from error
        raise MeshError(f"needs the file {excerpt(uri)} in the same folder, which does not exist; put it there")


def files_beside(data: bytes, folder: Path) -> list[Path]:
    """The files in `folder` with the buffers and images of the glTF file with the content `data`.

    **Raises** `MeshError` if the file is damaged.
    """
    document = parse(chunks(data)[0])
    uris = [buffer.uri for buffer in document.buffers]
    uris += [image.get("uri") for image in document.images if isinstance(image, dict)]
    names = [
        name for uri in uris if isinstance(uri, str) and uri and not uri.startswith("data:") for name in _names(uri)
    ]
    return [file for name in names if (file := Path(os.path.normpath(folder / name))).is_file()]


def _names(uri: str) -> tuple[str, str]:
    # Some writers do not percent-encode special characters.
    return unquote(uri), uri


def unread(extensions: Iterable[str]) -> MeshError | None:
    """The error for data that only unsupported `extensions` provide. `None` if all of these are supported."""
    names = listed(unknown(extensions))
    return MeshError(f"stores triangles with {names}, which cannot be read; export it without") if names else None


def _embedded(uri: str) -> bytes:
    head, _, payload = uri.partition(",")
    if not head.endswith(";base64"):
        return unquote_to_bytes(payload)
    try:
        return base64.b64decode(unquote(payload))
    except ValueError as error:
        raise damaged(f"a buffer within it is not in base64 ({error})") from error
