"""Light from a rectangle."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_float, as_number
from ..._types import AsScalar, AsVec2, AsVec3, Vec2, Vec3
from ...settings.scene import RectangleLight as Settings
from .._vector import Vector
from .._view import View
from ._abstract import AbstractLight, Domain, check_direction, check_position
from ._frustum import LightFrustum, check_frustum, frustum_view, on_plane
from ._pose import LightPose


class RectangleLight(AbstractLight):
    """Light from a rectangle, such as a panel or window. Its shadow map is drawn from its centre, like a spot light's.

    - `position`: (3,), its centre, world units.
    - `direction`: (3,), the direction it faces, of any length except 0.
    - `size`: (2,), width and height, world units.
    - `outer_angle`: half-angle of the shadow map's square frustum, in degrees.
    - `near`, `far`: distances along `direction` of window depth 0 and 1, world units.
    - `up`: (3,), up direction of the rectangle and of its shadow map; only its part orthogonal to `direction` counts.

    `RectangleLight.around` fits angle, near and far to a scene.

    **Raises** `ValueError` for a position that is not finite, a direction or `up` that is zero, a negative size, an
    angle outside (0, 90), or near and far that are not 0 < near < far.
    """

    settings: ClassVar = Settings

    position: AsVec3 = eqx.field(converter=as_number)
    direction: AsVec3 = eqx.field(converter=as_number)
    size: AsVec2 = eqx.field(converter=as_number)
    outer_angle: AsScalar = eqx.field(converter=as_number)
    near: AsScalar = eqx.field(converter=as_number)
    far: AsScalar = eqx.field(converter=as_number)
    up: AsVec3 = eqx.field(converter=as_number, default=Settings.up)

    def _check_rules(self):
        check_position("the rectangle light", self.position)
        check_frustum("the rectangle light", self.direction, self.outer_angle, self.near, self.far)

    @classmethod
    def around(
        cls,
        position: Vec3 | Sequence[float],
        points: Float[Array, "n 3"],
        size: Vec2 | tuple[float, float],
        *,
        target: Vec3 | None = None,
        outer_angle: float | None = None,
        up: Vec3 | None = None,
    ) -> "RectangleLight":
        """The light of `size` at `position` with near, far and, unless given, angle fitted to `points` (n, 3).

        It faces `target`, by default the centre of the points' box.

        **Raises** `ValueError` if `position` and `target` coincide, or if points are next to or behind the light and
        `outer_angle` is left out.
        """
        position, up = as_float(position), as_float(Settings.up if up is None else up)
        check_direction("the rectangle light", up, "up")
        fitted = LightFrustum.around("the rectangle light", position, points, target, up, outer_angle)
        return cls(position, fitted.direction, size, fitted.outer_angle, fitted.near, fitted.far, up)

    def pose(self) -> LightPose:
        """Only its position, because hard shadows depend neither on its orientation nor on its size."""
        return LightPose(Vector(*self.position))

    def at(self, pose: LightPose) -> "RectangleLight":
        return eqx.tree_at(lambda one: one.position, self, pose.place)

    def refitted(self, points: Float[Array, "n 3"]) -> "RectangleLight":
        """The same light with angle, near and far refitted to `points` (n, 3), also under `jit`. They carry no
        gradient. Its direction does not change, and the angle is at most 80 degrees."""
        seen = lax.stop_gradient((self.position, points, self.up, self.direction))
        _, angle, near, far = LightFrustum.framing(*seen)
        return RectangleLight(self.position, self.direction, self.size, angle, near, far, self.up)

    def view(self) -> View:
        return frustum_view(self.position, self.direction, self.up, self.outer_angle, self.near, self.far)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        centre = self.position - points
        return centre if sample is None else centre + on_plane(self.direction, self.up, sample * self.size / 2)

    @property
    def domain(self) -> Domain:
        return "square"

    @property
    def has_size(self) -> bool:
        return bool((self.size > 0).any())
