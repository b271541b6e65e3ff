"""Light into a cone."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_float, as_number, dot, normalize
from ..._types import AsOptional, AsScalar, AsVec3, Vec3
from ...settings.scene import UP
from ...settings.scene import SpotLight as Settings
from .._vector import Vector
from .._view import View
from ._abstract import AbstractLight, check_direction, check_position
from ._frustum import LightFrustum, check_frustum, distances_along, frustum_view, on_plane
from ._pose import LightPose, angles


class SpotLight(AbstractLight):
    """Light from a point, or from a small disk around it, into a cone.

    - `position`: (3,), world units.
    - `direction`: (3,), the cone's axis, away from the light, of any length except 0.
    - `outer_angle`: half-angle of the cone, in degrees. The shadow map's frustum encloses the cone.
    - `near`, `far`: distances along the axis of window depth 0 and 1, world units.
    - `radius`: radius of the emitting disk, which faces along `direction`; world units, 0 for a point.
    - `inner_angle`: degrees. Inside this half-angle, the light has full intensity. From there to `outer_angle`, it
      falls off by a smooth step in the cosine. Without it, shading ignores the cone. Visibility always ignores it.
    - `up`: (3,), up direction of the shadow map; only its part orthogonal to `direction` counts.
    - `aspect`: width of the shadow map's frustum over its height; `outer_angle` is the height's half-angle.

    `SpotLight.around` fits angle, near and far to a scene.

    **Raises** `ValueError` for a position that is not finite, a direction or `up` that is zero, an inner angle above
    the outer one, near and far that are not 0 < near < far, or a number out of its range.

    !!! Example

        ```python
        lamp = geometry.SpotLight((0, 3, 0), (0, -1, 0), outer_angle=40, near=0.5, far=5, radius=0.1, up=(0, 0, 1))
        lamp.has_size  # True
        ```
    """

    settings: ClassVar = Settings

    position: AsVec3 = eqx.field(converter=as_number)
    direction: AsVec3 = eqx.field(converter=as_number)
    outer_angle: AsScalar = eqx.field(converter=as_number)
    near: AsScalar = eqx.field(converter=as_number)
    far: AsScalar = eqx.field(converter=as_number)
    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)
    inner_angle: AsOptional = eqx.field(converter=as_number, default=Settings.inner_angle)
    up: AsVec3 = eqx.field(converter=as_number, default=UP)
    aspect: AsScalar = eqx.field(converter=as_number, default=Settings.aspect)

    def _check_rules(self):
        check_position("the spot light", self.position)
        check_frustum("the spot light", self.direction, self.outer_angle, self.near, self.far)
        check_direction("the spot light", self.up, "up")

    @classmethod
    def around(
        cls,
        position: Vec3 | Sequence[float],
        points: Float[Array, "n 3"],
        *,
        target: Vec3 | None = None,
        outer_angle: float | None = None,
        radius: float = Settings.radius,
        inner_angle: float | None = Settings.inner_angle,
        up: Vec3 | None = None,
        aspect: float = Settings.aspect,
    ) -> "SpotLight":
        """The light at `position` with near, far and, unless given, cone fitted to `points` (n, 3).

        It points at `target`, by default the centre of the points' box.

        **Raises** `ValueError` if `position` and `target` coincide, or if points are next to or behind the light and
        `outer_angle` is left out.
        """
        position, up = as_float(position), as_float(UP if up is None else up)
        check_direction("the spot light", up, "up")
        frustum = LightFrustum.around("the spot light", position, points, target, up, outer_angle, aspect)
        return cls(position, *frustum, radius, inner_angle, up, aspect)

    def pose(self) -> LightPose:
        return LightPose(Vector(*self.position), *angles(self.direction), self.radius)

    def at(self, pose: LightPose) -> "SpotLight":
        parts = lambda one: (one.position, one.direction, one.radius)
        return eqx.tree_at(parts, self, (pose.place, pose.direction, pose.radius))

    def refitted(self, points: Float[Array, "n 3"]) -> "SpotLight":
        """The same light with near and far refitted to `points` (n, 3), also under `jit`. They carry no gradient.

        With an `inner_angle`, the cone does not change. Without one, the cone is only the map's frustum: it is pointed
        at the centre of the points' box and fitted to them, with an angle of at most 80 degrees.
        """
        if self.inner_angle is not None:
            near, far = distances_along(*lax.stop_gradient((self.position, self.direction, points)))
            framed = LightFrustum(self.direction, self.outer_angle, near, far)
        else:
            framed = LightFrustum.framing(*lax.stop_gradient((self.position, points, self.up)), aspect=self.aspect)
        return SpotLight(self.position, *framed, self.radius, self.inner_angle, self.up, self.aspect)

    def view(self) -> View:
        return frustum_view(self.position, self.direction, self.up, self.outer_angle, self.near, self.far, self.aspect)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        centre = self.position - points
        return centre if sample is None else centre + self.radius * on_plane(self.direction, self.up, sample)

    def cone_fraction(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        if self.inner_angle is None:
            return super().cone_fraction(points)
        to_light = normalize(self.towards(points))
        outer = jnp.cos(jnp.deg2rad(self.outer_angle))
        # If both angles are equal, the cone has a hard edge.
        width = jnp.maximum(jnp.cos(jnp.deg2rad(self.inner_angle)) - outer, 1e-6)
        t = jnp.clip((-dot(to_light, normalize(self.direction)) - outer) / width, 0, 1)
        return t * t * (3 - 2 * t)

    @property
    def has_size(self) -> bool:
        return float(self.radius) > 0
