"""PLY files: https://paulbourke.net/dataformats/ply/."""

import codecs
import os
import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ._atomic import atomic_path
from ._errors import MeshError, damaged
from ._looks import Looks
from ._polygons import Polygons, strip_triangles
from ._text import decode, excerpt, is_number, listed, parsed

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float": "f4",
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
}
_Order = Literal["=", "<", ">"]
_ORDERS: Mapping[str, _Order] = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
# Common names for the list of a face's corners.
_CORNERS = ("vertex_indices", "vertex_index")
_NORMAL = ("nx", "ny", "nz")
_COLOUR, _ALPHA = ("red", "green", "blue"), ("alpha",)
# Common names for texture coordinates. The first names are written.
_COORDINATES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
# Every float64 from here on is a whole number.
_LONGEST = 2.0**53
_DIGITS = 15


class _Property(NamedTuple):
    name: str
    type: np.dtype
    # The type of a list's length.
    length: np.dtype | None


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


class _Column(NamedTuple):
    """The values of a property, row after row, and the number of values in each row."""

    values: HostArray
    sizes: Int[HostArray, " n"]


# The values of each element, by its name.
_Columns = Mapping[str, Mapping[str, _Column]]


class _Header(NamedTuple):
    """The elements of a file. `starts` are the possible start positions of its data, with the likeliest first."""

    order: _Order
    elements: list[_Element]
    starts: list[int]


def read_ply(data: bytes) -> Polygons:
    """Reads the faces, and the triangles of strips.

    **Raises** `MeshError` if the file is damaged, or longer than its header announces.
    """
    if data.startswith(codecs.BOM_UTF8):
        data = data[len(codecs.BOM_UTF8) :]
    if not data.startswith(b"ply"):
        data = decode(data).encode("latin-1", errors="replace")
    header = _header(data)
    columns, left_out = _text(data, header) if header.order == "=" else (_binary(data, header), 0)
    corners, sizes = _lists(columns, "face")
    strips = _strips(*_lists(columns, "tristrips"))
    edges = sum(element.rows for element in header.elements if element.name == "edge")
    vertex = columns.get("vertex", {})
    own = (element.properties for element in header.elements if element.name == "vertex")
    types = {each.name: each.type for properties in own for each in properties}
    return Polygons(
        _vertices(vertex),
        np.concatenate([corners, strips.reshape(-1)]),
        np.concatenate([sizes, np.full(len(strips), 3)]),
        {"edge": edges, "number of no property in its header": left_out},
        _points(vertex, _NORMAL)
        if all(name in vertex and (vertex[name].sizes == 1).all() for name in _NORMAL)
        else None,
        looks=_looks(vertex, types),
    )


def _looks(vertex: Mapping[str, _Column], types: Mapping[str, np.dtype]) -> Looks | None:
    """Colours and alpha of vertices, stored from 0 to 1 or as fractions of their integer type's maximum, and texture
    coordinates."""
    has = lambda names: all(name in vertex and (vertex[name].sizes == 1).all() for name in names)
    greatest = lambda kind: np.iinfo(kind).max if kind.kind in "iu" else 1
    parts = lambda names: _points(vertex, names) / [greatest(types[name]) for name in names] if has(names) else None
    colours, alpha = parts(_COLOUR), parts(_ALPHA)
    uv = next((_points(vertex, names) for names in _COORDINATES if has(names)), None)
    if colours is None and uv is None and alpha is None:
        return None
    return Looks(colours, uv, alpha=None if alpha is None else alpha[:, 0])


