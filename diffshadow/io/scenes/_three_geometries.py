"""three.js' built-in shapes. Its files store only their parameters.

Each function has the constructor's parameters with its defaults, and returns the same vertices, normals and triangles
in the same order (three.js r187, src/geometries). Angles are in radians, lengths in the geometry's own units.
"""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from pydantic.alias_generators import to_camel

from ..._types import HostArray
from .._errors import damaged
from .._text import excerpt

# More than any shape needs. Two dimensions of this size make 17 million vertices, which fit into memory.
_MAX_SEGMENTS = 1 << 12


class Geometry(NamedTuple):
    """A shape.

    - `vertices`, `normals`: (v, 3); `normals` is `None` if it has no normals.
    - `faces`: (f, 3), indices into `vertices`.
    - `groups`: first face, number of faces and material of each part, if parts may differ in material.
    """

    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "f 3"]
    normals: Float[HostArray, "v 3"] | None
    groups: list[tuple[int, int, int]] = []  # noqa: RUF012


def plane(width: float = 1.0, height: float = 1.0, width_segments: int = 1, height_segments: int = 1) -> Geometry:
    """A rectangle in the plane z = 0 that faces +z."""
    rows, columns = _grid(height_segments, width_segments)
    x, y = columns * (width / width_segments) - width / 2, rows * (height / height_segments) - height / 2
    vertices = _stacked(x, -y, np.zeros_like(x))
    faces = _quads(_numbered(height_segments, width_segments))
    return Geometry(vertices, faces, np.broadcast_to([0.0, 0.0, 1.0], vertices.shape))


def box(
    width: float = 1.0,
    height: float = 1.0,
    depth: float = 1.0,
    width_segments: int = 1,
    height_segments: int = 1,
    depth_segments: int = 1,
) -> Geometry:
    """A box about the origin; its six sides are groups."""
    size = {"x": (width, width_segments), "y": (height, height_segments), "z": (depth, depth_segments)}
    sides = ("zyx", -1, -1, 1), ("zyx", 1, -1, -1), ("xzy", 1, 1, 1), ("xzy", 1, -1, -1), ("xyz", 1, -1, 1)
    parts = []
    for (u, v, w), u_sign, v_sign, sign in (*sides, ("xyz", -1, -1, -1)):
        (across, columns), (along, rows) = size[u], size[v]
        j, i = _grid(rows, columns)
        at = {
            u: (i * (across / columns) - across / 2) * u_sign,
            v: (j * (along / rows) - along / 2) * v_sign,
            w: np.full(i.shape, sign * size[w][0] / 2),
        }
        vertices = _stacked(at["x"], at["y"], at["z"])
        # The engine gives a depth of zero a negative sign.
        normal = np.array([w == axis for axis in "xyz"]) * (1.0 if sign * size[w][0] > 0 else -1.0)
        parts.append(Geometry(vertices, _quads(_numbered(rows, columns)), np.broadcast_to(normal, vertices.shape)))
    return _joined(parts)


def sphere(
    radius: float = 1.0,
    width_segments: int = 32,
    height_segments: int = 16,
    phi_start: float = 0.0,
    phi_length: float = 2 * np.pi,
    theta_start: float = 0.0,
    theta_length: float = np.pi,
) -> Geometry:
    """A sphere about the origin, or a part of it."""
    rows, columns = max(2, height_segments), max(3, width_segments)
    j, i = _grid(rows, columns)
    phi, theta = phi_start + i / columns * phi_length, theta_start + j / rows * theta_length
    y = radius * np.cos(theta)
    ring = np.sqrt(np.maximum(radius * radius - y * y, 0))
    vertices = _stacked(-ring * np.cos(phi), y, ring * np.sin(phi))
    end = min(theta_start + theta_length, np.pi)
    a, b, c, d = _corners(_numbered(rows, columns))
    row = np.repeat(np.arange(rows), columns)
    kept = np.stack([(row != 0) | (theta_start > 0), (row != rows - 1) | (end < np.pi)], axis=-1)
    # The engine's order of corners starts at the right one.
    return Geometry(vertices, _halved(d, a, b, c)[kept.reshape(-1)], _unit(vertices))


