"""The parameters of a camera's pose."""

import equinox as eqx
import jax.numpy as jnp

from .._types import Mat3, Scalar
from ._transforms import rotation_less_one
from ._vector import Vector


class CameraPose(eqx.Module):
    """A camera's position, and how far it is turned; a field that does not apply to the kind of camera is none.

    - `eye`: world units.
    - `turn`: a rotation vector about the eye in degrees, in the camera's own axes before it is turned: `x` pitches it
        upwards, `y` turns it to the left, and `z` rolls it anticlockwise.
    - `fov_y`: a pinhole camera's vertical field of view in degrees; `height`: the height of an orthographic camera's
        view, world units.
    """

    eye: Vector
    turn: Vector
    fov_y: Scalar | None = None
    height: Scalar | None = None

    def axes(self, axes: Mat3) -> Mat3:
        """Rows right, up and backward of a camera with these `axes`, (3, 3), once it is turned."""
        bend = rotation_less_one(jnp.deg2rad(self.turn.array))
        return axes + jnp.matmul(bend.T, axes, precision="highest")