def _header(data: bytes) -> _Header:
    """**Raises** `MeshError` if the header is damaged. Its lines may end in different ways."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if first is None:
        raise damaged(f"it begins with {excerpt(data[:80].decode('latin-1'))}; expected a line that says ply")
    last = re.search(rb"[\r\n][ \t]*end_header[ \t]*(?:(\r\n|\n|\r)|\Z)", data)
    if last is None:
        raise damaged("its header has no end_header")
    starts = [last.end()]
    if last[1] == b"\n" and data[last.end() : last.end() + 1] == b"\r":
        starts.append(last.end() + 1)
    if last[1] == b"\r\n":
        # The last byte belongs to the data if other lines end in the first alone.
        starts.insert(0 if first[1] == b"\r" else 1, last.end() - 1)
    order, elements = _elements(re.split(rb"\r\n|\n|\r", data[first.end() : last.start()]))
    return _Header(order, elements, starts)


def _elements(lines: Sequence[bytes]) -> tuple[_Order, list[_Element]]:
    """The byte order and the elements, from the header's lines between the first and the last."""
    elements: list[_Element] = []
    order: _Order | None = None
    for number, data in enumerate(lines, start=2):
        # Comments may be in any encoding, and some writers omit the `comment` keyword.
        line = data.decode("latin-1")
        try:
            match line.split():
                case ["format", form, *_]:
                    order = _ORDERS[form]
                case ["element", name, rows] if rows.isascii() and rows.isdigit():
                    if any(element.name == name for element in elements):
                        raise KeyError
                    elements.append(_Element(name, int(rows), []))
                case ["property", "list", length, kind, name] if order is not None:
                    types = [np.dtype(_TYPES[each]).newbyteorder(order) for each in (kind, length)]
                    elements[-1].properties.append(_Property(name, *types))
                case ["property", kind, name] if order is not None:
                    elements[-1].properties.append(_Property(name, np.dtype(_TYPES[kind]).newbyteorder(order), None))
                case ["format" | "element" | "property", *_]:
                    raise KeyError
        except (KeyError, IndexError, ValueError):
            raise damaged(f"line {number} of its header is {excerpt(line)}, which cannot be read") from None
    if order is None:
        raise damaged(f"its header has no format line; expected one of {', '.join(_ORDERS)}")
    return order, elements


def _binary(data: bytes, header: _Header) -> _Columns:
    """The columns of each element. **Raises** `MeshError` if they do not fill the file."""
    faults: list[MeshError] = []
    for start in header.starts:
        try:
            columns, end = _read_all(data, start, header.elements)
            # Some writers pad the last block of bytes.
            left = len(data[end:].strip(b"\0 \t\r\n"))
            if not left:
                return columns
            faults.append(_too_long(f"{left} bytes"))
        except MeshError as fault:
            faults.append(fault)
    raise faults[0]


def _text(data: bytes, header: _Header) -> tuple[_Columns, int]:
    """The columns of each element, and the number of words that belong to no property of the header.

    **Raises** `MeshError` for words that are not numbers, and if there are more or fewer than the header announces.
    """
    body = data[header.starts[0] :]
    elements = [element._replace(properties=_in_doubles(element.properties)) for element in header.elements]
    words = body.split()
    try:
        content = _as_binary(words)
        columns, end = _read_all(content, 0, elements)
        if end == len(content):
            return columns, 0
        fault = _too_long(f"{(len(content) - end) // np.dtype(np.float64).itemsize} numbers")
    except MeshError as error:
        fault = error
    announced = _announced(body, elements)
    if announced is None:
        raise fault
    return _read_all(_as_binary(announced), 0, elements)[0], len(words) - len(announced)


def _announced(body: bytes, elements: Sequence[_Element]) -> list[bytes] | None:
    """The words of the announced properties, if each row has its own line. A line may end with further columns.

    `None` if the lines are not such rows.
    """
    lines = [line.split() for line in body.splitlines() if line.strip()]
    filled = [element for element in elements if element.properties]
    if sum(element.rows for element in filled) != len(lines):
        return None
    rows = [element.properties for element in filled for _ in range(element.rows)]
    announced: list[bytes] = []
    for line, properties in zip(lines, rows, strict=True):
        count = 0
        for each in properties:
            size = line[count : count + 1]
            if each.length is not None and not (size and size[0].isdigit() and len(size[0]) <= _DIGITS):
                return None
            count += 1 + (0 if each.length is None else int(size[0]))
        if count > len(line):
            return None
        announced += line[:count]
    return announced


