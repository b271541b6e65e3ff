"""Procedural meshes by name, for scenes that need no file.

Every piece is about one world unit in size and is placed on the ground at the origin. Its lowest point is at y = 0, and
its bounding box is centred in x and z. All but `plane` are closed two-manifolds. All faces are anticlockwise seen from
outside.
"""

import difflib
import inspect
import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from .._words import counted
from ..settings.scene import PIECES
from ._mesh import Mesh
from ._normals import crease_normals
from ._subdivide import split_in_four

Number = float | int

_SMOOTH, _SHARP = 180.0, 30.0
# Normals are cross products of edges, so their squared lengths grow with the fourth power of size. Within these sizes,
# they fit single precision.
_MIN_SIZE, _MAX_SIZE = 1e-6, 1e9
# Two million triangles, about 200 MB.
_MAX_QUADS = 1 << 20
_MAX_SUBDIVISIONS = 8
_MAX_SLATS = 10_000
# A chair with this many spindles of this many sides has half a million triangles.
_MAX_SPINDLES, _MAX_CHAIR_SIDES = 100, 256
# (right or left, front or back), as 1 or -1.
_CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
# With this many windings, even the finest tube has only a few segments per winding.
_MAX_WINDINGS = 1000
_MAX_SEED = 2**32 - 1


class OptionError(ValueError):
    """An invalid option for a mesh of the library.

    - `option`: its name; `what`: the given value, the expected value, and the remedy.
    """

    def __init__(self, piece: str, option: str, what: str):
        super().__init__(f"{piece}: {option} {what}")
        self.option, self.what = option, what


def plane(size: Number = 1.0, segments: int = 1) -> Mesh:
    """A square in y = 0 that faces `+y`: `size` world units wide, `segments` quads along each side. Open."""
    _check_positive("plane", size=size)
    _check_count("plane", 1, math.isqrt(_MAX_QUADS), segments=segments)
    line = (np.arange(segments + 1) / segments - 0.5) * size
    x, z = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    a = (np.arange(segments)[:, None] * (segments + 1) + np.arange(segments)).reshape(-1)
    # Rows step along x and columns along z, and z × x = y.
    return _mesh(vertices, _quads(a, a + 1, a + segments + 2, a + segments + 1), _SMOOTH)


def box(size: Number | Sequence[Number] = (1.0, 1.0, 1.0)) -> Mesh:
    """A box; `size` is its extent along x, y and z in world units, or one number for all three."""
    extent = _three("box", "size", size)
    vertices, faces = _box(extent, (0.0, extent[1] / 2, 0.0))
    return _mesh(vertices, faces, _SHARP)


def sphere(radius: Number = 0.5, subdivisions: int = 4) -> Mesh:
    """A smoothly shaded icosphere: `radius` in world units, 20 · 4^`subdivisions` triangles (5,120)."""
    _check_positive("sphere", radius=radius)
    directions, faces = _icosphere("sphere", subdivisions)
    return _mesh(radius * directions, faces, _SMOOTH)


def low_poly_sphere(radius: Number = 0.5, subdivisions: int = 1, smooth: bool = True) -> Mesh:
    """A sphere with only 80 triangles, whose shading normals disagree with its facets near the terminator.

    **Arguments:**

    - `radius`: radius of the sphere through its vertices, world units.
    - `subdivisions`: it has 20 · 4^`subdivisions` triangles.
    - `smooth`: whether it has smooth shading normals.
    """
    _check_positive("low_poly_sphere", radius=radius)
    directions, faces = _icosphere("low_poly_sphere", subdivisions)
    return _mesh(radius * directions, faces, _SMOOTH if smooth else 0.0)


def torus(radius: Number = 0.35, tube: Number = 0.15, segments: int = 64, sides: int = 32) -> Mesh:
    """A torus on the ground; `radius` of the ring and radius of the `tube` in world units."""
    _check_positive("torus", radius=radius, tube=tube)
    _check_tube("torus", segments, sides)
    if tube >= radius:
        raise OptionError(
            "torus", "tube", f"is {tube}, and radius is {radius}; expected less than that; make the tube thinner"
        )
    angle = _turn(segments)
    outwards = np.stack([np.cos(angle), np.zeros(segments), -np.sin(angle)], axis=-1)
    upwards = np.broadcast_to([0.0, 1.0, 0.0], (segments, 3))
    return _mesh(*_tube(radius * outwards, outwards, upwards, tube, sides), _SMOOTH)


