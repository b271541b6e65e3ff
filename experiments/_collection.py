"""A collection of scenes drawn from a seed: what rules of thumb are measured over.

A scene is a configuration, as in a YAML file. Kinds of scenes take turns: single objects, groups of them, streets,
woods, fences and walls, hills, rooms with a lamp, open meshes and crowds on wide grounds, and, if there are mesh files,
one of these on a ground, and several on a wide one. Suns are anywhere in the sky but its lowest 10 degrees, cameras are
near and far, maps have 512 to 4096 texels a side (256 to 2048 for wide grounds), and sizes range over four orders of
magnitude.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

Rng = np.random.Generator
Meshes = list[dict[str, Any]]
Made = tuple[Meshes, dict[str, Any], dict[str, Any]]
"""The meshes, the camera and the light of a scene."""

SUN_RADIUS = 0.27
"""The sun's angular radius, in degrees."""
_SIZES = (-2.0, 2.0)
_LEAST_ELEVATION = 10.0
_MAPS = (512, 1024, 2048, 4096)
# Of wide grounds, where a map often has few texels for what stands on them.
_WIDE_MAPS = (256, 512, 1024, 2048)
# A point light has six of them.
_CUBE_MAPS = (256, 512, 1024)
# Room for a kernel of 8 texels at the border of a face of 256.
_GUARD = 0.15


class Collection(NamedTuple):
    """All scenes of a seed. Number `index` has the same scene, however many are drawn.

    - `files`: paths of mesh files, each for some of the scenes.
    """

    seed: int
    files: Sequence[str] = ()

    @property
    def kinds(self) -> Sequence[str]:
        """The kinds that take turns."""
        return [*KINDS, *(OF_FILES if self.files else ())]

    def kind(self, index: int) -> str:
        """The kind of a scene."""
        return self.kinds[index % len(self.kinds)]

    def scene(self, index: int, pixels: int, *, in_metres: bool = False) -> dict[str, Any]:
        """The configuration of scene number `index`, with square images of `pixels` a side.

        `in_metres` gives it the size that engines expect, where a unit is a metre."""
        kind = self.kind(index)
        rng = np.random.default_rng([self.seed, index])
        meshes, camera, light = OF_FILES[kind](rng, self.files) if kind in OF_FILES else KINDS[kind](rng)
        size = float(10 ** rng.uniform(*_SIZES))
        size = 1.0 if in_metres else size
        maps = _CUBE_MAPS if light["type"] == "point" else _WIDE_MAPS if kind in WIDE else _MAPS
        side = int(rng.choice(maps))
        return {
            "name": f"{kind}_{index}",
            "scene": {
                "meshes": [_scaled(mesh, size) for mesh in meshes],
                "camera": {**_scaled(camera, size), "resolution": [pixels, pixels]},
                "light": _scaled(light, size),
            },
            "shadow_map": {"resolution": [side, side]},
            "reference": {"samples": 16},
        }


def _scaled(section: dict[str, Any], size: float) -> dict[str, Any]:
    """A section with its lengths times `size`. A mesh has a scale; a camera or a light has none."""
    of = lambda value: [round(float(x) * size, 9) for x in value] if isinstance(value, list) else value * size
    lengths = {key: of(section[key]) for key in ("translate", "eye", "target", "position") if key in section}
    scale = {"scale": size * section.get("scale", 1.0)} if "path" in section else {}
    return {**section, **lengths, **scale}


def _piece(name: str, at: tuple[float, float, float] = (0, 0, 0), turn: float = 0, **options: Any) -> dict[str, Any]:
    """A mesh of the library at a point, turned about the vertical axis by degrees."""
    return {"path": f"builtin:{name}", "options": options, "translate": list(at), "rotate": [0, round(turn, 3), 0]}