def _as_binary(words: Sequence[bytes]) -> bytes:
    """The numbers of a text file as float64, so that the same code reads text and binary files."""
    try:
        return parsed(words).tobytes()
    except ValueError:
        word = next(word for word in words if not is_number(word))
        raise damaged(f"it has {excerpt(word.decode('latin-1'))} below its header; expected numbers") from None


def _read_all(data: bytes, start: int, elements: Sequence[_Element]) -> tuple[_Columns, int]:
    """The columns of each element, and the end of the last."""
    columns: dict[str, Mapping[str, _Column]] = {}
    for element in elements:
        columns[element.name], start = _read(data, start, element)
    return columns, start


def _in_doubles(properties: Sequence[_Property]) -> list[_Property]:
    double = np.dtype(np.float64)
    return [p._replace(type=double, length=None if p.length is None else double) for p in properties]


def _read(data: bytes, start: int, element: _Element) -> tuple[Mapping[str, _Column], int]:
    """The element's columns, and the offset of the next element."""
    if element.rows == 0 or not element.properties:
        return {}, start
    # Every row takes at least one byte.
    if element.rows > len(data) - start:
        raise _too_short(element)
    return _read_alike(data, start, element) or _read_rows(data, start, element)


def _read_alike(data: bytes, start: int, element: _Element) -> tuple[Mapping[str, _Column], int] | None:
    """`_read` for elements whose lists have the same length in every row. `None` if they do not."""
    fields, lengths, at = [], [], start
    for i, p in enumerate(element.properties):
        lengths.append(1 if p.length is None else _length(data, at, p.length, element))
        if p.length is not None:
            fields.append((f"length {i}", p.length))
            at += p.length.itemsize
        at += lengths[i] * p.type.itemsize
        if at > len(data):
            raise _too_short(element)
        fields.append((f"values {i}", p.type, (lengths[i],)))
    row = np.dtype(fields)
    if element.rows * row.itemsize > len(data) - start:
        return None
    rows = np.frombuffer(data, row, element.rows, start)
    for i, p in enumerate(element.properties):
        if p.length is not None and (rows[f"length {i}"] != lengths[i]).any():
            return None
    columns = {
        p.name: _Column(rows[f"values {i}"].reshape(-1), np.full(element.rows, lengths[i]))
        for i, p in enumerate(element.properties)
    }
    return columns, start + element.rows * row.itemsize


def _read_rows(data: bytes, start: int, element: _Element) -> tuple[Mapping[str, _Column], int]:
    """`_read`, row by row."""
    places: dict[str, list[int]] = {p.name: [] for p in element.properties}
    sizes: dict[str, list[int]] = {p.name: [] for p in element.properties}
    at = start
    for _ in range(element.rows):
        for name, kind, length in element.properties:
            size = 1
            if length is not None:
                size = _length(data, at, length, element)
                at += length.itemsize
            places[name].append(at)
            sizes[name].append(size)
            at += size * kind.itemsize
        if at > len(data):
            raise _too_short(element)
    columns = {}
    for name, kind, _ in element.properties:
        rows = [np.frombuffer(data, kind, n, i) for i, n in zip(places[name], sizes[name], strict=True)]
        columns[name] = _Column(np.concatenate(rows), np.asarray(sizes[name]))
    return columns, at


def _length(data: bytes, at: int, kind: np.dtype, element: _Element) -> int:
    if at + kind.itemsize > len(data):
        raise _too_short(element)
    order = kind.byteorder if kind.byteorder in "<>" else "="
    (length,) = struct.unpack_from(order + kind.char, data, at)
    if not 0 <= length < _LONGEST or length != int(length):
        raise damaged(f"one of its {listed([element.name])} elements has a list of length {length:g}")
    return int(length)


