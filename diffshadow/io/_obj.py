"""Wavefront OBJ files: https://paulbourke.net/dataformats/obj/."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._types import HostArray
from ._errors import MeshError, damaged
from ._looks import Looks
from ._polygons import Polygons
from ._text import decode, excerpt, integers, read_points, split_lines

# Elements other than faces, and their names.
_OTHERS = {"p": "point", "l": "line", "curv": "free-form curve", "surf": "free-form surface"}


def read_obj(data: bytes, with_uv: bool = False) -> Polygons:
    """Reads the faces of all objects and groups, and their texture coordinates. Materials and normals are not read.

    **Arguments:** `with_uv`: whether to read texture coordinates, which takes as long as the faces.

    **Raises** `MeshError` if the file is damaged.
    """
    text = decode(data)
    lines = _joined(split_lines(text)) if "\\" in text else split_lines(text)
    # The lines that begin with each keyword.
    at: defaultdict[str, list[int]] = defaultdict(list)
    for i, line in enumerate(lines):
        at[line.partition(" ")[0]].append(i)
    vertex_at, face_at = at["v"], at["f"]
    vertices = read_points(lines, vertex_at, first=1)
    sizes = np.fromiter((len(lines[i].split()) - 1 for i in face_at), np.int64, len(face_at))
    given = [word for i in face_at for word in lines[i].split()[1:]]
    words = [word.partition("/")[0] for word in given] if "/" in text else given
    try:
        corners = integers(words)
    except ValueError:
        raise _bad_face(lines, face_at) from None
    # A negative index counts back from the last vertex above the face.
    above = np.repeat(np.searchsorted(vertex_at, face_at), sizes)
    indices = np.where(corners < 0, above + corners, corners - 1)
    _check(lines, face_at, sizes, corners, (indices >= 0) & (indices < len(vertices)), len(vertices))
    left_out = {name: len(at[key]) for key, name in _OTHERS.items()}
    uv = _coordinates(lines, at["vt"], given, face_at, sizes) if with_uv and at["vt"] else None
    if uv is None:
        return Polygons(vertices, indices, sizes, left_out)
    # A vertex for each pair of place and texture coordinates.
    pairs, indices = np.unique(np.stack([indices, uv.rows], axis=1), axis=0, return_inverse=True)
    vertices, uv = vertices[pairs[:, 0]], uv.values[pairs[:, 1]]
    return Polygons(vertices, indices.reshape(-1), sizes, left_out, looks=Looks(uv=uv))


class _Coordinates(NamedTuple):
    """Texture coordinates (n, 2), and the row of each corner's (c,)."""

    values: Float[HostArray, "n 2"]
    rows: Int[HostArray, " c"]


def _coordinates(
    lines: list[str], at: list[int], words: list[str], face_at: list[int], sizes: Int[HostArray, " f"]
) -> _Coordinates | None:
    """None unless all corners have texture coordinates."""
    try:
        index = integers([word.split("/")[1] for word in words])
        values = np.array([lines[i].split()[1:3] for i in at], np.float64)
    except (ValueError, IndexError):
        return None
    above = np.repeat(np.searchsorted(at, face_at), sizes)
    index = np.where(index < 0, above + index, index - 1)
    if values.ndim != 2 or values.shape[1] != 2 or not ((index >= 0) & (index < len(values))).all():
        return None
    return _Coordinates(values, index)


def _joined(lines: list[str]) -> list[str]:
    """Joins lines that end in a backslash with the next line, which becomes empty."""
    for i in range(len(lines) - 2, -1, -1):
        if lines[i].endswith("\\"):
            lines[i], lines[i + 1] = f"{lines[i][:-1]} {lines[i + 1]}", ""
    return lines


def _bad_face(lines: list[str], at: list[int]) -> MeshError:
    """The error for the first face with a corner that is not a whole number."""
    for i in at:
        words = [word.partition("/")[0] for word in lines[i].split()[1:]]
        try:
            integers(words)
        except ValueError:
            return damaged(f"line {i + 1} is {excerpt(lines[i])}; expected whole numbers of vertices")
    raise AssertionError("every face has whole numbers")


def _check(
    lines: list[str],
    at: list[int],
    sizes: Int[HostArray, " f"],
    corners: Int[HostArray, " c"],
    known: Bool[HostArray, " c"],
    count: int,
) -> None:
    if not known.all():
        corner = int(np.flatnonzero(~known)[0])
        i = at[int(np.searchsorted(np.cumsum(sizes), corner, side="right"))]
        raise damaged(f"line {i + 1}, {excerpt(lines[i])}, refers to vertex {corners[corner]}; expected 1 to {count}")