def _uniform(rng: Rng, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _turn(rng: Rng) -> float:
    return _uniform(rng, 0, 360)


def _sun(rng: Rng) -> dict[str, Any]:
    """Spread evenly over the sky."""
    least = math.sin(math.radians(_LEAST_ELEVATION))
    elevation = math.degrees(math.asin(_uniform(rng, least, 1)))
    azimuth = round(_uniform(rng, -180, 180), 3)
    return {"type": "directional", "azimuth": azimuth, "elevation": round(elevation, 3), "angular_radius": SUN_RADIUS}


def _sun_or_lamp(rng: Rng, centre: float = 0.5) -> dict[str, Any]:
    """One in four is a spot light, a few units from the middle."""
    if rng.random() > 0.25:
        return _sun(rng)
    up, turn, far = math.radians(_uniform(rng, 25, 75)), math.radians(_turn(rng)), _uniform(rng, 2, 8)
    at = [far * math.cos(up) * math.sin(turn), centre + far * math.sin(up), far * math.cos(up) * math.cos(turn)]
    return {"type": "spot", "position": at, "radius": 0.0, "target": [0.0, 0.0, 0.0], "outer_angle": 55}


def _orbit(rng: Rng) -> dict[str, Any]:
    near_or_far = float(np.exp(rng.uniform(np.log(2.5), np.log(12))))
    return {
        "fov_y": 40,
        "orbit": {
            "azimuth": round(_uniform(rng, -180, 180), 3),
            "elevation": round(_uniform(rng, 12, 65), 3),
            "distance": round(near_or_far, 3),
        },
    }


def _looking(eye: list[float], target: list[float]) -> dict[str, Any]:
    return {"eye": eye, "target": target, "fov_y": 55}


def _object(rng: Rng) -> dict[str, Any]:
    """Any closed mesh of about one unit, fine or coarse, thick or thin."""
    number = int(rng.integers(1 << 16))
    made: list[Callable[[], dict[str, Any]]] = [
        lambda: _piece("box", size=[round(_uniform(rng, 0.1, 1), 3) for _ in range(3)]),
        lambda: _piece("sphere", subdivisions=int(rng.integers(2, 5))),
        lambda: _piece("low_poly_sphere", subdivisions=int(rng.integers(0, 3)), smooth=bool(rng.integers(2))),
        lambda: _piece("torus", tube=round(_uniform(rng, 0.04, 0.2), 3), segments=48, sides=24),
        lambda: _piece("torus_knot", tube=round(_uniform(rng, 0.03, 0.07), 3), segments=128, sides=12),
        lambda: _piece("fence", slats=int(rng.integers(4, 16)), slat_width=0.03),
        lambda: _piece("thin_wall", thickness=round(_uniform(rng, 0.005, 0.05), 4)),
        lambda: _piece("chair", spindles=int(rng.integers(3, 8)), sides=12),
        lambda: _piece("blob", amplitude=round(_uniform(rng, 0.1, 0.4), 3), subdivisions=3, seed=number),
    ]
    return {**made[int(rng.integers(len(made)))](), "rotate": [0, round(_turn(rng), 3), 0]}


def _single(rng: Rng) -> Made:
    ground = _piece("plane", size=round(_uniform(rng, 2.5, 8), 2))
    return [_object(rng), ground], _orbit(rng), _sun_or_lamp(rng)


def _group(rng: Rng) -> Made:
    pieces = []
    for i in range(int(rng.integers(4, 8))):
        far, turn = (0.0, 0.0) if i == 0 else (_uniform(rng, 0.8, 2.2), _turn(rng))
        at = [far * math.sin(math.radians(turn)), 0.0, far * math.cos(math.radians(turn))]
        pieces.append({**_object(rng), "translate": at, "scale": round(_uniform(rng, 0.4, 1.2), 3)})
    return [*pieces, _piece("plane", size=7.0)], _orbit(rng), _sun_or_lamp(rng)


def _street(rng: Rng) -> Made:
    """Houses on both sides, with fences, trees and a wall, seen from the height of eyes or of a balcony."""
    houses, length = [], _uniform(rng, 30, 90)
    for side in (-1, 1):
        z = 0.0
        while z > -length:
            wide, deep, high = (_uniform(rng, *span) for span in ((5, 9), (6, 12), (4, 14)))
            houses.append(_piece("box", (side * (5 + wide / 2), 0, z - deep / 2), size=[wide, high, deep]))
            z -= deep + _uniform(rng, 0, 4)
    near = [
        _piece("fence", (-3.2, 0, -6), 90, width=6, height=1.0, slats=24, slat_width=0.08, thickness=0.04),
        _piece("box", (3.0, 0, -9), 0, size=[0.15, 4.0, 0.15]),
        _piece("chair", (1.6, 0, -5), _turn(rng), sides=8),
        *_tree(rng, (2.6, 0, -14)),
    ]
    eye = [_uniform(rng, -1, 1), float(rng.choice([1.7, 6.0])), 2.0]
    ground = _piece("plane", (0, 0, -length / 2), size=length + 60)
    return [*houses, *near, ground], _looking(eye, [0.0, 1.2, -14.0]), _sun(rng)


def _tree(rng: Rng, at: tuple[float, float, float], height: float = 4.0) -> Meshes:
    x, y, z = at
    crown = {"radius": round(0.3 * height, 3), "subdivisions": 2, "seed": int(rng.integers(1 << 16))}
    trunk = _piece("box", at, size=[0.06 * height, 0.6 * height, 0.06 * height])
    return [trunk, _piece("blob", (x, y + 0.45 * height, z), **crown)]


def _woods(rng: Rng) -> Made:
    trees: Meshes = []
    for _ in range(int(rng.integers(10, 25))):
        at = (_uniform(rng, -12, 12), 0.0, _uniform(rng, -35, -3))
        trees += _tree(rng, at, _uniform(rng, 2.5, 7))
    eye = [0.0, _uniform(rng, 1.5, 5), 4.0]
    return [*trees, _piece("plane", (0, 0, -15), size=70)], _looking(eye, [0.0, 0.8, -9.0]), _sun(rng)


def _fences(rng: Rng) -> Made:
    made = []
    for i in range(int(rng.integers(2, 6))):
        at, turn = (_uniform(rng, -2, 2), 0, _uniform(rng, -2, 2)), _turn(rng)
        if i % 2:
            thick = round(_uniform(rng, 0.005, 0.08), 4)
            made.append(_piece("thin_wall", at, turn, width=_uniform(rng, 1, 3), thickness=thick))
        else:
            bars = {"slats": int(rng.integers(6, 30)), "slat_width": round(_uniform(rng, 0.01, 0.05), 4)}
            made.append(_piece("fence", at, turn, width=2.5, thickness=round(_uniform(rng, 0.005, 0.04), 4), **bars))
    return [*made, _piece("plane", size=9.0)], _orbit(rng), _sun(rng)


def _hills(rng: Rng) -> Made:
    """Tops of spheres above a plane, with trees among them."""
    hills: Meshes = []
    for _ in range(int(rng.integers(2, 5))):
        radius = _uniform(rng, 20, 80)
        at = (_uniform(rng, -40, 40), _uniform(rng, 1.5, 8) - 2 * radius, _uniform(rng, -110, -15))
        hills.append(_piece("sphere", at, radius=radius, subdivisions=4))
    trees: Meshes = []
    for _ in range(int(rng.integers(4, 10))):
        trees += _tree(rng, (_uniform(rng, -9, 9), 0.0, _uniform(rng, -30, -3)), _uniform(rng, 2, 5))
    eye = [0.0, _uniform(rng, 2, 8), 6.0]
    return [*hills, *trees, _piece("plane", (0, 0, -40), size=300)], _looking(eye, [0.0, 1.5, -12.0]), _sun(rng)


def _room(rng: Rng) -> Made:
    """Four walls, a floor and a ceiling, furniture, and a lamp below the ceiling."""
    wide, high, deep = _uniform(rng, 4, 8), _uniform(rng, 2.4, 3.5), _uniform(rng, 4, 9)
    shell = [
        _piece("box", (0, -0.1, 0), size=[wide, 0.1, deep]),
        _piece("box", (0, high, 0), size=[wide, 0.1, deep]),
        _piece("box", (0, 0, -deep / 2), size=[wide, high, 0.1]),
        _piece("box", (0, 0, deep / 2), size=[wide, high, 0.1]),
        _piece("box", (-wide / 2, 0, 0), size=[0.1, high, deep]),
        _piece("box", (wide / 2, 0, 0), size=[0.1, high, deep]),
    ]
    within = lambda: (_uniform(rng, -0.35, 0.35) * wide, 0.0, _uniform(rng, -0.35, 0.2) * deep)
    chairs = [_piece("chair", within(), _turn(rng), sides=8) for _ in range(int(rng.integers(1, 4)))]
    things = [{**_object(rng), "translate": list(within()), "scale": 0.6} for _ in range(int(rng.integers(1, 4)))]
    lamp = [_uniform(rng, -0.2, 0.2) * wide, high - _uniform(rng, 0.25, 0.6), _uniform(rng, -0.2, 0.1) * deep]
    light: dict[str, Any] = {"type": "point", "position": lamp, "guard": _GUARD}
    if rng.integers(2):
        light = {"type": "spot", "position": lamp, "target": [0.0, 0.0, -0.1 * deep], "outer_angle": 60}
    eye = [0.4 * wide * float(rng.choice([-1, 1])), 1.6, 0.42 * deep]
    return [*shell, *chairs, *things], {**_looking(eye, [0.0, 0.7, -0.2 * deep]), "fov_y": 65}, light


def _open(rng: Rng) -> Made:
    """Cards without thickness over the ground, some upright, some lying, and a ball."""
    cards: Meshes = []
    for _ in range(int(rng.integers(2, 6))):
        at = (_uniform(rng, -1.2, 1.2), _uniform(rng, 0.3, 1.2), _uniform(rng, -1.2, 1.2))
        card = _piece("plane", at, size=round(_uniform(rng, 0.3, 1.0), 3))
        card["rotate"] = [round(_uniform(rng, -100, 100), 2), round(_turn(rng), 2), 0]
        cards.append(card)
    ball = _piece("sphere", (_uniform(rng, -0.8, 0.8), 0, _uniform(rng, -0.8, 0.8)), radius=0.25, subdivisions=3)
    return [*cards, ball, _piece("plane", size=5.0)], _orbit(rng), _sun_or_lamp(rng)


def _crowd(rng: Rng) -> Made:
    """People on a wide ground, most of them near each other, with a house or two."""
    people: Meshes = []
    for _ in range(int(rng.integers(6, 14))):
        people += _person(rng, *_spot_near(rng, 5.0))
    houses = [
        _piece("box", _spot_near(rng, 20.0, 12.0), _turn(rng), size=[_uniform(rng, 6, 10), _uniform(rng, 3, 8), 7.0])
        for _ in range(int(rng.integers(1, 3)))
    ]
    ground = _piece("plane", size=round(_uniform(rng, 40, 160), 1))
    return [*people, *houses, ground], _beside(rng, 5.0, 1.0), _sun(rng)


def _person(rng: Rng, x: float, y: float, z: float) -> Meshes:
    high, turn = _uniform(rng, 1.5, 1.9), _turn(rng)
    wide = 0.25 * high
    return [
        _piece("box", (x, y, z), turn, size=[0.7 * wide, 0.5 * high, 0.11 * high]),
        _piece("box", (x, y + 0.48 * high, z), turn, size=[wide, 0.36 * high, 0.13 * high]),
        _piece("sphere", (x, y + 0.84 * high, z), radius=0.08 * high, subdivisions=2),
    ]


def _spot_near(rng: Rng, far: float, least: float = 0.0) -> tuple[float, float, float]:
    """A place on the ground, up to `far` from the middle."""
    turn, away = math.radians(_turn(rng)), _uniform(rng, least, far)
    return away * math.sin(turn), 0.0, away * math.cos(turn)


def _beside(rng: Rng, far: float, high: float) -> dict[str, Any]:
    """A camera that looks at the middle, as high as eyes or as a balcony."""
    away, turn = _uniform(rng, 1.2, 2.5) * far, math.radians(_turn(rng))
    eye = [away * math.sin(turn), float(rng.choice([1.7, 4.0])) * max(high, 0.3), away * math.cos(turn)]
    return {**_looking(eye, [0.0, 0.5 * high, 0.0]), "fov_y": 45}


def _file(rng: Rng, files: Sequence[str], size: float, at: tuple[float, float, float]) -> dict[str, Any]:
    """A mesh file that stands on the ground, `size` long."""
    path = files[int(rng.integers(len(files)))]
    return {
        "path": path,
        "size": 1.0,
        "drop_to_ground": True,
        "scale": size,
        "translate": list(at),
        "rotate": [0, round(_turn(rng), 3), 0],
    }


def _scan(rng: Rng, files: Sequence[str]) -> Made:
    """A mesh file on a ground that is some times as wide."""
    ground = _piece("plane", size=round(float(np.exp(rng.uniform(np.log(2.5), np.log(14)))), 2))
    return [_file(rng, files, 1.0, (0.0, 0.0, 0.0)), ground], _orbit(rng), _sun_or_lamp(rng)


def _yard(rng: Rng, files: Sequence[str]) -> Made:
    """Mesh files on a wide ground, most of them near each other."""
    things = [
        _file(rng, files, round(_uniform(rng, 0.5, 3.0), 2), _spot_near(rng, 5.0))
        for _ in range(int(rng.integers(3, 9)))
    ]
    ground = _piece("plane", size=round(_uniform(rng, 20, 120), 1))
    return [*things, ground], _beside(rng, 5.0, 1.0), _sun(rng)


KINDS: dict[str, Callable[[Rng], Made]] = {
    "object": _single,
    "group": _group,
    "street": _street,
    "woods": _woods,
    "fences": _fences,
    "hills": _hills,
    "room": _room,
    "open": _open,
    "crowd": _crowd,
}
"""What makes the meshes, the camera and the light of each kind of scene."""
OF_FILES: dict[str, Callable[[Rng, Sequence[str]], Made]] = {"scan": _scan, "yard": _yard}
"""The kinds that need mesh files."""
WIDE = ("crowd", "yard")
"""The kinds with a wide ground, whose maps may be smaller."""
