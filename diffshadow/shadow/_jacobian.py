"""The motion of surface points on the screen and in a shadow map, and the relation of both."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arithmetic import safe_divide, safe_norm
from .._types import TexelMap, VectorMap
from ..geometry import AbstractCamera, tangents

Jacobian = Float[Array, "h w 2 2"]


def pixels_of(camera: AbstractCamera) -> Callable[[VectorMap], TexelMap]:
    """A function that maps world points (h, w, 3) to their positions on the screen of `camera`, in pixels."""
    view, resolution = camera.view(), camera.resolution

    def pixel(points: VectorMap) -> TexelMap:
        clip = view.clip(points)
        inverse = safe_divide(jnp.ones_like(clip[..., 3]), clip[..., 3])
        window = clip[..., :2] * inverse[..., None] * 0.5 + 0.5
        return window * jnp.array(resolution[::-1], window.dtype)

    return pixel


def pixels_per_texel(
    pixel: Callable[[VectorMap], TexelMap],
    texel: Callable[[VectorMap], TexelMap],
    points: VectorMap,
    normals: Float[Array, "k h w 3"],
) -> Float[Array, "k h w 2 2"]:
    """The motion of surface points on the screen, in pixels along x and y (rows), if they move by one texel along a
    map's x and y (columns). 0 where the map sees the surface edge-on.

    **Arguments:**

    - `pixel`, `texel`: functions from world points (h, w, 3) to positions on the screen and in the map, (h, w, 2).
    - `points`: (h, w, 3); `normals`: the normals of each of k surfaces through these points.
    """
    ways = jnp.stack(tangents(normals))
    moved = lambda project: jax.vmap(jax.vmap(lambda way: jax.jvp(project, (points,), (way,))[1]))(ways)
    # Axes: the tangent, the normal, then (h, w, 2).
    pixels, texels = (jnp.moveaxis(moved(project), 0, -1) for project in (pixel, texel))
    return _divided(pixels, texels)


def _divided(numerator: Float[Array, "*n 2 2"], denominator: Float[Array, "*n 2 2"]) -> Float[Array, "*n 2 2"]:
    """B A⁻¹, or 0 where A is singular."""
    a, b, c, d = (denominator[..., i, j] for i in range(2) for j in range(2))
    adjugate = jnp.stack([jnp.stack([d, -b], axis=-1), jnp.stack([-c, a], axis=-1)], axis=-2)
    product = jnp.sum(numerator[..., :, :, None] * adjugate[..., None, :, :], axis=-2)
    inverse = determinant(denominator)
    return product * safe_divide(jnp.ones_like(inverse), inverse)[..., None, None]


def determinant(matrix: Float[Array, "*n 2 2"]) -> Float[Array, "*n"]:
    return matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]


def singular_values(matrix: Jacobian) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """The greater and the smaller singular value."""
    a, b, c, d = (matrix[..., i, j] for i in range(2) for j in range(2))
    turning = safe_norm(jnp.stack([a + d, b - c], axis=-1))
    mirroring = safe_norm(jnp.stack([a - d, b + c], axis=-1))
    return (turning + mirroring) / 2, jnp.abs(turning - mirroring) / 2