def _too_short(element: _Element) -> MeshError:
    return damaged(
        f"it ends before the last of the {element.rows} {listed([element.name])} elements that its header announces"
    )


def _too_long(left: str) -> MeshError:
    return damaged(f"{left} are left below the last row that its header announces; expected none")


def _vertices(columns: Mapping[str, _Column]) -> Float[HostArray, "v 3"]:
    if not columns:
        return np.zeros((0, 3))
    if any(name not in columns or (columns[name].sizes != 1).any() for name in "xyz"):
        raise damaged(f"its vertices have {listed(columns)}; expected x, y and z")
    return _points(columns, "xyz")


def _points(columns: Mapping[str, _Column], names: Iterable[str]) -> Float[HostArray, "v 3"]:
    return np.stack([columns[name].values for name in names], axis=-1).astype(np.float64)


def _lists(columns: _Columns, element: str) -> tuple[Int[HostArray, " c"], Int[HostArray, " f"]]:
    """The vertex indices listed by the rows of `element`, and the number of them in each row."""
    if not columns.get(element):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    found = [columns[element][name] for name in _CORNERS if name in columns[element]]
    if not found:
        raise damaged(f"its {element} elements have {listed(columns[element])}; expected {_CORNERS[0]}")
    values, sizes = found[0]
    if (values.dtype.kind == "f" and not (np.abs(values) < _LONGEST).all()) or (values != np.trunc(values)).any():
        raise damaged(f"its {element} elements have vertex indices that are not whole numbers")
    return values.astype(np.int64), sizes.astype(np.int64)


def _strips(corners: Int[HostArray, " c"], sizes: Int[HostArray, " n"]) -> Int[HostArray, "t 3"]:
    """The triangles of lists of strips; -1 separates the strips of one list."""
    triangles = [np.zeros((0, 3), np.int64)]
    for strips in np.split(corners, np.cumsum(sizes)):
        for strip in np.split(strips, np.flatnonzero(strips == -1)):
            triangles.append(strip_triangles(strip[strip != -1]))
    return np.concatenate(triangles)


def write_ply(
    path: str | os.PathLike[str],
    vertices: Float[HostArray, "v 3"],
    faces: Int[HostArray, "f 3"],
    normals: Float[HostArray, "v 3"] | None = None,
    colours: Float[HostArray, "v 3"] | None = None,
    uv: Float[HostArray, "v 2"] | None = None,
    alpha: Float[HostArray, " v"] | None = None,
) -> None:
    """Writes triangles as a binary PLY file in single precision.

    **Arguments:**

    - `vertices`, `normals`: (v, 3); `faces`: (f, 3), indices into `vertices`.
    - `colours`: (v, 3), linear, in [0, 1]; `uv`: (v, 2), texture coordinates, (0, 0) at an image's lower left corner.
    - `alpha`: (v,), in [0, 1].

    **Raises** `FileError` if the file cannot be written.
    """
    opacity = None if alpha is None else np.asarray(alpha)[:, None]
    given = (
        *((tuple("xyz"), vertices), (_NORMAL, normals)),
        *((_COLOUR, colours), (_ALPHA, opacity), (_COORDINATES[0], uv)),
    )
    columns = [values for _, values in given if values is not None]
    names = [name for each, values in given if values is not None for name in each]
    rows = np.concatenate(columns, axis=1).astype("<f4")
    triangles = np.zeros(len(faces), np.dtype([("length", "u1"), ("corners", "<i4", 3)]))
    triangles["length"], triangles["corners"] = 3, faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(rows)}",
        *(f"property float {name}" for name in names),
        f"element face {len(faces)}",
        f"property list uchar int {_CORNERS[0]}",
        "end_header",
        "",
    ]
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + rows.tobytes() + triangles.tobytes())
