"""STL files, binary and text: https://www.fabbers.com/tech/STL_Format."""

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ._errors import damaged
from ._polygons import Polygons
from ._text import decode, read_points, split_lines

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Bytes of the name, before the number of facets.
_NAME = 80


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
    lines = split_lines(text)
    words = [line[: len("endloop")].lower() for line in lines]
    vertex_at = [i for i, word in enumerate(words) if word.startswith("vertex")]
    vertices = read_points(lines, vertex_at, first=1)
    ends = np.searchsorted(vertex_at, [i for i, word in enumerate(words) if word == "endloop"])
    if len(vertices) > ends.max(initial=0):
        raise damaged(f"line {vertex_at[-1] + 1} gives a vertex that no endloop follows")
    return _polygons(vertices, np.diff(ends, prepend=0))


def _polygons(vertices: Float[HostArray, "c 3"], sizes: Int[HostArray, " f"]) -> Polygons:
    return Polygons(vertices, np.arange(len(vertices)), sizes)
