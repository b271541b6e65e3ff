"""Aliasing: the size of a shadow map's texels on the screen."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arithmetic import dot, normalize, safe_divide
from .._types import Mask, TexelMap, VectorMap
from ..geometry import AbstractCamera
from ..raster import Surface
from ._jacobian import Jacobian, determinant, pixels_of, pixels_per_texel, singular_values
from ._map import ShadowMap
from ._receiver import project
from .layouts import Choice


class Aliasing(eqx.Module):
    """The size of a texel on the screen at each pixel. It is 1 where map and image match. Larger texels undersample the
    image, and their edges are visible.

    The longest extent is Lloyd's error m ("Warping and Partitioning for Low Error Shadow Maps", TR07-005, University of
    North Carolina, 2007).

    - `jacobian`: (h, w, 2, 2), the motion of a surface point on the screen, in pixels along x and y (rows), if it moves
      by one texel along the map's x and y (columns).
    - `perspective`: (h, w, 2, 2), the same for a surface tilted equally towards the camera and the light, so that only
      the two perspectives matter. The rest is projection aliasing, which grows at grazing angles of the light.
    - `mask`: (h, w), the measured pixels: surfaces in the map that face the light.
    """

    jacobian: Jacobian
    perspective: Jacobian
    mask: Mask

    @property
    def extent(self) -> Float[Array, "h w"]:
        """The longest extent of a texel, (h, w), in pixels: the Jacobian's greater singular value."""
        return singular_values(self.jacobian)[0]

    @property
    def least_extent(self) -> Float[Array, "h w"]:
        """The shortest extent of a texel, (h, w), in pixels."""
        return singular_values(self.jacobian)[1]

    @property
    def area(self) -> Float[Array, "h w"]:
        """The area of a texel, (h, w), in pixels."""
        return jnp.abs(determinant(self.jacobian))

    @property
    def perspective_extent(self) -> Float[Array, "h w"]:
        """The longest extent due to perspective alone, (h, w), in pixels."""
        return singular_values(self.perspective)[0]

    @property
    def projection_extent(self) -> Float[Array, "h w"]:
        """The factor, (h, w), by which the surface's slope changes the longest extent."""
        return safe_divide(self.extent, self.perspective_extent)


@eqx.filter_jit
def aliasing(shadow_map: ShadowMap, surface: Surface, camera: AbstractCamera, choice: Choice | None = None) -> Aliasing:
    """The size of the texels of `shadow_map` on the screen of `camera`, at the visible surface.

    Differentiable with respect to the surface, the camera and the map's views.

    **Arguments:**

    - `choice`: the layers that the surface is looked up in; by default the light's choice.
    """
    choice = Choice(shadow_map.light.layer(surface.position)) if choice is None else choice
    view, map_view, resolution = camera.view(), shadow_map.view.facing(choice.layer), shadow_map.resolution

    def texel(points: VectorMap) -> TexelMap:
        return project(map_view, resolution, points)[0]

    # Pixels without a surface have no position on the screen.
    points = jnp.where(surface.mask[..., None], surface.position, camera.target)
    to_light = normalize(shadow_map.light.towards(points))
    to_camera = normalize(camera.eye - points) if view.is_perspective else view.world_to_eye[2, :3]
    half_way = normalize(to_light + to_camera)
    at, _, in_front = project(map_view, resolution, points)
    height, width = map_view.shown(resolution)
    inside = (at[..., 0] >= 0) & (at[..., 1] >= 0) & (at[..., 0] <= width) & (at[..., 1] <= height)
    mask = surface.mask & in_front & inside & (dot(surface.normal, to_light) > 0)
    mask = mask if choice.strength is None else mask & (choice.strength > 0)
    normals = jnp.stack([surface.normal, half_way])
    whole, perspective = pixels_per_texel(pixels_of(camera), texel, points, normals)
    return Aliasing(whole, perspective, mask)
