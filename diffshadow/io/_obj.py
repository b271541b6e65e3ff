"""Wavefront OBJ files: https://paulbourke.net/dataformats/obj/."""

from collections import defaultdict

import numpy as np
from jaxtyping import Bool, Int

from .._types import HostArray
from ._errors import MeshError, damaged
from ._polygons import Polygons
from ._text import decode, excerpt, integers, read_points, split_lines

# Elements other than faces, and their names.
_OTHERS = {"p": "point", "l": "line", "curv": "free-form curve", "surf": "free-form surface"}


def read_obj(data: bytes) -> Polygons:
    """Reads the faces of all objects and groups. Materials, normals and texture coordinates are not read.

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
    words = [word for i in face_at for word in lines[i].split()[1:]]
    if "/" in text:
        words = [word.partition("/")[0] for word in words]
    try:
        corners = integers(words)
    except ValueError:
        raise _bad_face(lines, face_at) from None
    # A negative index counts back from the last vertex above the face.
    above = np.repeat(np.searchsorted(vertex_at, face_at), sizes)
    indices = np.where(corners < 0, above + corners, corners - 1)
    _check(lines, face_at, sizes, corners, (indices >= 0) & (indices < len(vertices)), len(vertices))
    return Polygons(vertices, indices, sizes, {name: len(at[key]) for key, name in _OTHERS.items()})


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