def cylinder(
    radius_top: float = 1.0,
    radius_bottom: float = 1.0,
    height: float = 1.0,
    radial_segments: int = 32,
    height_segments: int = 1,
    open_ended: bool = False,
    theta_start: float = 0.0,
    theta_length: float = 2 * np.pi,
) -> Geometry:
    """A cylinder, cone or frustum about the y axis; its side and its caps are groups."""
    j, i = _grid(height_segments, radial_segments)
    v, theta = j / height_segments, i / radial_segments * theta_length + theta_start
    radius = v * (radius_bottom - radius_top) + radius_top
    sine, cosine = np.sin(theta), np.cos(theta)
    vertices = _stacked(radius * sine, -v * height + height / 2, radius * cosine)
    slope = np.full(theta.shape, (radius_bottom - radius_top) / height)
    # Column after column.
    a, b, c, d = (
        part.reshape(height_segments, radial_segments).T.reshape(-1)
        for part in _corners(_numbered(height_segments, radial_segments))
    )
    row = np.tile(np.arange(height_segments), radial_segments)
    kept = np.stack([(radius_top > 0) | (row != 0), (radius_bottom > 0) | (row != height_segments - 1)], axis=-1)
    faces = _halved(a, b, c, d)[kept.reshape(-1)]
    parts, materials = [Geometry(vertices, faces, _unit(_stacked(sine, slope, cosine)))], [0]
    for sign, size in ((1.0, radius_top), (-1.0, radius_bottom)):
        if open_ended or size <= 0:
            continue
        parts.append(_cap(sign, size, height / 2, radial_segments, theta_start, theta_length))
        materials.append(1 if sign > 0 else 2)
    return _joined(parts, materials)


def _cap(sign: float, radius: float, half: float, segments: int, theta_start: float, theta_length: float) -> Geometry:
    """A cap, with a centre for each of its triangles."""
    theta = np.arange(segments + 1) / segments * theta_length + theta_start
    centres = np.tile([0.0, half * sign, 0.0], (segments, 1))
    rim = _stacked(radius * np.sin(theta), np.full(theta.shape, half * sign), radius * np.cos(theta))
    centre, i = np.arange(segments), segments + np.arange(segments)
    faces = np.stack([i, i + 1, centre] if sign > 0 else [i + 1, i, centre], axis=-1)
    vertices = np.concatenate([centres, rim])
    return Geometry(vertices, faces, np.broadcast_to([0.0, sign, 0.0], vertices.shape))


def cone(
    radius: float = 1.0,
    height: float = 1.0,
    radial_segments: int = 32,
    height_segments: int = 1,
    open_ended: bool = False,
    theta_start: float = 0.0,
    theta_length: float = 2 * np.pi,
) -> Geometry:
    """A cone about the y axis."""
    return cylinder(0.0, radius, height, radial_segments, height_segments, open_ended, theta_start, theta_length)


def circle(
    radius: float = 1.0, segments: int = 32, theta_start: float = 0.0, theta_length: float = 2 * np.pi
) -> Geometry:
    """A disk in the plane z = 0, or a sector of it."""
    segments = max(3, segments)
    theta = theta_start + np.arange(segments + 1) / segments * theta_length
    rim = _stacked(radius * np.cos(theta), radius * np.sin(theta), np.zeros_like(theta))
    i = np.arange(1, segments + 1)
    vertices = np.concatenate([np.zeros((1, 3)), rim])
    normals = np.broadcast_to([0.0, 0.0, 1.0], vertices.shape)
    return Geometry(vertices, np.stack([i, i + 1, np.zeros_like(i)], axis=-1), normals)


def ring(
    inner_radius: float = 0.5,
    outer_radius: float = 1.0,
    theta_segments: int = 32,
    phi_segments: int = 1,
    theta_start: float = 0.0,
    theta_length: float = 2 * np.pi,
) -> Geometry:
    """A ring in the plane z = 0."""
    rows, columns = max(1, phi_segments), max(3, theta_segments)
    j, i = _grid(rows, columns)
    theta = theta_start + i / columns * theta_length
    radius = inner_radius + j * ((outer_radius - inner_radius) / rows)
    vertices = _stacked(radius * np.cos(theta), radius * np.sin(theta), np.zeros_like(theta))
    normals = np.broadcast_to([0.0, 0.0, 1.0], vertices.shape)
    return Geometry(vertices, _quads(_numbered(rows, columns)), normals)


