"""Common code of lights with a single view: frusta fitted to a scene, and points on a plane across the view axis."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import array_module, as_float, dot, normalize
from ..._checks import check_points, check_value, listed
from ..._types import Scalar, Vec3
from ...settings.quantities import NARROWEST
from ...settings.scene import OuterAngle
from .._camera import check_near_far, check_pose
from .._transforms import centred_perspective, frame, look_at, transform_points
from .._view import View
from ._abstract import check_direction

MARGIN = 0.01
"""Margin around the scene in a fitted frustum, as a fraction of its extent. It keeps points away from the border."""
FLAT = 1e-3
"""Minimum depth of a fitted frustum, as a fraction of the scene's size or distance, for scenes that the light sees
edge-on."""
# If a light's nearest point is closer than this fraction of its farthest, the light counts as inside the scene.
_NEAREST = 1e-3
# Minimum near distance, as a fraction of the farthest point's distance: a nearer plane would waste depth precision.
_CLEAR = 1e-2
# Bounds on the half-angle of a refitted frustum, in degrees.
_NARROWEST, _WIDEST = 0.1, 80.0


class LightFrustum(NamedTuple):
    """A frustum: its axis (3,), its half-angle in degrees, and its near and far distances along the axis."""

    direction: Vec3
    outer_angle: Scalar | float
    near: Scalar
    far: Scalar

    @classmethod
    def around(
        cls,
        name: str,
        position: Vec3,
        points: Float[Array, "n 3"],
        target: Vec3 | None,
        up: Vec3,
        outer_angle: float | None,
        aspect: Scalar | float = 1.0,
    ) -> "LightFrustum":
        """The tight frustum around `points` from `position` towards `target`, by default the centre of their box.

        Its width is `aspect` times its height, and `outer_angle` is the half-angle of its height.

        **Raises** `ValueError` if `position` and `target` coincide, or if points are next to or behind the light and
        `outer_angle` is left out.
        """
        check_points(f"{name}'s points", points)
        target = _centre(points) if target is None else as_float(target)
        check_pose(name, position, target)
        direction = target - position
        angle, near, far, is_clear = _fitted(position, points, up, direction, as_float(aspect))
        if outer_angle is None and not bool(is_clear):
            raise ValueError(
                f"{name} at {listed(position)} is inside the scene, so no cone contains all of it; expected a "
                "position outside, or an outer_angle in degrees: move the light or give the angle"
            )
        return cls(direction, max(float(angle), NARROWEST) if outer_angle is None else outer_angle, near, far)

    @classmethod
    def framing(
        cls,
        position: Vec3,
        points: Float[Array, "n 3"],
        up: Vec3,
        direction: Vec3 | None = None,
        aspect: Scalar | float = 1.0,
    ) -> "LightFrustum":
        """Like `around`, but also under `jit`, and along `direction` if given. Points next to or behind the light stay
        outside the frustum."""
        if direction is None:
            direction = _centre(points) - position
        angle, near, far, _ = _fitted(position, points, up, direction, as_float(aspect))
        return cls(direction, jnp.clip(angle, _NARROWEST, _WIDEST), near, far)


@jax.jit
def _fitted(
    position: Vec3, points: Float[Array, "n 3"], up: Vec3, direction: Vec3, aspect: Scalar
) -> tuple[Scalar, Scalar, Scalar, Array]:
    """The angle, near and far of the frustum along `direction` around the points in front of the light, and whether
    this includes all points."""
    eye = transform_points(look_at(position, direction, up), points)[..., :3]
    distance = -eye[..., 2]
    ahead = (distance > 0)[..., None]
    slopes = jnp.abs(eye[..., :2]) / _sides(aspect) / jnp.where(ahead, distance[..., None], 1)
    angle = jnp.rad2deg(jnp.arctan(jnp.max(jnp.where(ahead, slopes, 0)) * (1 + 2 * MARGIN)))
    low, high = _reach(distance)
    return angle, *near_far(low, high), _is_clear(low, high)


@jax.jit
def distances_along(position: Vec3, direction: Vec3, points: Float[Array, "n 3"]) -> tuple[Scalar, Scalar]:
    """Near and far of a light at `position` that shines along `direction` on `points` (n, 3)."""
    return near_far(*_reach(dot(points - position, normalize(direction))))


def _centre(points: Float[Array, "n 3"]) -> Vec3:
    """The centre of their box."""
    xp = array_module(points)
    points = xp.asarray(points)
    return as_float((points.min(axis=0) + points.max(axis=0)) / 2)


def _sides(aspect: Scalar | float) -> Float[Array, "2"]:
    return jnp.stack([as_float(aspect), as_float(1.0)])


def _reach(distance: Float[Array, " n"]) -> tuple[Scalar, Scalar]:
    """The minimum and maximum distance in front of a light."""
    # Points behind the light cast no shadow. If all are behind it, the frustum is as long as the largest distance.
    high = jnp.max(distance)
    high = jnp.where(high > 0, high, jnp.max(jnp.abs(distance)))
    return jnp.clip(jnp.min(distance), 0, high), high


def near_far(low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
    """Near and far for points at distances `low` to `high`. `low` is 0 if the light is among the points."""
    pad = jnp.maximum(MARGIN * (high - low), FLAT / 2 * high)
    clear = _CLEAR * high
    near = jnp.maximum(low - pad, jnp.where(_is_clear(low, high), jnp.minimum(clear, (1 - MARGIN) * low), clear))
    return near, high + pad


def _is_clear(low: Scalar, high: Scalar) -> Array:
    return low > _NEAREST * high


def frustum_view(
    position: Vec3,
    direction: Vec3,
    up: Vec3,
    outer_angle: Scalar,
    near: Scalar,
    far: Scalar,
    aspect: Scalar | float = 1.0,
) -> View:
    """The view of a frustum of vertical half-angle `outer_angle`, in degrees, `aspect` times as wide as high."""
    projection = centred_perspective(2 * outer_angle, near, far, as_float(aspect))
    return View(look_at(position, direction, up), projection, near, far, is_perspective=True)


def check_frustum(name: str, direction: Vec3, outer_angle: Scalar, near: Scalar, far: Scalar) -> None:
    """**Raises** `ValueError` unless the direction is not zero, 0 < near < far and the angle is in range."""
    check_direction(name, direction)
    check_near_far(name, near, far, positive=True)
    check_value(f"{name}'s outer_angle", outer_angle, OuterAngle)


def on_plane(direction: Vec3, up: Vec3, place: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Offsets by `place` to the right and up, as seen along `direction`."""
    right, up, _ = frame(direction, up)
    return place[..., 0:1] * right + place[..., 1:2] * up
