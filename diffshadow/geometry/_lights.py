"""Lights: the view that a shadow map is drawn from, and the rays that a reference is traced with.

Every light answers two questions. `view()` says how its shadow map projects; `towards(points, disk)` says which way
the light lies. A light may have a size: `disk` picks a point of it, `(0, 0)` its centre, which is where the shadow
map is drawn from.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._misc import as_float, concrete, normalize
from .._types import Scalar, Vec2, Vec3
from ._camera import check_near_far, check_pose
from ._transforms import frame, look_at, orthographic, perspective, transform_points
from ._view import View

_UP = (0.0, 1.0, 0.0)
# Room left round the scene in a fitted frustum, as a share of its extent: keeps the outermost surface off the border.
_MARGIN = 0.01
# A scene that is flat seen from the light still gets a frustum this deep, as a share of its size or its distance.
_FLAT = 1e-3
# A spot light whose nearest point is closer than this share of its farthest counts as inside the scene.
_NEAREST = 1e-3


class AbstractLight(eqx.Module):
    """A light that casts shadows."""

    @abc.abstractmethod
    def view(self) -> View:
        """The projection of the light's shadow map."""

    @abc.abstractmethod
    def towards(self, points: Float[Array, "*n 3"], disk: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        """Vectors from `points` to the light.

        **Arguments:**

        - `points`: (..., 3), world units.
        - `disk`: (..., 2), a point of the unit disk for each of them; which point of the light is meant. The
            centre if left out.

        **Returns:** (..., 3). To a light at a finite distance, the whole way in world units; to a directional light,
        a vector along the way whose length means nothing.
        """

    @property
    @abc.abstractmethod
    def is_directional(self) -> bool:
        """Whether the light is infinitely far away."""

    @property
    @abc.abstractmethod
    def has_size(self) -> bool:
        """Whether the light has an area, so that its shadows have penumbrae. Only for concrete lights."""


class DirectionalLight(AbstractLight):
    """Light from infinitely far away, such as the sun's.

    - `direction`: (3,), the way the light travels; any length but 0.
    - `center`: (3,), a world point on the axis of the shadow map's box.
    - `extent`: (2,), width and height of that box in world units.
    - `near`, `far`: where the box begins and ends along `direction`, measured from `center`, in world units; `near`
        is negative where the box begins before `center`.
    - `angular_radius`: half the angle under which the light's disk is seen, in degrees (the sun's is 0.27).

    `DirectionalLight.around` fits the box to a scene.
    """

    direction: Vec3 = eqx.field(converter=as_float)
    center: Vec3 = eqx.field(converter=as_float)
    extent: Vec2 = eqx.field(converter=as_float)
    near: Scalar = eqx.field(converter=as_float)
    far: Scalar = eqx.field(converter=as_float)
    angular_radius: Scalar = eqx.field(converter=as_float, default=0.0)

    def __check_init__(self):
        _check_direction("the directional light", self.direction)
        check_near_far("the directional light", self.near, self.far, positive=False)
        extent, radius = concrete(self.extent), concrete(self.angular_radius)
        if extent is not None and not (extent > 0).all():
            raise ValueError(f"the directional light's extent is {extent.tolist()}; expected positive world units")
        if radius is not None and not 0 <= radius < 90:
            raise ValueError(f"the directional light's angular_radius is {radius}; expected degrees in [0, 90)")

    @classmethod
    def around(cls, direction: Vec3, points: Float[Array, "n 3"], angular_radius: float = 0.0) -> "DirectionalLight":
        """The light along `direction` whose shadow map holds `points` (n, 3), tightly."""
        direction = as_float(direction)
        _check_direction("the directional light", direction)
        rows = frame(direction, as_float(_UP))
        local = jnp.matmul(points, rows.T, precision="highest")
        low, high = local.min(axis=0), local.max(axis=0)
        size = jnp.maximum(high - low, _FLAT * jnp.max(high - low)) * (1 + 2 * _MARGIN)
        return cls(
            direction=direction,
            center=jnp.matmul((low + high) / 2, rows, precision="highest"),
            extent=size[:2],
            near=-size[2] / 2,
            far=size[2] / 2,
            angular_radius=angular_radius,
        )

    def view(self) -> View:
        half = self.extent / 2
        sides = jnp.array([-1.0, 1.0])
        return View(
            world_to_eye=look_at(self.center, self.direction, as_float(_UP)),
            eye_to_clip=orthographic(half[0] * sides, half[1] * sides, self.near, self.far),
            near=self.near,
            far=self.far,
            is_perspective=False,
        )

    def towards(self, points: Float[Array, "*n 3"], disk: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        backward = jnp.broadcast_to(-normalize(self.direction), points.shape)
        if disk is None:
            return backward
        return backward + jnp.tan(jnp.deg2rad(self.angular_radius)) * _on_disk(self.direction, disk)

    @property
    def is_directional(self) -> bool:
        return True

    @property
    def has_size(self) -> bool:
        return float(self.angular_radius) > 0


class SpotLight(AbstractLight):
    """Light from a point, or from a small disk round it, into a cone.

    - `position`: (3,), world units.
    - `direction`: (3,), the cone's axis, away from the light; any length but 0.
    - `outer_angle`: half the cone's full opening, in degrees. The shadow map's square frustum encloses the cone.
    - `near`, `far`: distances along the axis of window depth 0 and 1, world units.
    - `radius`: of the disk that shines, which faces along `direction`; world units, 0 for a point.

    `SpotLight.around` fits angle, near and far to a scene.
    """

    position: Vec3 = eqx.field(converter=as_float)
    direction: Vec3 = eqx.field(converter=as_float)
    outer_angle: Scalar = eqx.field(converter=as_float)
    near: Scalar = eqx.field(converter=as_float)
    far: Scalar = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float, default=0.0)

    def __check_init__(self):
        _check_direction("the spot light", self.direction)
        check_near_far("the spot light", self.near, self.far, positive=True)
        angle, radius = concrete(self.outer_angle), concrete(self.radius)
        if angle is not None and not 0 < angle < 90:
            raise ValueError(f"the spot light's outer_angle is {angle}; expected degrees between 0 and 90")
        if radius is not None and not (radius >= 0 and np.isfinite(radius)):
            raise ValueError(f"the spot light's radius is {radius}; expected world units, 0 or more")

    @classmethod
    def around(
        cls,
        position: Vec3,
        points: Float[Array, "n 3"],
        *,
        target: Vec3 | None = None,
        outer_angle: float | None = None,
        radius: float = 0.0,
    ) -> "SpotLight":
        """The light at `position` whose near, far and, unless given, cone just hold `points` (n, 3).

        It looks at `target`, by default the middle of the points' box.

        **Raises** `ValueError` if `position` and `target` coincide, or if the points reach beside or behind the light
        and `outer_angle` is left out.
        """
        position = as_float(position)
        target = (points.min(axis=0) + points.max(axis=0)) / 2 if target is None else as_float(target)
        check_pose("the spot light", position, target)
        eye = transform_points(look_at(position, target - position, as_float(_UP)), points)[..., :3]
        distance = -eye[..., 2]
        # What lies behind the light casts no shadow; if all does, the frustum is as long as the scene is far.
        high = jnp.max(distance)
        high = jnp.where(high > 0, high, jnp.max(jnp.abs(distance)))
        low = jnp.clip(jnp.min(distance), 0, high)
        is_ahead = low > _NEAREST * high
        if outer_angle is None:
            if not bool(is_ahead):
                raise ValueError(
                    f"the spot light at {position.tolist()} stands inside the scene, so no cone holds all of it; "
                    "expected a position outside, or an outer_angle in degrees: move the light or give the angle"
                )
            tangent = jnp.max(jnp.abs(eye[..., :2]) / distance[..., None]) * (1 + 2 * _MARGIN)
            outer_angle = float(jnp.rad2deg(jnp.arctan(tangent)))
        pad = jnp.maximum(_MARGIN * (high - low), _FLAT / 2 * high)
        # The near plane stays clear of the light: window depth spends its precision there.
        clear = 1e-2 * high
        near = jnp.maximum(low - pad, jnp.where(is_ahead, jnp.minimum(clear, (1 - _MARGIN) * low), clear))
        far = high + pad
        return cls(position, target - position, outer_angle, near, far, radius)

    def view(self) -> View:
        sides = jnp.tan(jnp.deg2rad(self.outer_angle)) * jnp.array([-1.0, 1.0])
        return View(
            world_to_eye=look_at(self.position, self.direction, as_float(_UP)),
            eye_to_clip=perspective(sides, sides, self.near, self.far),
            near=self.near,
            far=self.far,
            is_perspective=True,
        )

    def towards(self, points: Float[Array, "*n 3"], disk: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        centre = self.position - points
        return centre if disk is None else centre + self.radius * _on_disk(self.direction, disk)

    @property
    def is_directional(self) -> bool:
        return False

    @property
    def has_size(self) -> bool:
        return float(self.radius) > 0


def _on_disk(direction: Vec3, disk: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    right, up, _ = frame(direction, as_float(_UP))
    return disk[..., 0:1] * right + disk[..., 1:2] * up


def _check_direction(name: str, direction: Vec3) -> None:
    d = concrete(direction)
    if d is not None and not (np.isfinite(d).all() and (d != 0).any()):
        raise ValueError(f"{name}'s direction is {d.tolist()}; expected a finite vector that is not zero")
