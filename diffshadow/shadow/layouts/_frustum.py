"""A camera's view: its frustum, and the depths of the surface in it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._types import Scalar, Vec3
from ...geometry import View
from ...raster import Surface


class ViewFrustum(NamedTuple):
    """A camera's view.

    - `eye`: (3,), its position; `axes`: (3, 3), the unit vectors to its right, up and forward; in world space.
    - `corners`: (4, 2), the offsets of the image's corners to the right of and above the axis, at depth 1 if
      `is_perspective`.
    """

    eye: Vec3
    axes: Float[Array, "3 3"]
    corners: Float[Array, "4 2"]
    is_perspective: bool

    @classmethod
    def of(cls, view: View) -> "ViewFrustum":
        turn, shift, clip = view.world_to_eye[:3, :3], view.world_to_eye[:3, 3], view.eye_to_clip
        # The positions of clip coordinates -1 and 1. For a perspective view, they are multiples of depth, because w is
        # the depth.
        across = lambda k: (np.array([-1.0, 1.0]) + (clip[k, 2] if view.is_perspective else -clip[k, 3])) / clip[k, k]
        corners = jnp.stack(jnp.meshgrid(across(0), across(1)), axis=-1).reshape(4, 2)
        backward = jnp.array([1.0, 1.0, -1.0])[:, None]
        return cls(-jnp.sum(turn * shift[:, None], axis=0), turn * backward, corners, view.is_perspective)

    def corners_at(self, depth: Float[Array, " l"]) -> Float[Array, "l 4 3"]:
        """The corners of the camera's view at each `depth`, in world space."""
        depth = depth[:, None, None]
        x, y = self.corners[:, :1], self.corners[:, 1:]
        sides = x * self.axes[0] + y * self.axes[1]
        return self.eye + depth * self.axes[2] + (depth * sides if self.is_perspective else sides)

    def spheres(self, begin: Float[Array, " l"], end: Float[Array, " l"]) -> tuple[Float[Array, "l 3"], Array]:
        """The centres (l, 3) and radii (l,) of the smallest spheres around parts of the camera's view, each between two
        depths.

        The radii depend on the camera's field of view, not on its pose. This is true to the bit, so a rotation of the
        camera does not change their size.
        """
        k2 = jnp.max(jnp.sum(self.corners**2, axis=-1))
        half = (end - begin) / 2
        if not self.is_perspective:
            middle, radius = (begin + end) / 2, jnp.sqrt(half**2 + k2)
        else:
            # The sphere contains the corners of both ends, or only the corners of the far end. In the second case, its
            # centre is that end's centre.
            both = (begin + end) * (1 + k2) / 2
            radius = jnp.sqrt(half**2 + (begin**2 + end**2) * k2 / 2 + ((begin + end) * k2 / 2) ** 2)
            middle, radius = jnp.minimum(both, end), jnp.where(both >= end, end * jnp.sqrt(k2), radius)
        return self.eye + middle[:, None] * self.axes[2], radius


def depths_of(camera: View, surface: Surface | None, shadow_distance: Scalar | None) -> tuple[Scalar, Scalar]:
    """The minimum and maximum depth along the camera's axis that maps are fitted to, in world units.

    **Arguments:**

    - `surface`: the visible surface, if maps are fitted to its depths; `None` to fit them to all depths from the
      camera's near to its far.
    - `shadow_distance`: upper bound on both depths; `None` for no bound.
    """
    near, far = camera.near, camera.far
    if surface is not None:
        depth = lax.stop_gradient(camera.distance(surface.position))
        near = jnp.min(jnp.where(surface.mask, depth, camera.far))
        far = jnp.max(jnp.where(surface.mask, depth, camera.near))
    if shadow_distance is not None:
        far = jnp.minimum(far, shadow_distance)
    # There may be no surface, or none within the shadow distance.
    return jnp.where(near < far, near, camera.near), jnp.where(camera.near < far, far, camera.far)
