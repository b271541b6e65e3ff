"""Places a camera and a sun so that a scene's casters and their shadows on the ground are in the picture.

Coordinates have `+y` up, in any unit. The rating of a view uses samples of the casters' surfaces. They are drawn as
points into a small image, together with their shadows.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._types import HostArray
from ._ground import Corners, Ground, Inside, free_distance

# The ratings use different numbers of points.
Points = Float[HostArray, "_ 3"]
Vector = Float[HostArray, "3"]

# The fraction of the image's half that points may reach.
_FILLED = 0.88
# Azimuths of the camera relative to the light's, and elevations, in degrees. The first of equal ones is used.
_ASIDE = (100.0, -100.0, 60.0, -60.0, 140.0, -140.0, 20.0, 180.0)
_ELEVATIONS = (32.0, 20.0, 48.0, 65.0)
_DEFAULT_VIEW = (30.0, 30.0)
# A view replaces an earlier one only if it is better by this factor.
_BETTER = 1.1
# Azimuths of a sun. If its elevation is within these bounds, its shadow extends beyond its caster by this fraction of
# the casters' width.
_AZIMUTHS = (60.0, -60.0, 120.0, -120.0, 20.0, 160.0, -20.0, -160.0)
_SHADOW_LENGTH, _SUN = 0.5, (20.0, 50.0)
# The minimum elevation over a height field.
_OVER_SLOPES = 38.0
# The shadows of suns below this elevation, in degrees, are framed as if the sun were at it.
_LOWEST = 4.0
# Lamps this close to a caster's height, as a fraction of their own height, throw their shadows out of the picture.
_LAMP_ABOVE = 0.1
_SAMPLES, _PIXELS = 1 << 13, 48
# In a room: heights of eye and lamp above the floor, as fractions of the room's height, and the fraction of the way to
# the wall. The first of equal ones is used, and a later one must be better by a factor.
_EYES, _LAMP, _TO_WALL, _LOOKS_AT = (0.62, 0.8), 0.85, (0.85, 0.93), 0.2
_BETTER_INSIDE = 1.02
# Percentiles of directions that enclose most objects in a room.
_FEW = (3, 97)
_AROUND = 16
# Full field of view of a camera in a room, degrees.
ROOM_FOV = 70.0
# Faces this close to a side of a room's box, as a fraction of it, belong to its walls.
_WALL = 0.06
# A point is hidden by another point of the same pixel that is closer by more than this factor.
_HIDDEN = 1.1


class FrameLight(NamedTuple):
    """The source of the shadows: the direction in which a sun shines, or the position of a lamp."""

    direction: Vector | None
    position: Vector | None = None

    def azimuth(self, middle: Vector) -> float:
        """Its azimuth as seen from `middle`, in degrees: 0 on +z, 90 on +x."""
        x, _, z = -self.direction if self.direction is not None else self.position - middle  # type: ignore[operator]
        return math.degrees(math.atan2(x, z))


class Lens(NamedTuple):
    """A camera without a position: the tangents of half its fields of view, (x, y), and whether it is perspective."""

    tangents: tuple[float, float]
    is_perspective: bool = True


class Framed(NamedTuple):
    """A camera's position. `height` is the height of a parallel camera's view. `shadow` and `casters` are their
    estimated shares of the picture."""

    eye: Vector
    target: Vector
    height: float
    shadow: float
    casters: float


def samples_of(corners: Corners, seed: int = 0) -> Points:
    """Points on the triangles, evenly distributed by area, and all corners of the triangles if there are few."""
    rng = np.random.default_rng(seed)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    total = areas.sum()
    if not total > 0:
        return corners.reshape(-1, 3)
    face = np.searchsorted(np.cumsum(areas) / total, rng.random(_SAMPLES)).clip(max=len(corners) - 1)
    u, v = rng.random((2, _SAMPLES, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = np.moveaxis(corners[face], 1, 0)
    return a + u * (b - a) + v * (c - a)


def shadow_of(points: Points, light: FrameLight, height: float | Float[HostArray, " _"]) -> Points:
    """The shadows of `points` on a level ground at `height` (one for all points, or one for each). Shadows that miss
    the ground are left out."""
    if light.direction is not None:
        x, y, z = light.direction / np.linalg.norm(light.direction)
        if y >= 0:
            return points[:0]
        steep = max(-y, math.sin(math.radians(_LOWEST)))
        across = math.hypot(x, z) or 1.0
        length = math.sqrt(1 - steep * steep) / steep if -y < steep else across / steep
        moved = (points[:, 1] - height)[:, None] * np.array([x, 0, z]) / across * length
    else:
        assert light.position is not None
        height = float(np.mean(height))
        above = light.position[1] - height
        points = points[points[:, 1] < height + (1 - _LAMP_ABOVE) * above]
        if above <= 0:
            return points[:0]
        lifted = (points[:, 1] - height)[:, None]
        moved = (points - light.position) * lifted / (above - lifted)
    fallen = points + moved
    fallen[:, 1] = height
    return fallen


def sun_for(samples: Points, ground: float | Float[HostArray, " _"], *, is_level: bool = True) -> tuple[float, float]:
    """The azimuth and elevation, in degrees, of a sun that gives `samples` a large shadow on the ground.

    Broad shadows next to the casters count. The elevation is lower for flat casters. On a ground that is not level, the
    sun is higher, because slopes shadow themselves.
    """
    tall = max(float((samples[:, 1] - ground).max()), np.finfo(float).tiny)
    best, most = (_AZIMUTHS[0], _SUN[1]), 0.0
    cell = max(float(np.ptp(samples, axis=0).max()), tall) / _PIXELS
    for azimuth in _AZIMUTHS:
        towards = np.array([math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))])
        wide = float(np.ptp(samples[:, [0, 2]] @ towards))
        elevation = math.degrees(math.atan2(tall, max(_SHADOW_LENGTH * wide, 1e-9 * tall)))
        elevation = float(round(min(max(elevation, _SUN[0] if is_level else _OVER_SLOPES), _SUN[1])))
        fallen = shadow_of(samples, sun(azimuth, elevation), ground)
        # Complex numbers represent pairs of whole numbers.
        cells, under = (np.floor(each[:, [0, 2]] / cell) @ [1, 1j] for each in (fallen, samples))
        beside = len(np.setdiff1d(cells, under))
        if beside > _BETTER * most:
            best, most = (azimuth, elevation), beside
    return best


def sun_for_view(
    samples: Points, ground: float, eye: Vector, target: Vector, lens: Lens, elevation: float
) -> tuple[float, float]:
    """Like `sun_for`, with a given elevation, and with the azimuth that makes the shadow most visible to a given
    camera."""
    axes, middle = _axes_of(eye - target), (samples.min(axis=0) + samples.max(axis=0)) / 2
    away = eye - middle
    azimuth, half = math.degrees(math.atan2(away[0], away[2])), float(np.linalg.norm(eye - target)) * lens.tangents[1]
    best, most = azimuth + _ASIDE[0], -1.0
    for turn in _ASIDE:
        fallen = shadow_of(samples, sun(azimuth + turn, elevation), ground)
        shadow, _ = _shares(samples, fallen, axes, eye, lens, half)
        if shadow > _BETTER * most:
            best, most = azimuth + turn, shadow
    return float(round((best + 180) % 360 - 180)), elevation


def sun(azimuth: float | int, elevation: float | int) -> FrameLight:
    """A sun from its angles in degrees: azimuth 0 is on +z, 90 on +x."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return FrameLight(-np.array([math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)]))


