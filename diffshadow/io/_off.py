"""OFF files: http://www.geomview.org/docs/html/OFF.html."""

import re

import numpy as np

from ._errors import MeshError, damaged
from ._polygons import Polygons
from ._text import decode, excerpt, integers, read_points, split_lines

# Texture coordinates, colours and normals follow a vertex's position and are not read. The keyword may be missing, and
# some files of ModelNet lack the space after it.
_HEADER = re.compile(r"(?:(?:ST)?C?N?(4?)(n?)OFF(?![A-Za-z])|(?=\d))\s*(BINARY\b)?\s*(.*)", re.DOTALL)


def read_off(data: bytes) -> Polygons:
    """Reads the faces. **Raises** `MeshError` if the file is damaged, binary, or not three-dimensional."""
    lines = split_lines(decode(data))
    filled = [i for i, line in enumerate(lines) if line]
    header = _HEADER.match(lines[filled[0]]) if filled else None
    if header is None:
        raise damaged(f"it begins with {excerpt(lines[filled[0]] if filled else '')}; expected OFF")
    four, other, binary, rest = header.groups()
    if binary:
        raise MeshError("is a binary OFF file, which cannot be read; export it as text, or as PLY")
    if four or other:
        raise MeshError("has vertices that are not three-dimensional; export it in three dimensions")
    # The counts may be on the header's line.
    body = filled[0 if rest else 1 :]
    if rest:
        lines[body[0]] = rest
    vertex_count, face_count = _counts(lines[body[0]] if body else "")
    if len(body) != 1 + vertex_count + face_count:
        raise damaged(
            f"its header announces {vertex_count} vertices and {face_count} faces, but {len(body) - 1} lines follow; "
            "expected one for each"
        )
    vertex_at, face_at = body[1 : 1 + vertex_count], body[1 + vertex_count :]
    vertices = read_points(lines, vertex_at, first=0)
    # Colours may follow the corners.
    try:
        sizes = integers([lines[i].split(None, 1)[0] for i in face_at])
        known = np.fromiter((len(lines[i].split()) - 1 for i in face_at), np.int64, face_count)
        if ((sizes < 0) | (sizes > known)).any():
            raise ValueError
        counted = zip(face_at, sizes.tolist(), strict=True)
        corners = integers([word for i, size in counted for word in lines[i].split()[1 : size + 1]])
    except ValueError:
        raise _bad_face(lines, face_at) from None
    return Polygons(vertices, corners, sizes)


def _counts(line: str) -> tuple[int, int]:
    words = line.split()[:2]
    if len(words) < 2 or not all(word.isascii() and word.isdigit() for word in words):
        raise damaged(f"its header is followed by {excerpt(line)}; expected the numbers of vertices and faces")
    return int(words[0]), int(words[1])


def _bad_face(lines: list[str], at: list[int]) -> MeshError:
    """The error for the first face that is not a number of corners followed by that many vertex indices."""
    for i in at:
        words = lines[i].split()
        try:
            size = int(words[0])
            good = 0 <= size < len(words) and len(integers(words[1 : size + 1])) == size
        except ValueError:
            good = False
        if not good:
            return damaged(f"line {i + 1} is {excerpt(lines[i])}; expected a count and that many vertices")
    raise AssertionError("every face is good")
