"""Light in all directions, with a shadow map of six faces."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._misc import as_float, concrete, normalize, safe_norm
from ..._types import Resolution, Scalar, Vec3
from .._camera import check_near_far
from .._transforms import perspective
from .._view import View
from ._abstract import AbstractLight, Domain, check_position, check_size
from ._frustum import near_far
from ._pose import LightPose, Vector

# The ways the faces look, in OpenGL's order, and what is upright in each, as for a spot light that looks the same way.
_FORWARD = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
_UPRIGHT = np.array([(0, 1, 0), (0, 1, 0), (1, 0, 0), (1, 0, 0), (0, 1, 0), (0, 1, 0)], dtype=float)
# Rows right, up and backward of each face.
_FACES = np.stack([np.cross(_FORWARD, _UPRIGHT), _UPRIGHT, -_FORWARD], axis=1)


class PointLight(AbstractLight):
    """Light from a point, or from a sphere, in all directions. Its shadow map is a cube's six faces.

    The faces look along +x, -x, +y, -y, +z and -z, and each is drawn a little wider than its 90 degrees, so that taps
    of a filter find in the face's own map what lies round the corner, and no seams show. That holds while they stay
    within `guard_texels` of where the receiver is seen: a filter of that radius at most, less half a texel if its taps
    are bilinear, and less a normal offset. Beyond, taps meet the map's border, where all is lit.

    - `position`: (3,), world units.
    - `near`, `far`: distances along a face's axis of window depth 0 and 1, world units. What is nearer to the light
        along all three axes than `near` casts no shadow.
    - `radius`: of the sphere that shines, world units; 0 for a point.
    - `guard`: how far a face reaches beyond its 90 degrees, as a share of half their width. It costs as
        much resolution.

    `PointLight.around` fits near and far to a scene.

    **Raises** `ValueError` for a position that is not finite, near and far that are not 0 < near < far, a negative
    radius, or a guard outside [0, 1].
    """

    position: Vec3 = eqx.field(converter=as_float)
    near: Scalar = eqx.field(converter=as_float)
    far: Scalar = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float, default=0.0)
    guard: Scalar = eqx.field(converter=as_float, default=0.1)

    def __check_init__(self):
        check_position("the point light", self.position)
        check_near_far("the point light", self.near, self.far, positive=True)
        check_size("the point light", "radius", self.radius)
        guard = concrete(self.guard)
        if guard is not None and not 0 <= guard <= 1:
            raise ValueError(f"the point light's guard is {guard}; expected a share of half a face's width, 0 to 1")

    @classmethod
    def around(
        cls, position: Vec3, points: Float[Array, "n 3"], *, radius: float = 0.0, guard: float = 0.1
    ) -> "PointLight":
        """The light at `position` whose near and far hold `points` (n, 3).

        Far just does. So does near if an axis parts the light from the points; a light amid them gets a hundredth of
        far, for surfaces may pass nearer to it than any of their points.
        """
        position = as_float(position)
        check_position("the point light", position)
        offset = points - position
        parted = jnp.max(jnp.maximum(jnp.min(offset, axis=0), -jnp.max(offset, axis=0)))
        return cls(position, *near_far(jnp.maximum(parted, 0), jnp.max(jnp.abs(offset))), radius, guard)

    def pose(self) -> LightPose:
        return LightPose(Vector(*self.position), radius=self.radius)

    def at(self, pose: LightPose) -> "PointLight":
        return eqx.tree_at(lambda one: (one.position, one.radius), self, (pose.place, pose.radius))

    def refitted(self, points: Float[Array, "n 3"]) -> "PointLight":
        tight = PointLight.around(*lax.stop_gradient((self.position, points)))
        return PointLight(self.position, tight.near, tight.far, self.radius, self.guard)

    def guard_texels(self, resolution: Resolution) -> float:
        """How far from where a receiver is seen a tap may go, in texels of faces of `resolution`, without meeting the
        border. Only for concrete lights."""
        guard = float(self.guard)
        return guard / (1 + guard) * min(resolution) / 2

    def view(self) -> View:
        faces = as_float(_FACES)
        moved = -jnp.sum(faces * self.position, axis=-1)
        world_to_eye = jnp.zeros((6, 4, 4), moved.dtype).at[:, :3, :3].set(faces).at[:, :3, 3].set(moved)
        sides = (1 + self.guard) * jnp.array([-1.0, 1.0])
        return View(
            world_to_eye=world_to_eye.at[:, 3, 3].set(1),
            eye_to_clip=perspective(sides, sides, self.near, self.far),
            near=self.near,
            far=self.far,
            is_perspective=True,
        )

    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"]:
        offset = lax.stop_gradient(points - self.position)
        axis = jnp.argmax(jnp.abs(offset), axis=-1)
        along = jnp.take_along_axis(offset, axis[..., None], axis=-1)[..., 0]
        return (2 * axis + (along < 0)).astype(jnp.int32)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        """Vectors from `points` to the light; its samples lie on the disk whose rim is the sphere's outline.

        With `c` the centre, `w` the unit vector and `d` the distance to it, the outline of a sphere of radius `r` has
        its centre at c - (r²/d) w and the radius r √(1 - r²/d²). From a point inside the sphere, the disk is the
        sphere's section through the centre.
        """
        centre = self.position - points
        if sample is None:
            return centre
        distance = safe_norm(centre)[..., None]
        is_outside = distance > self.radius
        sine = jnp.where(is_outside, self.radius / jnp.where(is_outside, distance, 1), 0)
        squared = (1 - sine) * (1 + sine)
        cosine = jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1)), 0)
        w = normalize(centre)
        right, up = _across(w)
        on_disk = sample[..., 0:1] * right + sample[..., 1:2] * up
        return centre - self.radius * sine * w + self.radius * cosine * on_disk

    @property
    def domain(self) -> Domain:
        return "disk"

    @property
    def is_directional(self) -> bool:
        return False

    @property
    def has_size(self) -> bool:
        return float(self.radius) > 0


def _across(unit: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
    """Two unit vectors at right angles to `unit` and to one another.

    Duff et al., "Building an orthonormal basis, revisited", Journal of Computer Graphics Techniques 6(1), 2017.
    """
    x, y, z = jnp.moveaxis(unit, -1, 0)
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1),
        jnp.stack([b, sign + y * y * a, -y], axis=-1),
    )