def frame_outside(
    points: Points, samples: Points, light: FrameLight, lens: Lens, height: float, ground: Ground | None = None
) -> Framed:
    """A camera that sees all casters and their shadows on the ground, from the side that shows most.

    **Arguments:**

    - `points`: all corners of the casters; `samples`: points on their surfaces.
    - `height`: height of the ground; `ground`: the extent of the ground, if the scene has one. Shadows beyond it do not
      show.
    """
    on_ground = lambda points: (
        shadow_of(points, light, height)
        if ground is None
        else _on(shadow_of(points, light, ground.under(points)), ground)
    )
    framed, fallen = np.concatenate([points, on_ground(points)]), on_ground(samples)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    # With no shadow on the ground, any side will do.
    turns = _ASIDE if len(fallen) else (_DEFAULT_VIEW[0],)
    azimuth = light.azimuth(middle) if len(fallen) else 0.0
    best, most = None, 0.0
    for elevation in _ELEVATIONS:
        for turn in turns:
            each = _framed(framed, samples, fallen, lens, azimuth + turn, elevation, middle)
            # Both shadow and casters must show.
            worth = min(each.shadow, each.casters) if len(fallen) else each.casters
            if best is None or worth > _BETTER * most:
                best, most = each, worth
    assert best is not None
    return best


