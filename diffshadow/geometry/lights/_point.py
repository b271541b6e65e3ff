"""Light in all directions, with a shadow map of six faces."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_float, as_number, normalize, safe_norm, safe_sqrt
from ..._checks import check_points
from ..._types import AsScalar, AsVec3, Resolution, Scalar, Vec3
from ...settings.scene import PointLight as Settings
from .._camera import check_near_far
from .._transforms import perspective, tangents
from .._vector import Vector
from .._view import View
from ._abstract import AbstractLight, check_position
from ._frustum import near_far
from ._pose import LightPose

# The faces' view directions, in OpenGL's order, and their up vectors, as for a spot light that looks the same
# way.
_FORWARD = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
_UPRIGHT = np.array([(0, 1, 0), (0, 1, 0), (1, 0, 0), (1, 0, 0), (0, 1, 0), (0, 1, 0)], dtype=float)
# Rows right, up and backward of each face.
_FACES = np.stack([np.cross(_FORWARD, _UPRIGHT), _UPRIGHT, -_FORWARD], axis=1)


class PointLight(AbstractLight):
    """Light from a point, or from a sphere, in all directions. Its shadow map is a cube's six faces.

    The faces look along +x, -x, +y, -y, +z and -z. Each face is drawn slightly wider than its 90 degrees. Filter taps
    across an edge of the cube then stay in the face's own map, and no seams show. This works for taps within
    `guard_texels` of the receiver's texel position, so the filter's radius may be as large, minus half a texel for
    bilinear taps and minus a normal offset. Taps farther out reach the map's border, where everything is lit.

    - `position`: (3,), world units.
    - `near`, `far`: distances along a face's axis of window depth 0 and 1, world units. Surfaces closer to the light
        than `near` along all three axes cast no shadow.
    - `radius`: radius of the emitting sphere, world units; 0 for a point.
    - `guard`: the margin of a face beyond its 90 degrees, as a fraction of half their width. Resolution drops by the
      same fraction.

    `PointLight.around` fits near and far to a scene.

    **Raises** `ValueError` for a position that is not finite, near and far that are not 0 < near < far, or a number out
    of its range.
    """

    settings: ClassVar = Settings

    position: AsVec3 = eqx.field(converter=as_number)
    near: AsScalar = eqx.field(converter=as_number)
    far: AsScalar = eqx.field(converter=as_number)
    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)
    guard: AsScalar = eqx.field(converter=as_number, default=Settings.guard)

    def _check_rules(self):
        check_position("the point light", self.position)
        check_near_far("the point light", self.near, self.far, positive=True)

    @classmethod
    def around(
        cls,
        position: Vec3 | Sequence[float],
        points: Float[Array, "n 3"],
        *,
        radius: float = Settings.radius,
        guard: float = Settings.guard,
    ) -> "PointLight":
        """The light at `position` with near and far fitted to `points` (n, 3).

        Far is tight. Near is tight if some axis separates the light from the points. Otherwise the light is among them,
        and near is a hundredth of far, because a surface may be closer to the light than any of its points.
        """
        position = as_float(position)
        check_position("the point light", position)
        check_points("the point light's points", points)
        near, far = _near_far(position, points)
        return cls(position, near, far, radius, guard)

    def pose(self) -> LightPose:
        return LightPose(Vector(*self.position), radius=self.radius)

    def at(self, pose: LightPose) -> "PointLight":
        return eqx.tree_at(lambda one: (one.position, one.radius), self, (pose.place, pose.radius))

    def refitted(self, points: Float[Array, "n 3"]) -> "PointLight":
        tight = PointLight.around(*lax.stop_gradient((self.position, points)))
        return PointLight(self.position, tight.near, tight.far, self.radius, self.guard)

    def guard_texels(self, resolution: Resolution) -> float:
        """The maximum distance, in texels of faces of `resolution`, between the receiver's texel position and a tap
        that stays within the border. Only for concrete lights."""
        guard = float(self.guard)
        return guard / (1 + guard) * min(resolution) / 2

    def view(self) -> View:
        world_to_eye, eye_to_clip = _matrices(self.position, self.near, self.far, self.guard)
        return View(world_to_eye, eye_to_clip, self.near, self.far, is_perspective=True)

    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"]:
        offset = lax.stop_gradient(points - self.position)
        axis = jnp.argmax(jnp.abs(offset), axis=-1)
        along = jnp.take_along_axis(offset, axis[..., None], axis=-1)[..., 0]
        return (2 * axis + (along < 0)).astype(jnp.int32)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        """Vectors from `points` to the light; samples lie on the disk bounded by the sphere's outline.

        With `c` the vector to the centre, `w` its unit vector and `d` its length, the outline of a sphere of radius `r`
        has its centre at c - (r²/d) w and radius r √(1 - r²/d²). For a point inside the sphere, the disk is the
        sphere's cross-section through its centre.
        """
        centre = self.position - points
        if sample is None:
            return centre
        distance = safe_norm(centre)[..., None]
        is_outside = distance > self.radius
        sine = jnp.where(is_outside, self.radius / jnp.where(is_outside, distance, 1), 0)
        cosine = safe_sqrt((1 - sine) * (1 + sine))
        w = normalize(centre)
        right, up = tangents(w)
        on_disk = sample[..., 0:1] * right + sample[..., 1:2] * up
        return centre - self.radius * sine * w + self.radius * cosine * on_disk

    @property
    def has_size(self) -> bool:
        return float(self.radius) > 0


@jax.jit
def _near_far(position: Vec3, points: Float[Array, "n 3"]) -> tuple[Scalar, Scalar]:
    offset = points - position
    parted = jnp.max(jnp.maximum(jnp.min(offset, axis=0), -jnp.max(offset, axis=0)))
    return near_far(jnp.maximum(parted, 0), jnp.max(jnp.abs(offset)))


@jax.jit
def _matrices(
    position: Vec3, near: Scalar, far: Scalar, guard: Scalar
) -> tuple[Float[Array, "6 4 4"], Float[Array, "4 4"]]:
    """World space to the eye space of each face, and from there to clip space."""
    faces = as_float(_FACES)
    moved = -jnp.sum(faces * position, axis=-1)
    world_to_eye = jnp.zeros((6, 4, 4), moved.dtype).at[:, :3, :3].set(faces).at[:, :3, 3].set(moved)
    sides = (1 + guard) * jnp.array([-1.0, 1.0])
    return world_to_eye.at[:, 3, 3].set(1), perspective(sides, sides, near, far)