def torus_knot(
    p: int = 2, q: int = 3, radius: Number = 0.28, tube: Number = 0.065, segments: int = 192, sides: int = 16
) -> Mesh:
    """An upright torus knot, by default a trefoil of 6,144 triangles.

    **Arguments:**

    - `p`, `q`: the windings of the curve around the axis of its torus, and through its hole. They must be coprime.
    - `radius`: radius of the torus' ring, world units; the torus is half as thick, so the knot is 3 · `radius` + 2 ·
        `tube` wide.
    - `tube`: radius of the knot's tube, world units; strands intersect if it is too thick.
    - `segments`, `sides`: the number of faces along the tube and around it.
    """
    _check_positive("torus_knot", radius=radius, tube=tube)
    _check_tube("torus_knot", segments, sides)
    _check_count("torus_knot", 1, _MAX_WINDINGS, p=p, q=q)
    if math.gcd(p, q) != 1:
        what = f"is {q}, which has a divisor in common with p, {p}; expected none; take numbers such as p = 2, q = 3"
        raise OptionError("torus_knot", "q", what)
    t = _turn(segments)
    # ((2 + cos qt) cos pt, (2 + cos qt) sin pt, -sin qt) · radius / 2
    ring = (2 + np.cos(q * t)) * radius / 2
    d_ring = -q * np.sin(q * t) * radius / 2
    cos, sin = np.cos(p * t), np.sin(p * t)
    curve = np.stack([ring * cos, ring * sin, -np.sin(q * t) * radius / 2], axis=-1)
    tangent = np.stack(
        [d_ring * cos - p * ring * sin, d_ring * sin + p * ring * cos, -q * np.cos(q * t) * radius / 2], -1
    )
    # The tangent winds around the axis and is never parallel to the position, so this frame is continuous and closes.
    side = _unit(np.cross(tangent, curve))
    return _mesh(*_tube(curve, _unit(np.cross(tangent, side)), side, tube, sides), _SMOOTH)


def fence(
    width: Number = 1.0, height: Number = 1.0, slats: int = 10, slat_width: Number = 0.03, thickness: Number = 0.02
) -> Mesh:
    """A row of upright slats along x, which do not touch.

    **Arguments:**

    - `width`, `height`: size of the whole fence, world units.
    - `slats`: the number of slats.
    - `slat_width`, `thickness`: size of each slat along x and z, world units.
    """
    _check_positive("fence", width=width, height=height, slat_width=slat_width, thickness=thickness)
    _check_count("fence", 1, _MAX_SLATS, slats=slats)
    if slats * slat_width >= width and not (slats == 1 and slat_width == width):
        raise OptionError(
            "fence",
            "slats",
            f"is {slats}, which at a slat_width of {slat_width} leaves no gaps in a width of {width}; expected gaps; "
            "take fewer or narrower slats, or a wider fence",
        )
    parts = [
        _box((slat_width, height, thickness), (float(x), height / 2, 0.0))
        for x in (np.linspace(-0.5, 0.5, slats) * (width - slat_width) if slats > 1 else [0.0])
    ]
    return _mesh(*_together(parts), _SHARP)


def thin_wall(width: Number = 1.0, height: Number = 1.0, thickness: Number = 0.01) -> Mesh:
    """A closed upright wall in the xy plane; all in world units. Light leaks through it if the bias is too large."""
    _check_positive("thin_wall", width=width, height=height, thickness=thickness)
    return box((width, height, thickness))