def torus(
    radius: float = 1.0,
    tube: float = 0.4,
    radial_segments: int = 12,
    tubular_segments: int = 48,
    arc: float = 2 * np.pi,
    theta_start: float = 0.0,
    theta_length: float = 2 * np.pi,
) -> Geometry:
    """A torus about the z axis."""
    j, i = _grid(radial_segments, tubular_segments)
    v, u = theta_start + j / radial_segments * theta_length, i / tubular_segments * arc
    centre = _stacked(radius * np.cos(u), radius * np.sin(u), np.zeros_like(u))
    reach = radius + tube * np.cos(v)
    vertices = _stacked(reach * np.cos(u), reach * np.sin(u), tube * np.sin(v))
    # The engine counts rows from the far side of each quad.
    a, b, c, d = _corners(_numbered(radial_segments, tubular_segments))
    return Geometry(vertices, _halved(b, a, d, c), _unit(vertices - centre))


def torus_knot(
    radius: float = 1.0,
    tube: float = 0.4,
    tubular_segments: int = 64,
    radial_segments: int = 8,
    p: float = 2,
    q: float = 3,
) -> Geometry:
    """A (p, q) torus knot."""

    def curve(u: Float[HostArray, " v"]) -> Float[HostArray, "v 3"]:
        turn = q / p * u
        reach = radius * (2 + np.cos(turn)) * 0.5
        return _stacked(reach * np.cos(u), reach * np.sin(u), radius * np.sin(turn) * 0.5)

    i, j = _grid(tubular_segments, radial_segments)
    u, v = i / tubular_segments * p * np.pi * 2, (j / radial_segments * np.pi * 2)[..., None]
    # The engine's frame comes from a point and a point slightly farther along.
    here, ahead = curve(u), curve(u + 0.01)
    along = ahead - here
    binormal = np.cross(along, ahead + here)
    normal, binormal = _unit(np.cross(binormal, along)), _unit(binormal)
    offset = -tube * np.cos(v) * normal + tube * np.sin(v) * binormal
    return Geometry(here + offset, _quads(_numbered(tubular_segments, radial_segments)), _unit(offset))


def capsule(
    radius: float = 1.0, height: float = 1.0, cap_segments: int = 4, radial_segments: int = 8, height_segments: int = 1
) -> Geometry:
    """A capsule along the y axis."""
    height, caps = max(0.0, height), max(1, cap_segments)
    columns, middle = max(3, radial_segments), max(1, height_segments)
    angle = np.arange(caps + 1) / caps * np.pi / 2
    share = np.arange(1, middle + 1) / middle
    sine, cosine = np.sin(angle), np.cos(angle)
    y = np.concatenate([-height / 2 - radius * cosine, -height / 2 + share * height, height / 2 + radius * sine[1:]])
    rise = np.concatenate([-radius * cosine, np.zeros(middle), radius * sine[1:]])
    reach = np.concatenate([radius * sine, np.full(middle, float(radius)), radius * cosine[1:]])
    j, i = _grid(2 * caps + middle, columns)
    j, theta = j.astype(int), i / columns * np.pi * 2
    x, z = -reach[j] * np.cos(theta), reach[j] * np.sin(theta)
    a, b, c, d = _corners(_numbered(2 * caps + middle, columns))
    return Geometry(_stacked(x, y[j], z), _halved(a, d, c, b), _unit(_stacked(x, rise[j], z)))


def lathe(
    points: Sequence[Mapping[str, float]] = ({"x": 0, "y": -0.5}, {"x": 0.5, "y": 0}, {"x": 0, "y": 0.5}),
    segments: int = 12,
    phi_start: float = 0.0,
    phi_length: float = 2 * np.pi,
) -> Geometry:
    """A line rotated about the y axis."""
    line = np.array([[point["x"], point["y"]] for point in points], float)
    step = np.diff(line, axis=0)
    across = np.stack([step[:, 1], -step[:, 0]], axis=-1)
    # The sum of the normals of both segments at each point.
    rims = _unit(np.concatenate([across[:1], across[1:] + across[:-1], across[-1:]]))
    i, j = _grid(segments, len(line) - 1)
    j, phi = j.astype(int), phi_start + i / segments * np.clip(phi_length, 0, 2 * np.pi)
    sine, cosine = np.sin(phi), np.cos(phi)
    turned = lambda flat: _stacked(flat[j, 0] * sine, flat[j, 1], flat[j, 0] * cosine)
    a, b, c, d = _corners(_numbered(segments, len(line) - 1))
    faces = np.stack([np.stack([a, b, d], axis=-1), np.stack([c, d, b], axis=-1)], axis=1).reshape(-1, 3)
    return Geometry(turned(line), faces, turned(rims))


