"""Colours whose components can be fitted individually."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._arithmetic import as_number
from .._types import AsScalar, HostArray, Vec3


class Colour(eqx.Module):
    """A linear colour, whose three numbers can be fitted separately."""

    red: AsScalar = eqx.field(converter=as_number)
    green: AsScalar = eqx.field(converter=as_number)
    blue: AsScalar = eqx.field(converter=as_number)

    @property
    def array(self) -> Vec3:
        """All three, (3,)."""
        return jnp.stack([self.red, self.green, self.blue])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> HostArray:
        return np.asarray([self.red, self.green, self.blue], dtype)


def as_colour(value: Any) -> Any:
    """A `Colour` from one number or three numbers. Other values are returned unchanged."""
    if isinstance(value, Colour):
        return value
    if np.ndim(value) == 0 and not isinstance(value, str):
        return Colour(value, value, value)
    return Colour(*value) if np.shape(value) == (3,) else value


def as_colours(value: Any) -> Any:
    """A tuple of `Colour`s from a list of values that `as_colour` accepts. Other values are returned unchanged."""
    return tuple(map(as_colour, value)) if isinstance(value, tuple | list) else value