def chair(height: Number = 1.0, spindles: int = 5, sides: int = 24) -> Mesh:
    """A Windsor chair that faces `+z`: a round seat on four splayed legs, and a back of thin spindles below a bow.

    If the bias is too large, light leaks through its thin parts, and its shadow detaches from its feet. Each part is a
    closed mesh whose ends lie inside the adjoining part.

    **Arguments:**

    - `height`: height of the whole chair, world units. The chair is half as wide.
    - `spindles`: number of spindles in the back. They are flat, and wider towards the top.
    - `sides`: number of sides around each leg and spindle; the seat has four times as many. The chair has 14,256
        triangles by default.
    """
    _check_positive("chair", height=height)
    _check_count("chair", 0, _MAX_SPINDLES, spindles=spindles)
    _check_count("chair", 3, _MAX_CHAIR_SIDES, sides=sides)
    # Lengths are fractions of the height, except in the last line.
    x, z = np.eye(3)[[0]], np.eye(3)[[2]]
    along = np.linspace(0, 1, 13)
    swell = np.sin(np.pi * along)

    def line(start: HostArray, end: HostArray) -> Float[HostArray, "13 3"]:
        return start + along[:, None] * (end - start)

    def leg(right: int, front: int) -> Float[HostArray, "13 3"]:
        return line(np.array([0.2 * right, 0.0, 0.2 * front]), np.array([0.12 * right, 0.45, 0.12 * front]))

    # The rings of legs are horizontal, so that the whole foot touches the ground.
    legs = [_rod(leg(right, front), x, z, 0.007 + 0.004 * along + 0.006 * swell, sides) for right, front in _CORNERS]
    # Two rails from front to back, and one between their middles.
    joints = [[leg(right, front)[4] for front in (-1, 1)] for right in (-1, 1)]
    rails = [line(*ends) for ends in (*joints, [np.mean(ends, axis=0) for ends in joints])]
    across = [x, x, z]
    stretchers = [
        _rod(rail, side, np.cross(side, _unit(rail[-1:] - rail[:1])), 0.005 + 0.004 * swell, sides)
        for rail, side in zip(rails, across, strict=True)
    ]

    # A flat bottom, a round rim, and a shallow dish.
    turn, dish = np.linspace(-np.pi / 2, np.pi / 2, 13), np.linspace(1, 0.1, 7)[1:]
    radius = np.concatenate([0.21 + 0.02 * np.cos(turn), 0.21 * dish])
    level = np.concatenate([0.455 + 0.02 * np.sin(turn), 0.465 + 0.01 * dish**2])
    seat = _rod(np.stack([0 * level, level, 0 * level], axis=-1), x, z, radius, 4 * sides)

    # The bow is half an ellipse that leans back. Spindles fan out to it from an arc along the seat's rim.
    base, width, up = np.array([0.0, 0.455, -0.11]), 0.175, np.array([[0.0, 0.535, -0.14]])
    turn = np.linspace(0, np.pi, 65)[:, None]
    normal = _unit(np.cross(x, up))
    tangent = _unit(width * np.sin(turn) * x + np.cos(turn) * up)
    curve = base - width * np.cos(turn) * x + np.sin(turn) * up
    bow = _rod(curve, normal, np.cross(normal, tangent), np.full(65, 0.010), sides)
    back = []
    for across_back in np.linspace(-1, 1, spindles + 2)[1:-1]:
        right = 0.7 * width * across_back
        foot, head = np.array([right, 0.455, -math.sqrt(0.2**2 - right**2)]), 0.9 * across_back
        spindle = line(foot, (base + width * head * x + math.sqrt(1 - head**2) * up)[0])
        direction = _unit(spindle[-1:] - spindle[:1])
        flat = _unit(np.cross(direction, x))
        back.append(_rod(spindle, np.cross(direction, flat), 0.16 * flat, 0.010 + 0.010 * along**2, sides))

    vertices, faces = _together([*legs, *stretchers, seat, bow, *back])
    return _mesh(vertices * height / np.ptp(vertices[:, 1]), faces, _SHARP)


def blob(radius: Number = 0.5, subdivisions: int = 4, amplitude: Number = 0.25, seed: int = 0) -> Mesh:
    """A smooth, bumpy sphere with hollows, which shadows itself.

    **Arguments:**

    - `radius`: mean radius, world units.
    - `subdivisions`: it has 20 · 4^`subdivisions` triangles (5,120).
    - `amplitude`: amplitude of the bumps as a fraction of the radius, in [0, 1).
    - `seed`: seed of the random shape, which does not depend on the number of subdivisions.
    """
    _check_positive("blob", radius=radius)
    _check_count("blob", 0, _MAX_SEED, seed=seed)
    if not 0 <= amplitude < 1:
        what = f"is {amplitude}; expected a fraction of the radius, at least 0 and less than 1; change it"
        raise OptionError("blob", "amplitude", what)
    directions, faces = _icosphere("blob", subdivisions)
    rng = np.random.default_rng(seed)
    # Plane waves with wavelengths near the radius. Scaled by the root of their number, their sum is within about ±1.
    waves = 12
    frequency = 4.0 * _unit(rng.normal(size=(waves, 3))) * rng.uniform(0.5, 1.5, (waves, 1))
    noise = np.cos(directions @ frequency.T + rng.uniform(0, 2 * np.pi, waves)).sum(axis=-1) * np.sqrt(2 / waves)
    return _mesh((radius * (1 + amplitude * np.tanh(noise)))[:, None] * directions, faces, _SMOOTH)