def polyhedron(
    vertices: Sequence[float] = (), indices: Sequence[int] = (), radius: float = 1.0, detail: int = 0
) -> Geometry:
    """A polyhedron of triangles. Each is divided into (detail + 1)² triangles and projected onto a sphere."""
    corners = np.asarray(vertices, float).reshape(-1, 3)[np.asarray(indices, int).reshape(-1, 3)]
    count = detail + 1
    # The points of each triangle, in rows from its first side to its third corner, and the triangles between them.
    places = [(i, j) for i in range(count + 1) for j in range(count + 1 - i)]
    number = {place: k for k, place in enumerate(places)}
    small = [
        [number[i, k + 1], number[i + 1, k], number[i, k]]
        if j % 2 == 0
        else [number[i, k + 1], number[i + 1, k + 1], number[i + 1, k]]
        for i in range(count)
        for j in range(2 * (count - i) - 1)
        for k in [j // 2]
    ]
    i, j = np.array(places, float).T[..., None]
    a, b, c = (corners[:, None, k] for k in range(3))
    left, right = a + (c - a) * (i / count), b + (c - b) * (i / count)
    inside = left + (right - left) * (j / np.maximum(count - i, 1))
    soup = _unit(inside[:, small].reshape(-1, 3)) * radius
    faces = np.arange(len(soup)).reshape(-1, 3)
    if detail:
        return Geometry(soup, faces, _unit(soup))
    # The vertices have single precision, as in the engine.
    p, q, r = np.moveaxis(soup.astype(np.float32).astype(float)[faces], 1, 0)
    return Geometry(soup, faces, np.repeat(_unit(np.cross(r - q, p - q)), 3, axis=0))


_GOLDEN = (1 + 5**0.5) / 2
_R, _T = 1 / _GOLDEN, _GOLDEN
_TETRAHEDRON = ([1, 1, 1, -1, -1, 1, -1, 1, -1, 1, -1, -1], [2, 1, 0, 0, 3, 2, 1, 3, 0, 2, 3, 1])
_OCTAHEDRON = (
    [1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1],
    [0, 2, 4, 0, 4, 3, 0, 3, 5, 0, 5, 2, 1, 2, 5, 1, 5, 3, 1, 3, 4, 1, 4, 2],
)
_ICOSAHEDRON = (
    [
        *(-1, _T, 0, 1, _T, 0, -1, -_T, 0, 1, -_T, 0, 0, -1, _T, 0, 1, _T, 0, -1, -_T, 0, 1, -_T),
        *(_T, 0, -1, _T, 0, 1, -_T, 0, -1, -_T, 0, 1),
    ],
    [
        *(0, 11, 5, 0, 5, 1, 0, 1, 7, 0, 7, 10, 0, 10, 11, 1, 5, 9, 5, 11, 4, 11, 10, 2, 10, 7, 6, 7, 1, 8),
        *(3, 9, 4, 3, 4, 2, 3, 2, 6, 3, 6, 8, 3, 8, 9, 4, 9, 5, 2, 4, 11, 6, 2, 10, 8, 6, 7, 9, 8, 1),
    ],
)
_DODECAHEDRON = (
    [
        *(-1, -1, -1, -1, -1, 1, -1, 1, -1, -1, 1, 1, 1, -1, -1, 1, -1, 1, 1, 1, -1, 1, 1, 1),
        *(0, -_R, -_T, 0, -_R, _T, 0, _R, -_T, 0, _R, _T, -_R, -_T, 0, -_R, _T, 0, _R, -_T, 0, _R, _T, 0),
        *(-_T, 0, -_R, _T, 0, -_R, -_T, 0, _R, _T, 0, _R),
    ],
    [
        *(3, 11, 7, 3, 7, 15, 3, 15, 13, 7, 19, 17, 7, 17, 6, 7, 6, 15, 17, 4, 8, 17, 8, 10, 17, 10, 6),
        *(8, 0, 16, 8, 16, 2, 8, 2, 10, 0, 12, 1, 0, 1, 18, 0, 18, 16, 6, 10, 2, 6, 2, 13, 6, 13, 15),
        *(2, 16, 18, 2, 18, 3, 2, 3, 13, 18, 1, 9, 18, 9, 11, 18, 11, 3, 4, 14, 12, 4, 12, 0, 4, 0, 8),
        *(11, 9, 5, 11, 5, 19, 11, 19, 7, 19, 5, 14, 19, 14, 4, 19, 4, 17, 1, 12, 14, 1, 14, 5, 1, 5, 9),
    ],
)


def _solid(shape: tuple[Sequence[float], Sequence[int]]) -> Callable[..., Geometry]:
    def solid(radius: float = 1.0, detail: int = 0) -> Geometry:
        return polyhedron(*shape, radius, detail)

    return solid


GEOMETRIES: Mapping[str, Callable[..., Geometry]] = {
    "BoxGeometry": box,
    "CapsuleGeometry": capsule,
    "CircleGeometry": circle,
    "ConeGeometry": cone,
    "CylinderGeometry": cylinder,
    "DodecahedronGeometry": _solid(_DODECAHEDRON),
    "IcosahedronGeometry": _solid(_ICOSAHEDRON),
    "LatheGeometry": lathe,
    "OctahedronGeometry": _solid(_OCTAHEDRON),
    "PlaneGeometry": plane,
    "PolyhedronGeometry": polyhedron,
    "RingGeometry": ring,
    "SphereGeometry": sphere,
    "TetrahedronGeometry": _solid(_TETRAHEDRON),
    "TorusGeometry": torus,
    "TorusKnotGeometry": torus_knot,
}
"""The shapes by the names of their classes."""


def build_geometry(kind: str, parameters: Mapping[str, Any]) -> Geometry:
    """The shape of the class `kind`, a key of `GEOMETRIES`, with the `parameters` of the file.

    **Raises** `MeshError` for a parameter that is not a finite number, for no segments, or for more segments than fit
    into memory.
    """
    build = GEOMETRIES[kind]
    known: dict[str, Any] = {}
    for name in inspect.signature(build).parameters:
        key = to_camel(name)
        value = parameters.get(key)
        if value is None:
            continue
        if name.endswith("segments") or name == "detail":
            value = _whole(kind, key, value, least=0 if name == "detail" else 1)
        elif not isinstance(value, list) and not (isinstance(value, int | float) and math.isfinite(value)):
            raise damaged(f"its {kind} has {key} = {_shown(value)}; expected a finite number")
        known[name] = value
    try:
        return build(**known)
    except (ValueError, IndexError, KeyError, TypeError) as error:
        raise damaged(f"the parameters of its {kind} do not make a shape ({error})") from error


def _whole(kind: str, key: str, value: Any, least: int) -> int:
    if not (isinstance(value, int | float) and least <= value <= _MAX_SEGMENTS):
        raise damaged(f"its {kind} has {key} = {_shown(value)}; expected a number from {least} to {_MAX_SEGMENTS}")
    return int(value)


def _shown(value: Any) -> str:
    return str(value) if isinstance(value, int | float) else excerpt(str(value))


def _grid(rows: int, columns: int) -> tuple[Float[HostArray, " v"], Float[HostArray, " v"]]:
    """Row and column of each of (rows + 1) (columns + 1) vertices."""
    return np.repeat(np.arange(rows + 1.0), columns + 1), np.tile(np.arange(columns + 1.0), rows + 1)


def _numbered(rows: int, columns: int) -> Int[HostArray, "r c"]:
    return np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)


