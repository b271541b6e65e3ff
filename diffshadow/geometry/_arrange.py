"""Finds missing parts of a scene: a camera, a light, and a ground that receives the shadow."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._types import HostArray
from ._framing import (
    Framed,
    FrameLight,
    Lens,
    Points,
    Vector,
    frame_inside,
    frame_outside,
    lamp_in,
    samples_of,
    shadow_of,
    sun,
    sun_for,
    sun_for_view,
)
from ._ground import Corners, Ground, ground_of, has_floor, height_field_of, inside_of

# A ground extends beyond the casters and their shadows by this fraction of their extent, on each side.
_BEYOND = 0.4
# It is below level faces that show their front sides, by this fraction of the scene's size, so that they do not touch.
_BELOW = 1e-3
# Radius of a lamp in a room, as a fraction of the room's height.
_LAMP_RADIUS = 0.02


class Wanted(NamedTuple):
    """The parts that have to be found."""

    camera: bool = False
    light: bool = False
    ground: bool = False


class Given(NamedTuple):
    """The known parts of a scene: `light`, its camera's position (eye, target) and lens, the casting faces (f,), and
    the up direction."""

    light: FrameLight | None
    camera: tuple[Vector, Vector] | None
    lens: Lens
    casts: Bool[HostArray, " f"]
    up: Vector


class Arranged(NamedTuple):
    """The found parts, in world coordinates. Parts that were not requested are `None`.

    - `camera`: its position, and its estimated share of the picture.
    - `sun`: its azimuth and elevation in degrees, with `+y` up; `direction`: the direction in which it shines.
    - `lamp`: position, and radius.
    - `plane`: the centre of a square ground, and its side.
    - `is_room`, `has_ground`: whether the scene counts as a room, and whether it has a ground.
    """

    camera: Framed | None
    sun: tuple[float, float] | None
    direction: Vector | None
    lamp: tuple[Vector, float] | None
    plane: tuple[Vector, float] | None
    is_room: bool
    has_ground: bool


class _Scene(NamedTuple):
    """A scene with `+y` up around the origin of its coordinates: the casters' corners, samples of them, and the
    ground."""

    casters: Points
    samples: Points
    height: float
    ground: Ground | None


def arrange(corners: Corners, given: Given, wanted: Wanted) -> Arranged:
    """Finds the `wanted` parts of a scene with triangles (f, 3, 3), at any size and position.

    A scene that is closed around a point is seen and lit from inside. Any other scene is seen from outside and lit by a
    sun.
    """
    turn, middle = turn_up(given.up), (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2
    local, world = (lambda point: turn @ (point - middle)), (lambda point: turn.T @ point + middle)
    turned = (corners - middle) @ turn.T
    inside = inside_of(turned)
    light = None if given.light is None else _turned(given.light, turn, middle)
    view = None if given.camera is None else (local(given.camera[0]), local(given.camera[1]))
    angles = lamp = plane = camera = scene = None
    if inside is not None:
        if wanted.light:
            lamp = world(lamp_in(inside)), _LAMP_RADIUS * (inside.ceiling - inside.floor)
        framed = None
        if wanted.camera:
            place = lamp_in(inside) if light is None else light.position
            framed = frame_inside(turned, inside, given.lens, place)
    else:
        scene = _scene(turned, given.casts)
        if wanted.light or light is None:
            under = scene.height if scene.ground is None else scene.ground.under(scene.samples)
            angles = sun_for(scene.samples, under, is_level=scene.ground is None or scene.ground.relief is None)
            if view is not None:
                angles = sun_for_view(scene.samples, scene.height, *view, given.lens, angles[1])
            light = sun(*angles)
        if wanted.ground and scene.ground is None:
            centre, side = _plane(turned, scene, light)
            plane = world(centre), side
        framed = None
        if wanted.camera:
            framed = frame_outside(scene.casters, scene.samples, light, given.lens, scene.height, scene.ground)
    if framed is not None:
        camera = framed._replace(eye=world(framed.eye), target=world(framed.target))
    found_sun = angles if wanted.light and inside is None else None
    direction = None if found_sun is None else turn.T @ sun(*found_sun).direction  # type: ignore[operator]
    has_ground = scene is not None and scene.ground is not None
    return Arranged(camera, found_sun, direction, lamp, plane, inside is not None, has_ground)


def turn_up(up: Vector) -> Float[HostArray, "3 3"]:
    """The shortest rotation from the direction `up` to `+y`."""
    a, b = np.asarray(up, float) / np.linalg.norm(up), np.array([0.0, 1.0, 0.0])
    if a @ b < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    v = np.cross(a, b)
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    # Rodrigues' formula for two unit vectors.
    return np.eye(3) + k + k @ k / (1 + a @ b)


def angles_of(turn: Float[HostArray, "3 3"]) -> tuple[float, float, float]:
    """The angles about x, then y, then z, in degrees, of a rotation."""
    y = math.asin(float(np.clip(-turn[2, 0], -1, 1)))
    if abs(turn[2, 0]) > 1 - 1e-9:
        x, z = math.atan2(-turn[1, 2], turn[1, 1]), 0.0
    else:
        x, z = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    return tuple(round(math.degrees(each), 6) + 0.0 for each in (x, y, z))  # type: ignore[return-value]


def _scene(corners: Corners, casts: Bool[HostArray, " f"]) -> _Scene:
    ground = ground_of(corners) or height_field_of(corners)
    casting = casts if ground is None else casts & ~ground.faces
    # A ground alone, or meshes that only receive, are framed themselves.
    casters = corners[casting] if casting.any() else corners
    height = float(casters[..., 1].min()) if ground is None else ground.height
    return _Scene(np.unique(casters.reshape(-1, 3), axis=0), samples_of(casters), height, ground)


def _plane(corners: Corners, scene: _Scene, light: FrameLight) -> tuple[Vector, float]:
    """The centre and the side of a square ground under the casters and their shadows."""
    fallen = shadow_of(scene.casters, light, scene.height)
    flat = np.concatenate([scene.casters, fallen])[:, [0, 2]]
    low, high = flat.min(axis=0), flat.max(axis=0)
    side = (1 + 2 * _BEYOND) * float(max(high - low))
    bottom = scene.height - (_BELOW * float(np.ptp(corners, axis=(0, 1)).max()) if has_floor(corners) else 0.0)
    x, z = (low + high) / 2
    return np.array([x, bottom, z]), side


def _turned(light: FrameLight, turn: Float[HostArray, "3 3"], middle: Vector) -> FrameLight:
    if light.position is not None:
        return FrameLight(None, turn @ (light.position - middle))
    return FrameLight(turn @ light.direction)
