"""STL files, binary and text: https://www.fabbers.com/tech/STL_Format."""

import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ._errors import damaged
from ._polygons import Polygons
from ._text import decode, excerpt, read_points, split_lines

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# The length of the name before the number of facets, in bytes.
_NAME = 80
# The possible keywords of a line of text.
_BLANK, _SOLID, _BEGIN, _OUTER, _VERTEX, _ENDLOOP, _ENDFACET, _UNKNOWN = range(8)
_KINDS = {"solid": _SOLID, "endsolid": _SOLID, "facet": _BEGIN, "endfacet": _ENDFACET, "endloop": _ENDLOOP}
_KINDS |= {"outer": _OUTER, "outerloop": _OUTER, "vertex": _VERTEX, "": _BLANK}
# Some writers divide the keywords that begin with `end`, or put several on one line.
_DIVIDED = re.compile(r"\bend[ \t]+(?=loop\b|facet\b|solid\b)", re.IGNORECASE)
_KEYWORD = re.compile(r"(?<!\S)(?=(?:facet|outer|vertex|endloop|endfacet|endsolid)(?!\S))", re.IGNORECASE)


def read_stl(data: bytes) -> Polygons:
    """Reads the facets of all solids; facets share no vertices. Normals are not read.

    **Raises** `MeshError` if the file is damaged.
    """
    start = _NAME + 4
    count = int.from_bytes(data[_NAME:start], "little")
    # The name in a binary file may also begin with "solid", so the length decides.
    if len(data) == start + count * _FACET.itemsize:
        corners = np.frombuffer(data, _FACET, count, start)["corners"]
        return _polygons(corners.reshape(-1, 3).astype(np.float64), np.full(count, 3))
    text = decode(data)
    if not text.lstrip().lower().startswith("solid") or "\0" in text:
        expected = f"{start + count * _FACET.itemsize} for its {count} triangles" if len(data) >= start else "a header"
        raise damaged(f"it has {len(data)} bytes; expected {expected}, or text that begins with solid")
    return _read_text(_DIVIDED.sub("end", text))


def _read_text(text: str) -> Polygons:
    lines = split_lines(text)
    numbers: Sequence[int] = range(1, len(lines) + 1)
    kinds = [_kind(line) for line in lines]
    lowered = text.lower()
    found = kinds.count(_VERTEX), kinds.count(_BEGIN) + kinds.count(_ENDFACET), kinds.count(_ENDLOOP)
    if found != tuple(lowered.count(word) for word in ("vertex", "facet", "endloop")):
        numbers, lines = zip(*_statements(lines), strict=True)
        kinds = [_kind(line) for line in lines]
    _check(lines, numbers, np.array(kinds))
    vertex_at = [i for i, kind in enumerate(kinds) if kind == _VERTEX]
    ends = np.searchsorted(vertex_at, [i for i, kind in enumerate(kinds) if kind == _ENDLOOP])
    return _polygons(read_points(lines, vertex_at, first=1, numbers=numbers), np.diff(ends, prepend=0))


def _kind(line: str) -> int:
    return _KINDS.get(line.partition(" ")[0].lower(), _UNKNOWN)


def _statements(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """The lines that begin with a keyword, without the rest of a solid's name, and their line numbers."""
    is_name = False
    for number, line in enumerate(lines, start=1):
        for part in _KEYWORD.split(line):
            kind = _kind(part)
            is_name = kind == _SOLID or (is_name and kind != _BEGIN)
            if kind == _SOLID or not is_name:
                yield number, part.strip()


def _check(lines: Sequence[str], numbers: Sequence[int], kinds: Int[HostArray, " l"]) -> None:
    """**Raises** `MeshError` for a loop that does not end, or for a line that begins with no keyword."""
    place = np.arange(len(kinds))
    latest = lambda kind: np.maximum.accumulate(np.where(kinds == kind, place, -1))
    # Names may take several lines.
    unknown = np.flatnonzero((kinds == _UNKNOWN) & (latest(_SOLID) < latest(_BEGIN)))
    filled = np.flatnonzero(kinds != _BLANK)
    follows = np.append(kinds[filled][1:], _BLANK)
    open_ended = np.append(filled[1:], -1)[(kinds[filled] == _VERTEX) & (follows != _VERTEX) & (follows != _ENDLOOP)]
    if (open_ended == -1).any():
        raise damaged(f"line {numbers[filled[-1]]} gives a vertex that no endloop follows")
    for places, expected in (
        (open_ended, "another vertex, or endloop"),
        (unknown, "a keyword, such as vertex or endloop"),
    ):
        if len(places):
            first = int(places[0])
            raise damaged(f"line {numbers[first]} is {excerpt(lines[first])}; expected {expected}")


def _polygons(vertices: Float[HostArray, "c 3"], sizes: Int[HostArray, " f"]) -> Polygons:
    return Polygons(vertices, np.arange(len(vertices)), sizes)