def _corners(number: Int[HostArray, "r c"]) -> tuple[Int[HostArray, " q"], ...]:
    """Each quad's corners, in order around it: (row, column), (row + 1, column), (row + 1, column + 1), (row, column +
    1)."""
    parts = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return tuple(part.reshape(-1) for part in parts)


def _quads(number: Int[HostArray, "r c"]) -> Int[HostArray, "f 3"]:
    return _halved(*_corners(number))


def _halved(
    a: Int[HostArray, " q"], b: Int[HostArray, " q"], c: Int[HostArray, " q"], d: Int[HostArray, " q"]
) -> Int[HostArray, "f 3"]:
    """Both triangles of each quad, as three.js cuts most of its shapes."""
    return np.stack([np.stack([a, b, d], axis=-1), np.stack([b, c, d], axis=-1)], axis=1).reshape(-1, 3)


def _joined(parts: list[Geometry], materials: Sequence[int] | None = None) -> Geometry:
    """All parts as groups."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    first = np.cumsum([0, *(len(part.faces) for part in parts)])
    numbers = range(len(parts)) if materials is None else materials
    return Geometry(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.normals for part in parts if part.normals is not None]),
        [(int(at), len(part.faces), number) for at, part, number in zip(first, parts, numbers, strict=False)],
    )


def _stacked(x: Any, y: Any, z: Any) -> Float[HostArray, "v 3"]:
    return np.stack([x, y, z], axis=-1)


def _unit(vectors: Float[HostArray, "*n 3"]) -> Float[HostArray, "*n 3"]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
