"""Vectors whose components can be fitted individually."""

import equinox as eqx
import jax.numpy as jnp

from .._arithmetic import as_number
from .._types import AsScalar, Vec3


class Vector(eqx.Module):
    """Three numbers that can be fitted separately."""

    x: AsScalar = eqx.field(converter=as_number, default=0.0)
    y: AsScalar = eqx.field(converter=as_number, default=0.0)
    z: AsScalar = eqx.field(converter=as_number, default=0.0)

    @property
    def array(self) -> Vec3:
        """All three, (3,)."""
        return jnp.stack([self.x, self.y, self.z])
