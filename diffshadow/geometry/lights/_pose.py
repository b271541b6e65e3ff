"""The parameters of a light's pose."""

import equinox as eqx
import jax.numpy as jnp

from ..._arithmetic import normalize
from ..._types import Scalar, Vec3
from .._vector import Vector


class LightPose(eqx.Module):
    """A light's position, direction and size. A field that does not apply to the kind of light is `None`.

    - `position`: position of a light at a finite distance, world units.
    - `azimuth`, `elevation`: the direction that a directional or spot light comes from, along its axis, in degrees:
        azimuth 0 is +z and 90 is +x, elevation 90 is straight above. An elevation of more than 90 degrees is beyond the
        pole.
    - `radius`: a directional light's `angular_radius` in degrees, a spot or a point light's `radius` in world units.
    """

    position: Vector | None = None
    azimuth: Scalar | None = None
    elevation: Scalar | None = None
    radius: Scalar | None = None

    @property
    def place(self) -> Vec3:
        """The position, (3,), of a light that has one."""
        assert self.position is not None
        return self.position.array

    @property
    def direction(self) -> Vec3:
        """The unit vector, (3,), in which a light with angles shines."""
        assert self.azimuth is not None
        assert self.elevation is not None
        a, e = jnp.deg2rad(self.azimuth), jnp.deg2rad(self.elevation)
        return -jnp.stack([jnp.cos(e) * jnp.sin(a), jnp.sin(e), jnp.cos(e) * jnp.cos(a)])


def angles(direction: Vec3) -> tuple[Scalar, Scalar]:
    """Azimuth and elevation, in degrees, of a light that shines along `direction`, of any length."""
    x, y, z = -normalize(direction)
    # The arc tangent stays accurate near the pole.
    return jnp.rad2deg(jnp.arctan2(x, z)), jnp.rad2deg(jnp.arctan2(y, jnp.hypot(x, z)))
