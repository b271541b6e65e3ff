"""Wavefront OBJ files: https://paulbourke.net/dataformats/obj/."""

from collections import Counter, defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._types import HostArray
from ._errors import MeshError, damaged
from ._looks import Looks
from ._mtl import Material, Materials, files_of_materials
from ._polygons import Polygons
from ._text import decode, excerpt, integers, read_points, split_lines

# Elements other than faces, and their names.
_OTHERS = {"p": "point", "l": "line", "curv": "free-form curve", "surf": "free-form surface"}


def read_obj(data: bytes, folder: Path, with_uv: bool = False) -> Polygons:
    """Reads the faces of all objects and groups, their materials, and their texture coordinates. Normals are not read.

    **Arguments:**

    - `folder`: the file's folder, where the files of materials are looked up.
    - `with_uv`: whether to read texture coordinates where no material needs them. That takes as long as reading the
        faces.

    **Raises** `MeshError` if the file is damaged.
    """
    text = decode(data)
    lines, at = _lines(text)
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
    left_out = Counter({name: len(at[key]) for key, name in _OTHERS.items()})
    materials, used = _materials(lines, at, folder, left_out)
    is_textured = any(each.texture is not None for each in materials)
    uv = None
    if at["vt"] and (with_uv or is_textured):
        uv = _coordinates(lines, at["vt"], given, face_at, sizes)
    if uv is not None and with_uv:
        uv = uv if (uv.rows >= 0).all() else None
        # For an image that replaces the materials' images.
        materials = [Material(each.factor) for each in materials]
    looks = _looks(materials, used, uv, sizes, left_out)
    if uv is None:
        return Polygons(vertices, indices, sizes, left_out, looks=looks)
    # One vertex for each pair of position and texture coordinates. Materials may transform the coordinates.
    of_corner = np.repeat(used, sizes)
    keys, indices = np.unique(np.stack([indices, uv.rows, of_corner], axis=1), axis=0, return_inverse=True)
    scale, offset = (
        np.array([missing, *(getattr(each, name) for each in materials)])[keys[:, 2] + 1]
        for name, missing in (("scale", (1.0, 1.0)), ("offset", (0.0, 0.0)))
    )
    coordinates = np.where(keys[:, 1:2] >= 0, uv.values[keys[:, 1]] * scale + offset, 0)
    looks = (looks or Looks())._replace(uv=coordinates)
    return Polygons(vertices[keys[:, 0]], indices.reshape(-1), sizes, left_out, looks=looks)


def files_beside_obj(data: bytes, folder: Path) -> list[Path]:
    """The files of materials, and their images, that an OBJ file in `folder` refers to, if they exist."""
    if b"mtllib" not in data:
        return []
    lines, at = _lines(decode(data))
    return files_of_materials(_rests(lines, at["mtllib"]), folder)


def _lines(text: str) -> tuple[list[str], defaultdict[str, list[int]]]:
    """The lines of a file, and the indices of the lines that begin with each keyword."""
    lines = _joined(split_lines(text)) if "\\" in text else split_lines(text)
    at: defaultdict[str, list[int]] = defaultdict(list)
    for i, line in enumerate(lines):
        at[line.partition(" ")[0]].append(i)
    return lines, at


def _rests(lines: list[str], at: list[int]) -> list[str]:
    """The text after the keyword of these lines."""
    return [lines[i].partition(" ")[2].strip() for i in at]


def _materials(
    lines: list[str], at: defaultdict[str, list[int]], folder: Path, left_out: Counter[str]
) -> tuple[list[Material], Int[HostArray, " f"]]:
    """The materials of the faces, and the index of each face's material, or -1."""
    library = Materials(_rests(lines, at["mtllib"]), folder, left_out)
    names = _rests(lines, at["usemtl"])
    last = np.searchsorted(at["usemtl"], at["f"]) - 1
    found = {name: library.of(name) for name in dict.fromkeys(names[i] for i in np.unique(last[last >= 0]))}
    numbers = {name: i for i, name in enumerate(name for name, each in found.items() if each is not None)}
    # The last material is for faces above the first line usemtl.
    of_line = np.array([*(numbers.get(name, -1) for name in names), -1])
    return [each for each in found.values() if each is not None], of_line[last]


def _looks(
    materials: list[Material],
    used: Int[HostArray, " f"],
    uv: "_Coordinates | None",
    sizes: Int[HostArray, " f"],
    left_out: Counter[str],
) -> Looks | None:
    """The colours and textures of faces. `None` without materials."""
    if not materials:
        return None
    factors = np.array([*(each.factor for each in materials), Material().factor])
    textures = list(dict.fromkeys(each.texture for each in materials if each.texture is not None))
    numbers = np.array([*(-1 if each.texture is None else textures.index(each.texture) for each in materials), -1])
    texture = numbers[used]
    lacks = np.ones(len(sizes), bool)
    if uv is not None:
        lacks[:] = False
        lacks[np.repeat(np.arange(len(sizes)), sizes)[uv.rows < 0]] = True
    left_out["texture of a face without texture coordinates"] += int(np.sum(lacks & (texture >= 0)))
    return Looks(factor=factors[used], texture=np.where(lacks, -1, texture), textures=textures)


class _Coordinates(NamedTuple):
    """Texture coordinates (n, 2), and the row of each corner's coordinates (c,), or -1."""

    values: Float[HostArray, "n 2"]
    rows: Int[HostArray, " c"]


def _coordinates(
    lines: list[str], at: list[int], words: list[str], face_at: list[int], sizes: Int[HostArray, " f"]
) -> _Coordinates | None:
    """The texture coordinates. `None` if they are damaged."""
    try:
        number = integers([word.partition("/")[2].partition("/")[0] or "0" for word in words])
        values = np.array([lines[i].split()[1:3] for i in at], np.float64)
    except ValueError:
        return None
    above = np.repeat(np.searchsorted(at, face_at), sizes)
    row = np.where(number < 0, above + number, number - 1)
    is_given = number != 0
    if values.ndim != 2 or values.shape[1] != 2 or not ((row >= 0) & (row < len(values)))[is_given].all():
        return None
    return _Coordinates(values, np.where(is_given, row, -1))


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
