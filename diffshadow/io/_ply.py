"""PLY files, whose elements plyfile reads."""

import contextlib
import io
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from plyfile import PlyData, PlyElement, PlyParseError

from .._types import HostArray
from ._errors import damaged
from ._polygons import Polygons, strip_triangles

# The names that writers give to a face's corners.
_CORNERS = ("vertex_indices", "vertex_index")
# A line of the header that begins with none of its words.
_COMMENT = re.compile(rb"([\r\n])(?!ply|format|comment|obj_info|element|property|[\r\n]|$)[^\r\n]*([\r\n])")


def read_ply(file: Path) -> Polygons:
    """The faces, and the triangles of strips.

    **Raises** `MeshError` if the file is damaged.
    """
    try:
        elements = {element.name: element for element in _parse(file)}
    except (PlyParseError, UnicodeDecodeError) as error:
        raise damaged(str(error)) from error
    corners, sizes = _lists(elements.get("face"))
    strips = _strips(*_lists(elements.get("tristrips")))
    return Polygons(
        _vertices(elements.get("vertex")),
        np.concatenate([corners, strips.reshape(-1)]),
        np.concatenate([sizes, np.full(len(strips), 3)]),
        {"edge": len(elements["edge"])} if "edge" in elements else {},
    )


def _parse(file: Path) -> PlyData:
    data = file.read_bytes()
    end = max(data.find(b"end_header"), 0)
    header = data[:end]
    if b"format binary" in header:
        name = next((name for name in _CORNERS if name.encode() in header), "")
        # Fast where every face is a triangle: plyfile reads lists of any length one by one.
        with contextlib.suppress(PlyParseError, UnicodeDecodeError):
            return PlyData.read(str(file), known_list_len={"face": {name: 3}})
    # Comments may be of any encoding, and some writers forget to begin them as comments.
    header = _COMMENT.sub(rb"\1comment\2", re.sub(rb"[\x80-\xff]", b"?", header))
    return PlyData.read(io.BytesIO(header + data[end:]))


def _vertices(element: PlyElement | None) -> Float[HostArray, "v 3"]:
    if element is None:
        return np.zeros((0, 3))
    names = element.data.dtype.names or ()
    if not set("xyz") <= set(names):
        raise damaged(f"its vertices have {', '.join(names)}; expected x, y and z")
    return np.stack([element[name] for name in "xyz"], axis=-1).astype(np.float64)


def _lists(element: PlyElement | None) -> tuple[Int[HostArray, "c"], Int[HostArray, "f"]]:
    """The indices that the rows of `element` list, one row after another, and how many each lists."""
    if element is None or len(element) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    names = element.data.dtype.names or ()
    name = next((name for name in _CORNERS if name in names), None)
    if name is None:
        raise damaged(f"its {element.name} elements have {', '.join(names)}; expected {_CORNERS[0]}")
    rows = element[name]
    return np.concatenate(list(rows)).astype(np.int64), np.fromiter(map(len, rows), np.int64, len(rows))


def _strips(corners: Int[HostArray, "c"], sizes: Int[HostArray, "n"]) -> Int[HostArray, "t 3"]:
    """The triangles of lists of strips, which -1 sets apart."""
    triangles = [np.zeros((0, 3), np.int64)]
    for row in np.split(corners, np.cumsum(sizes)):
        triangles += [strip_triangles(part[part >= 0]) for part in np.split(row, np.flatnonzero(row < 0))]
    return np.concatenate(triangles)