LIBRARY: Mapping[str, Callable[..., Mesh]] = MappingProxyType({name: globals()[name] for name in PIECES})
"""The pieces by name."""


def library_mesh(name: str, /, **options: Any) -> Mesh:
    """The library's mesh `name`. `options` are the arguments of the function with this name.

    **Raises** `ValueError` if there is no such piece, and `OptionError` for an unknown option or an invalid value.

    !!! Example

        ```python
        torus = geometry.library_mesh("torus", segments=24, sides=12)
        torus.faces.shape  # (576, 3)
        sorted(geometry.LIBRARY)  # the names
        ```
    """
    if name not in LIBRARY:
        raise ValueError(
            f"there is no mesh called {name!r} in the library{_suggestion(name, LIBRARY)}; "
            f"expected one of {', '.join(LIBRARY)}"
        )
    known = inspect.signature(LIBRARY[name]).parameters
    for option, value in options.items():
        if option not in known:
            near = difflib.get_close_matches(option, list(known), n=1)
            mend = f"did you mean {near[0]!r}?" if near else "remove it"
            raise OptionError(name, option, f"is not an option of {name}; expected {', '.join(known)}; {mend}")
        _check_type(name, option, value, known[option].default)
    return LIBRARY[name](**options)


def _suggestion(word: str, words: Mapping[str, Any]) -> str:
    near = difflib.get_close_matches(str(word), list(words), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def _check_type(name: str, option: str, value: Any, default: Any) -> None:
    """**Raises** `OptionError` unless `value` has the type of the option's default."""
    whole = lambda x: isinstance(x, int) and not isinstance(x, bool)
    number = lambda x: whole(x) or isinstance(x, float)
    if isinstance(default, bool):
        suits, expected = isinstance(value, bool), "true or false"
    elif isinstance(default, int):
        suits, expected = whole(value), "a whole number"
    elif isinstance(default, float):
        suits, expected = number(value), "a number"
    else:
        suits = number(value) or (isinstance(value, list | tuple) and all(map(number, value)))
        expected = "a number or three"
    if not suits:
        given = reprlib.repr(value)
        raise OptionError(name, option, f"is {given}; expected {expected}; give one such as the default, {default}")


def _check_positive(piece: str, **sizes: Any) -> None:
    for option, value in sizes.items():
        if not _MIN_SIZE <= value <= _MAX_SIZE:
            expected = f"world units from {_MIN_SIZE:g} to {_MAX_SIZE:g}"
            raise OptionError(piece, option, f"is {value}; expected {expected}; change it")


def _check_count(piece: str, least: int, most: int, **counts: int) -> None:
    for option, value in counts.items():
        if not least <= value <= most:
            raise OptionError(piece, option, f"is {value}; expected a whole number from {least} to {most}; change it")


def _check_tube(piece: str, segments: int, sides: int) -> None:
    _check_count(piece, 3, _MAX_QUADS // 3, segments=segments, sides=sides)
    if segments * sides > _MAX_QUADS:
        given = f"is {segments}, which with {sides} sides makes {2 * segments * sides:,} triangles"
        raise OptionError(piece, "segments", f"{given}; expected at most {2 * _MAX_QUADS:,}; lower one of the two")


def _three(piece: str, option: str, value: Number | Sequence[Number]) -> tuple[float, float, float]:
    values = [value] * 3 if isinstance(value, float | int) else list(value)
    if len(values) != 3:
        raise OptionError(
            piece, option, f"has {counted(len(values), 'entry')}; expected one number, or three; give x, y and z"
        )
    for size in values:
        _check_positive(piece, **{option: size})
    return float(values[0]), float(values[1]), float(values[2])


def _mesh(vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], crease_angle: float) -> Mesh:
    """The mesh, placed on the ground at the origin."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = vertices - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]
    return Mesh(vertices, faces, crease_normals(vertices, faces, crease_angle))


def _quads(a, b, c, d) -> Int[HostArray, "f 3"]:
    """Two triangles for each quad with the corners `a b c d`, anticlockwise."""
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def _together(
    parts: Sequence[tuple[Float[HostArray, "_ 3"], Int[HostArray, "_ 3"]]],
) -> tuple[Float[HostArray, "v 3"], Int[HostArray, "f 3"]]:
    """Merges the vertices and faces of all parts."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + start for (_, faces), start in zip(parts, first, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _unit(vectors: Float[HostArray, "n 3"]) -> Float[HostArray, "n 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _turn(n: int) -> Float[HostArray, " n"]:
    """`n` evenly spaced angles of a full turn, radians."""
    return 2 * np.pi * np.arange(n) / n


def _box(extent: Sequence[Number], centre: Sequence[Number]) -> tuple[Float[HostArray, "8 3"], Int[HostArray, "12 3"]]:
    # Vertex 4x + 2y + z, where each bit is 1 on the positive side of its axis.
    corners = (np.arange(8)[:, None] >> np.array([2, 1, 0])) & 1
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return (corners - 0.5) * extent + centre, _quads(*quads.T)


def _tube(
    curve: Float[HostArray, "n 3"],
    across: Float[HostArray, "n 3"],
    side: Float[HostArray, "n 3"],
    radius: float | int,
    sides: int,
) -> tuple[Float[HostArray, "v 3"], Int[HostArray, "f 3"]]:
    """A closed tube around a closed curve; `across` and `side` span its cross-section, `across × side` points back."""
    n = len(curve)
    i, j = (index.reshape(-1) for index in np.meshgrid(np.arange(n), np.arange(sides), indexing="ij"))
    next_i, next_j = (i + 1) % n, (j + 1) % sides
    faces = _quads(i * sides + j, next_i * sides + j, next_i * sides + next_j, i * sides + next_j)
    return _rings(curve, across, side, np.full(n, radius), sides), faces


def _rod(
    curve: Float[HostArray, "n 3"],
    across: Float[HostArray, "#n 3"],
    side: Float[HostArray, "#n 3"],
    radius: Float[HostArray, " n"],
    sides: int,
) -> tuple[Float[HostArray, "v 3"], Int[HostArray, "f 3"]]:
    """A tube with flat ends along an open curve, with a radius per point; cross-sections are spanned as in `_tube`."""
    n = len(curve)
    across, side = np.broadcast_to(across, (n, 3)), np.broadcast_to(side, (n, 3))
    vertices = np.concatenate([_rings(curve, across, side, radius, sides), curve[[0, -1]]])
    i, j = (index.reshape(-1) for index in np.meshgrid(np.arange(n - 1), np.arange(sides), indexing="ij"))
    a, b = i * sides + j, i * sides + (j + 1) % sides
    walls = _quads(a, a + sides, b + sides, b)
    first, last = n * sides, n * sides + 1
    (a, b), top = (a[:sides], b[:sides]), (n - 1) * sides
    caps = [np.stack([0 * a + first, a, b], axis=-1), np.stack([0 * a + last, b + top, a + top], axis=-1)]
    return vertices, np.concatenate([walls, *caps])


def _rings(
    curve: Float[HostArray, "n 3"],
    across: Float[HostArray, "n 3"],
    side: Float[HostArray, "n 3"],
    radius: Float[HostArray, " n"],
    sides: int,
) -> Float[HostArray, "v 3"]:
    """The vertices of a tube, ring by ring."""
    angle = _turn(sides)
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * side[:, None]
    return (curve[:, None] + radius[:, None, None] * ring).reshape(-1, 3)


def _icosphere(piece: str, subdivisions: int) -> tuple[Float[HostArray, "v 3"], Int[HostArray, "f 3"]]:
    """Unit vertices and faces of an icosahedron, with each triangle split in four, `subdivisions` times."""
    _check_count(piece, 0, _MAX_SUBDIVISIONS, subdivisions=subdivisions)
    g = (1 + math.sqrt(5)) / 2
    rectangle = np.array([[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0]])
    vertices = _unit(np.concatenate([rectangle, np.roll(rectangle, 1, axis=1), np.roll(rectangle, 2, axis=1)]))
    faces = _icosahedron_faces(vertices)
    for _ in range(subdivisions):
        vertices, faces, _ = split_in_four(vertices, faces)
        vertices = _unit(vertices)
    return vertices, faces


def _icosahedron_faces(vertices: Float[HostArray, "12 3"]) -> Int[HostArray, "20 3"]:
    """All triples of mutual neighbours, anticlockwise seen from outside."""
    near = vertices @ vertices.T > 0.4
    i, j, k = (index.reshape(-1) for index in np.meshgrid(*[np.arange(12)] * 3, indexing="ij"))
    # One of each triangle's three rotations: the rotation that starts with the lowest vertex.
    outside = np.linalg.det(np.stack([vertices[i], vertices[j], vertices[k]], axis=1)) > 0
    return np.stack([i, j, k], axis=-1)[near[i, j] & near[j, k] & near[k, i] & outside & (i < j) & (i < k)]
