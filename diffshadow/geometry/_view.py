"""Views: the pose and projection of a camera or a light."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._types import Mat4, Scalar
from ._transforms import transform_points


class View(eqx.Module):
    """A pose and a projection.

    - `world_to_eye`: (4, 4), rigid; the eye looks along `-z`. (l, 4, 4) for a light with several views, which all have
        the same projection.
    - `eye_to_clip`: (4, 4), OpenGL clip space.
    - `near`, `far`: distances along the view axis of window depth 0 and 1, in world units.
    - `is_perspective`: whether sizes shrink with distance.
    """

    world_to_eye: Float[Array, "*l 4 4"]
    eye_to_clip: Mat4
    near: Scalar
    far: Scalar
    is_perspective: bool = eqx.field(static=True)

    def facing(self, layer: Int[Array, "*n"]) -> "View":
        """For a light with several views, the view of `layer` for each point."""
        return eqx.tree_at(lambda view: view.world_to_eye, self, self.world_to_eye[layer])

    @property
    def matrix(self) -> Float[Array, "*l 4 4"]:
        """World space to clip space, (4, 4)."""
        return jnp.matmul(self.eye_to_clip, self.world_to_eye, precision="highest")

    def clip(self, points: Float[Array, "*n 3"]) -> Float[Array, "*k 4"]:
        """Clip coordinates of world `points`; for a light with several views, with one view for each point."""
        # Two steps keep precision for small scenes far from the world's origin.
        eye = transform_points(self.world_to_eye, points)[..., :3]
        return transform_points(self.eye_to_clip, eye)

    def eye_depth(self, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Distance along the view axis, in world units, of window `depth`."""
        if self.is_perspective:
            # z = n f / (f − d (f − n))
            return self.near * self.far / (self.far - depth * (self.far - self.near))
        return self.near + depth * (self.far - self.near)

    def depth_slope(self, distance: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Window depth per world unit along the view axis, at `distance` in world units."""
        span = self.far - self.near
        if self.is_perspective:
            # d = f (z − n) / (z (f − n)), so dd/dz = f n / ((f − n) z²)
            return self.far * self.near / (span * distance * distance)
        return jnp.broadcast_to(1 / span, jnp.shape(distance))

    def texel_extent(self, distance: Float[Array, "*n"], resolution: tuple[int, int]) -> Float[Array, "*n 2"]:
        """Width and height of one texel (or pixel) of a map of `resolution`, in world units, at `distance` along the
        view axis."""
        height, width = resolution
        # Clip space spans 2 units over the map; the projection's diagonal is clip units per eye unit (at distance 1).
        at_unit = 2 / jnp.stack([self.eye_to_clip[0, 0] * width, self.eye_to_clip[1, 1] * height])
        return at_unit * (distance if self.is_perspective else jnp.ones_like(distance))[..., None]

    def texel_size(self, distance: Float[Array, "*n"], resolution: tuple[int, int]) -> Float[Array, "*n"]:
        """The geometric mean of a texel's width and height, in world units, at `distance` along the view axis."""
        return jnp.sqrt(jnp.prod(self.texel_extent(distance, resolution), axis=-1))
