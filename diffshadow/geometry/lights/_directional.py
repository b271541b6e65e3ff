"""Light from infinitely far away."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import array_module, as_float, as_number, concrete, normalize
from ..._checks import check_points, listed
from ..._types import AsScalar, AsVec2, AsVec3, Vec3
from ...settings.scene import UP
from ...settings.scene import DirectionalLight as Settings
from .._camera import check_near_far
from .._transforms import centred_orthographic, look_at
from .._view import View
from ._abstract import AbstractLight, check_direction
from ._frustum import FLAT, MARGIN, on_plane
from ._pose import LightPose, angles


class DirectionalLight(AbstractLight):
    """Light from infinitely far away, such as the sun's.

    - `direction`: (3,), the direction in which the light travels, of any length except 0.
    - `center`: (3,), a world point on the axis of the shadow map's box.
    - `extent`: (2,), width and height of that box in world units.
    - `near`, `far`: where the box begins and ends along `direction`, measured from `center`, in world units; `near` is
        negative if the box begins before `center`.
    - `angular_radius`: half the angular diameter of the light's disk, in degrees (the sun's is 0.27).
    - `up`: (3,), up direction of the shadow map; only its part orthogonal to `direction` counts.

    `DirectionalLight.around` fits the box to a scene.

    **Raises** `ValueError` for a direction or `up` that is zero, an extent that is not positive, `near` not below
    `far`, or an angular radius out of its range.

    !!! Example

        ```python
        vertices = geometry.merge(meshes).vertices
        sun = geometry.DirectionalLight.around((0.5, -1.0, -0.3), vertices, angular_radius=0.27)
        sun.is_directional  # True
        ```
    """

    settings: ClassVar = Settings

    direction: AsVec3 = eqx.field(converter=as_number)
    center: AsVec3 = eqx.field(converter=as_number)
    extent: AsVec2 = eqx.field(converter=as_number)
    near: AsScalar = eqx.field(converter=as_number)
    far: AsScalar = eqx.field(converter=as_number)
    angular_radius: AsScalar = eqx.field(converter=as_number, default=Settings.angular_radius)
    up: AsVec3 = eqx.field(converter=as_number, default=UP)

    def _check_rules(self):
        check_direction("the directional light", self.direction)
        check_direction("the directional light", self.up, "up")
        check_near_far("the directional light", self.near, self.far, positive=False)
        extent = concrete(self.extent)
        if extent is not None and not ((extent > 0) & np.isfinite(extent)).all():
            raise ValueError(f"the directional light's extent is {listed(extent)}; expected positive world units")

    @classmethod
    def around(
        cls,
        direction: Vec3 | Sequence[float],
        points: Float[Array, "n 3"],
        angular_radius: float = Settings.angular_radius,
        *,
        receivers: Float[Array, "m 3"] | None = None,
        up: Vec3 | None = None,
    ) -> "DirectionalLight":
        """The light along `direction` whose shadow map tightly bounds `points` (n, 3).

        With `receivers` (m, 3), the box is deep enough for the receivers too, but not wider. If `points` are the
        casters, no texels are spent on surfaces that only receive.
        """
        direction, up = as_float(direction), as_float(UP if up is None else up)
        check_direction("the directional light", direction)
        check_direction("the directional light", up, "up")
        check_points("the directional light's points", points)
        # Uses the functions that make views, and NumPy if possible, so that nothing is compiled for the number of
        # points.
        turn = look_at(as_float(np.zeros(3)), direction, up)
        xp = array_module(points, turn, receivers)
        rows = xp.asarray(turn)[:3, :3]
        seen = lambda points: (xp.asarray(points)[:, None] * rows).sum(axis=-1)
        local = seen(points)
        low, high = local.min(axis=0), local.max(axis=0)
        if receivers is not None:
            along = seen(receivers)[:, 2]
            last = xp.asarray([False, False, True])
            low = xp.where(last, xp.minimum(low, along.min()), low)
            high = xp.where(last, xp.maximum(high, along.max()), high)
        size = xp.maximum(high - low, FLAT * xp.max(high - low)) * (1 + 2 * MARGIN)
        return cls(
            direction=direction,
            center=((low + high) / 2 * rows.T).sum(axis=-1),
            extent=size[:2],
            near=-size[2] / 2,
            far=size[2] / 2,
            angular_radius=angular_radius,
            up=up,
        )

    def pose(self) -> LightPose:
        return LightPose(None, *angles(self.direction), self.angular_radius)

    def at(self, pose: LightPose) -> "DirectionalLight":
        parts = lambda one: (one.direction, one.angular_radius)
        return eqx.tree_at(parts, self, (pose.direction, pose.radius))

    def refitted(self, points: Float[Array, "n 3"]) -> "DirectionalLight":
        direction, points, up = lax.stop_gradient((self.direction, points, self.up))
        tight = DirectionalLight.around(direction, points, up=up)
        box = tight.center, tight.extent, tight.near, tight.far
        return DirectionalLight(self.direction, *box, self.angular_radius, self.up)

    def view(self) -> View:
        return View(
            world_to_eye=look_at(self.center, self.direction, self.up),
            eye_to_clip=centred_orthographic(self.extent, self.near, self.far),
            near=self.near,
            far=self.far,
            is_perspective=False,
        )

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        backward = jnp.broadcast_to(-normalize(self.direction), points.shape)
        if sample is None:
            return backward
        return backward + jnp.tan(jnp.deg2rad(self.angular_radius)) * on_plane(self.direction, self.up, sample)

    @property
    def is_directional(self) -> bool:
        return True

    @property
    def has_size(self) -> bool:
        return float(self.angular_radius) > 0