def frame_inside(corners: Corners, inside: Inside, lens: Lens, lamp: Vector | None) -> Framed:
    """A camera in the corner of a room from which it sees most of the room's objects and their shadows on the floor.

    The corner that is farthest from the centre is used if no other is better. `lamp` throws the shadows.
    """
    tall = inside.ceiling - inside.floor
    angles = np.arange(_AROUND) * 2 * np.pi / _AROUND
    directions = np.stack([np.sin(angles), np.zeros(_AROUND), np.cos(angles)], axis=-1)
    start = np.array([inside.point[0], inside.floor + _EYES[0] * tall, inside.point[2]])
    distance = free_distance(corners, start, directions)
    # Windows let rays out.
    distance = np.where(np.isfinite(distance), distance, 0)
    tangents = math.tan(math.radians(ROOM_FOV / 2)) / lens.tangents[1] * np.array(lens.tangents)
    wide = Lens((float(tangents[0]), float(tangents[1])), lens.is_perspective)
    samples = samples_of(corners)
    within = corners[~_is_of_walls(corners)]
    stands = samples_of(within) if len(within) else samples[:0]
    fallen = stands[:0] if lamp is None else shadow_of(stands, FrameLight(None, lamp), inside.floor)
    low, high = samples.min(axis=0), samples.max(axis=0)
    fallen = fallen[((fallen >= low) & (fallen <= high))[:, [0, 2]].all(axis=1)]
    shown = np.concatenate([stands, fallen])
    best, most = None, 0.0
    for k in np.argsort(-distance, kind="stable"):
        across = start - _LOOKS_AT * distance[(k + _AROUND // 2) % _AROUND] * directions[k]
        across[1] = inside.floor + _LOOKS_AT * tall
        for height, part in itertools.product(_EYES, _TO_WALL):
            eye = start + part * distance[k] * directions[k]
            eye[1] = inside.floor + height * tall
            for target in [across, *([_amid(shown, eye)] if len(shown) else [])]:
                shadow, casters = _seen([fallen, stands], samples, _axes_of(eye - target), eye, wide, tall)
                if best is None or shadow + casters > _BETTER_INSIDE * most:
                    best, most = Framed(eye, target, 2 * tall, shadow, casters), shadow + casters
    assert best is not None
    return best


def _amid(points: Points, eye: Vector) -> Vector:
    """A point in the middle of the directions in which an eye sees `points`, except for a few of them."""
    x, y, z = (points - eye).T
    middle = math.atan2(x.mean(), z.mean())
    # Angles relative to the mean direction do not jump.
    turn = np.arctan2(x, z) - middle
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    away = np.hypot(x, z)
    azimuth, elevation = (np.percentile(each, _FEW).mean() for each in (turn, np.arctan2(y, away)))
    across, upward = math.cos(elevation), math.sin(elevation)
    direction = np.array([across * math.sin(middle + azimuth), upward, across * math.cos(middle + azimuth)])
    return eye + float(away.mean()) * direction


def _is_of_walls(corners: Corners) -> Bool[HostArray, " f"]:
    """Which faces belong to the walls, the floor or the ceiling: flat, and at a side of the scene's box."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    margin = _WALL * (high - low)
    at_low, at_high = (corners <= low + margin).all(axis=1), (corners >= high - margin).all(axis=1)
    return (at_low | at_high).any(axis=1)


def _seen(
    each: Sequence[Points], hiding: Points, axes: Float[HostArray, "3 3"], eye: Vector, lens: Lens, half: float
) -> list[float]:
    """The fraction of `each` of some sets of points that is in the picture and not hidden by the samples `hiding`."""
    nearest = np.full(_PIXELS * _PIXELS, np.inf)
    pixel, depth, inside = _pixels(hiding, axes, eye, lens, half)
    np.minimum.at(nearest, pixel[inside], depth[inside])
    parts = []
    for points in each:
        pixel, depth, inside = _pixels(points, axes, eye, lens, half)
        parts.append(float((inside & (depth <= _HIDDEN * nearest[pixel])).mean()) if len(points) else 0.0)
    return parts


def lamp_in(inside: Inside) -> Vector:
    """The position of a lamp under the ceiling of a room."""
    tall = inside.ceiling - inside.floor
    return np.array([inside.point[0], inside.floor + _LAMP * tall, inside.point[2]])


def _on(fallen: Points, ground: Ground) -> Points:
    flat = fallen[:, [0, 2]]
    return fallen[((flat >= ground.low) & (flat <= ground.high)).all(axis=1)]


def _framed(
    points: Points, samples: Points, fallen: Points, lens: Lens, azimuth: float, elevation: float, middle: Vector
) -> Framed:
    """The nearest camera in this direction that sees all `points`."""
    axes = _axes_of(-sun(azimuth, elevation).direction)  # type: ignore[operator]
    across, upward, backward = axes @ (points - middle).T
    tx, ty = (_FILLED * tangent for tangent in lens.tangents)
    if lens.is_perspective:
        x, away_x = _apex(across, backward, tx)
        y, away_y = _apex(upward, backward, ty)
        away, half = max(away_x, away_y), 0.0
    else:
        x, y = ((part.max() + part.min()) / 2 for part in (across, upward))
        half = max(np.ptp(upward) / 2 / _FILLED, np.ptp(across) / 2 / _FILLED * lens.tangents[1] / lens.tangents[0])
        # Outside of everything, because the view's near plane depends on the scene.
        away = float(backward.max() + 2 * half)
    eye = middle + np.array([x, y, away]) @ axes
    # The point of the axis next to the centre of the visible part.
    target = middle + np.array([x, y, (backward.max() + backward.min()) / 2]) @ axes
    shares = _shares(samples, fallen, axes, eye, lens, half)
    return Framed(eye, target, 2 * half, *shares)


def _axes_of(back: Vector) -> Float[HostArray, "3 3"]:
    """The right, upward and backward directions of a view that looks along the opposite of `back`."""
    back = back / np.linalg.norm(back)
    right = np.array([back[2], 0, -back[0]])
    length = float(np.linalg.norm(right))
    right = right / length if length > 1e-6 else np.array([1.0, 0, 0])
    return np.stack([right, np.cross(back, right), back])


def _apex(across: Float[HostArray, " n"], backward: Float[HostArray, " n"], tangent: float) -> tuple[float, float]:
    """The position, across and backward, of the nearest eye that sees all points within a half field of view."""
    left, right = (backward - across / tangent).max(), (backward + across / tangent).max()
    return float((right - left) / 2 * tangent), float((right + left) / 2)


def _shares(
    samples: Points, fallen: Points, axes: Float[HostArray, "3 3"], eye: Vector, lens: Lens, half: float
) -> tuple[float, float]:
    """The fractions of the picture that shadows on the ground and casters fill."""
    nearest = np.full(_PIXELS * _PIXELS, np.inf)
    pixel, depth, inside = _pixels(samples, axes, eye, lens, half)
    np.minimum.at(nearest, pixel[inside], depth[inside])
    casters = np.isfinite(nearest)
    if not len(fallen):
        return 0.0, float(casters.mean())
    pixel, depth, inside = _pixels(fallen, axes, eye, lens, half)
    shows = inside & ~casters[pixel]
    return len(np.unique(pixel[shows])) / len(casters), float(casters.mean())


def _pixels(
    points: Points, axes: Float[HostArray, "3 3"], eye: Vector, lens: Lens, half: float
) -> tuple[Int[HostArray, " n"], Float[HostArray, " n"], Bool[HostArray, " n"]]:
    """The pixel and the depth of each point, and whether it is in the picture."""
    across, upward, backward = axes @ (points - eye).T
    depth = -backward
    tx, ty = lens.tangents
    in_front = depth > 0
    # Points at the eye are far outside the picture, and points behind it are not in it.
    with np.errstate(over="ignore"):
        scale = np.where(in_front, depth, 1.0) if lens.is_perspective else half / ty
        x, y = across / (tx * scale), upward / (ty * scale)
    inside = (np.abs(x) < 1) & (np.abs(y) < 1) & in_front
    cell = lambda part: ((np.clip(part, -1, 1) + 1) / 2 * _PIXELS).clip(max=_PIXELS - 1).astype(int)
    return cell(y) * _PIXELS + cell(x), depth, inside
