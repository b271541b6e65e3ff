"""The parameters of a camera's pose."""

import equinox as eqx
import jax.numpy as jnp

from .._types import Mat3, Scalar
from ._transforms import rotation_less_one
from ._vector import Vector


class CameraPose(eqx.Module):
    """A camera's position and rotation. A field that does not apply to the kind of camera is `None`.

    - `eye`: world units.
    - `turn`: a rotation vector about the eye in degrees, in the camera's axes before the rotation. `x` pitches the
      camera upwards, `y` turns it to the left, and `z` rolls it anticlockwise.
    - `fov_y`: a pinhole camera's vertical field of view in degrees; `height`: the height of an orthographic camera's
        view, world units.
    """

    eye: Vector
    turn: Vector
    fov_y: Scalar | None = None
    height: Scalar | None = None

    def axes(self, axes: Mat3) -> Mat3:
        """The axes of a camera after the rotation, as rows right, up and backward, (3, 3). `axes` are the axes before
        it."""
        bend = rotation_less_one(jnp.deg2rad(self.turn.array))
        return axes + jnp.matmul(bend.T, axes, precision="highest")
