"""A directional light whose shadow map is warped by a perspective."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._types import Mat4, Scalar, Vec2
from ...geometry import AbstractLight, View, Warp
from ._fitted_light import AbstractFittedLight


class WarpedLight(AbstractFittedLight):
    """A directional light whose shadow map is a part of the light's own map, rotated about the light's axis and warped
    by a perspective. Depths are as in the light's own map.

    `PerspectiveWarp` makes one for a light and a camera.

    - `light`: the directional light.
    - `camera`: the view of the camera.
    - `end`: the depth along the camera's axis at which the map ends, in world units.
    - `up`: (2,), the direction of the map's y axis in the light's own eye space; a unit vector.
    - `scale`, `offset`: (2,), the window in the rotated eye space. Before the warp, the clip coordinates x and y of a
      point are `scale · xy + offset`, with `scale` per world unit.
    - `warp`: the perspective.
    """

    light: AbstractLight
    camera: View
    end: Scalar
    up: Vec2
    scale: Vec2
    offset: Vec2
    warp: Warp

    def view(self) -> View:
        own = self.light.view()
        turned, scaled = _turned_and_scaled(own.world_to_eye, own.eye_to_clip, self.up, self.scale, self.offset)
        return View(turned, scaled, own.near, own.far, own.is_perspective, warp=self.warp)

    def reaches(self, points: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
        """Which of `points` are within the map's end."""
        return self.depth(points) <= self.end


@jax.jit
def _turned_and_scaled(world_to_eye: Mat4, eye_to_clip: Mat4, up: Vec2, scale: Vec2, offset: Vec2) -> tuple[Mat4, Mat4]:
    """Both matrices, with the window rotated so that `up` points up, and with this scale and offset in its plane."""
    (x, y), (first, second) = up, world_to_eye[:2]
    turned = world_to_eye.at[:2].set(jnp.stack([y * first - x * second, x * first + y * second]))
    window = jnp.concatenate([jnp.diag(scale), jnp.zeros((2, 1)), offset[:, None]], axis=1)
    return turned, eye_to_clip.at[:2].set(window)
