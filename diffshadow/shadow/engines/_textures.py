"""Texture look-ups as in graphics hardware: nearest and bilinear texels, clamped to the edge, and cube maps."""

from collections.abc import Callable
from functools import cache

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import with_gradient_of
from ..._types import HostArray
from ._engine_map import CUBE, rounded

Of = Callable[[Float[Array, "*n"]], Float[Array, "*n"]]
"""The function of each texel's value that is averaged over texels."""


def as_half(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """`x` rounded as in a texture of half floats, with the derivative of `x`.

    For subnormal numbers, the software rasterizer keeps 13 more bits, and then rounds them. A number just beyond the
    middle of two neighbours is therefore rounded to the even neighbour.
    """
    # XLA may omit a conversion to half floats and back. Its `reduce_precision` does not handle subnormal numbers.
    subnormal = jnp.round(jnp.trunc(x * 2.0**37) * 2.0**-13) * 2.0**-24
    return with_gradient_of(x, jnp.where(jnp.abs(x) < 2.0**-14, subnormal, lax.reduce_precision(x, 5, 10)))


def nearest(texture: Float[Array, "h w"], u: Float[Array, "*n"], v: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The texel at (u, v), from 0 to 1 over the texture."""
    height, width = texture.shape
    whole = lambda at, size: jnp.clip(jnp.floor(at * size).astype(jnp.int32), 0, size - 1)
    return texture[whole(v, height), whole(u, width)]


def bilinear(texture: Float[Array, "h w"], u: Float[Array, "*n"], v: Float[Array, "*n"], of: Of) -> Float[Array, "*n"]:
    """The bilinear mean of the function `of` at the four texels around (u, v), from 0 to 1 over the texture."""
    height, width = texture.shape
    read = lambda x, y: texture[jnp.clip(y, 0, height - 1), jnp.clip(x, 0, width - 1)]
    return _of_four(u * width, v * height, read, of)


def _of_four(
    x: Float[Array, "*n"], y: Float[Array, "*n"], read: Callable[[Array, Array], Array], of: Of
) -> Float[Array, "*n"]:
    """The bilinear mean at (x, y), in texels."""
    left, below = (jnp.floor(lax.stop_gradient(at) - 0.5) for at in (x, y))
    column, row = left.astype(jnp.int32), below.astype(jnp.int32)
    across, up = x - 0.5 - left, y - 0.5 - below
    in_row = lambda k: mix(of(read(column, row + k)), of(read(column + 1, row + k)), across)
    # A loop, so that `of` is compiled less often.
    rows = lax.map(in_row, jnp.arange(2, dtype=jnp.int32))
    return mix(rows[0], rows[1], up)


def mix(low: Array, high: Array, share: Array) -> Array:
    """Interpolates between two values like the software rasterizer. Equal values give the same value to the bit."""
    return low + rounded(share * (high - low))


def place_in_cube(
    towards: Float[Array, "*n 3"],
) -> tuple[Int[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]:
    """The cube map face in a direction, the position (s, t) on it from 0 to 1, and the direction's length along the
    face's axis."""
    axis = jnp.argmax(jnp.abs(lax.stop_gradient(towards)), axis=-1)
    major = jnp.take_along_axis(towards, axis[..., None], axis=-1)[..., 0]
    face = (2 * axis + (major < 0)).astype(jnp.int32)
    along = jnp.abs(major)
    s, t = (jnp.sum(jnp.asarray(CUBE[:, k])[face] * towards, axis=-1) / along / 2 + 0.5 for k in (0, 1))
    return face, s, t, along


def nearest_in_cube(cube: Float[Array, "6 n n"], towards: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """The texel in a direction."""
    face, s, t, _ = place_in_cube(towards)
    size = cube.shape[-1]
    whole = lambda at: jnp.clip(jnp.floor(at * size).astype(jnp.int32), 0, size - 1)
    return cube[face, whole(t), whole(s)]


def with_borders(cube: Float[Array, "6 n n"]) -> Float[Array, "6 m m"]:
    """Each face with a border of its neighbours' texels."""
    return cube.reshape(-1)[_neighbours(cube.shape[-1])]


def bilinear_in_cube(bordered: Float[Array, "6 m m"], towards: Float[Array, "*n 3"], of: Of) -> Float[Array, "*n"]:
    """The bilinear mean of the function `of` at the four texels around a direction, across the edges of faces.
    `bordered` is the result of `with_borders`."""
    face, s, t, _ = place_in_cube(towards)
    size = bordered.shape[-1] - 2
    read = lambda x, y: bordered[face, jnp.clip(y, -1, size) + 1, jnp.clip(x, -1, size) + 1]
    return _of_four(s * size, t * size, read, of)


@cache
def _neighbours(size: int) -> HostArray:
    """(6, n + 2, n + 2), the index among all texels of each texel of a face with borders."""
    # Slightly beyond the edge, so that the position along the edge does not change.
    at = np.clip(np.arange(-1, size + 1) + 0.5, -1e-4, size + 1e-4) * 2 / size - 1
    t, s = np.meshgrid(at, at, indexing="ij")
    right, up, forward = np.moveaxis(CUBE.astype(np.float64), 1, 0)[:, :, None, None]
    towards = s[..., None] * right + t[..., None] * up + forward
    axis = np.abs(towards).argmax(axis=-1)
    face = 2 * axis + (np.take_along_axis(towards, axis[..., None], -1)[..., 0] < 0)
    along = np.abs(towards).max(axis=-1)
    place = lambda k: (CUBE[face, k] * towards).sum(axis=-1) / along / 2 + 0.5
    x, y = (np.clip(np.floor(place(k) * size), 0, size - 1).astype(np.int32) for k in (0, 1))
    # int32 also in double precision, so that programs cached for one precision suit the other.
    return ((face * size + y) * size + x).astype(np.int32)
