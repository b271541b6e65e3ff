"""The variance shadow maps of three.js, to the bit as Chromium draws them without graphics hardware.

The engine stores E[d] and the square root of E[d²] - E[d]². The difference cancels most digits of both, so earlier
rounding matters. The software rasterizer (SwiftShader) rounds every product and every sum separately, multiplies by the
reciprocal of the number of samples, and interpolates by `a + t (b - a)`, with weights in single precision. Graphics
hardware may fuse a product with a sum, and has weights of eight bits.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_float, safe_sqrt
from ..._types import HostArray
from ._textures import as_half, mix, rounded

_MIN_VARIANCE = 1e-7
# Light bleeding below this bound is cut off.
_BLEEDING = 0.3
_FULL = 0.95

Moments = tuple[Float[Array, "h w"], Float[Array, "h w"]]
"""Mean and standard deviation of depth in each texel."""


def blurred(depth: Float[Array, "h w"], radius: Array, samples: int) -> Moments:
    """Mean and standard deviation of depth over a box: nearest texels along columns, then bilinear texels along rows.

    Both are rounded to half floats after each pass.

    **Arguments:**

    - `radius`: radius of the box, in texels; its ends are samples.
    """
    height, width = depth.shape
    offsets, zeros = as_float(_offsets(samples)), (jnp.zeros_like(depth), jnp.zeros_like(depth))
    squares = rounded(depth * depth)

    def along_column(sums: Moments, offset: Array) -> tuple[Moments, None]:
        row = _in_texels(_centres(height, radius * offset), height).astype(jnp.int32)
        return (sums[0] + depth[row], sums[1] + squares[row]), None

    vertical = _as_stored(*lax.scan(along_column, zeros, offsets)[0], samples)

    def along_row(sums: Moments, offset: Array) -> tuple[Moments, None]:
        columns = _between(_centres(width, radius * offset), width)
        mean, deviation = (_in_own_row(_mixed(part, columns)) for part in vertical)
        square = rounded(deviation * deviation) + rounded(mean * mean)
        return (sums[0] + mean, sums[1] + square), None

    return _as_stored(*lax.scan(along_row, zeros, offsets)[0], samples)


def at_receivers(
    moments: Moments, u: Float[Array, "*n"], v: Float[Array, "*n"]
) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """The bilinear moments at (u, v), from 0 to 1 over the map."""
    height, width = moments[0].shape
    columns, rows = _between(u, width), _between(v, height)
    mean, deviation = (_mixed_between(part, columns, rows) for part in moments)
    return mean, deviation


def chebyshev(mean: Array, deviation: Array, z: Array) -> Array:
    """The upper bound on visibility (Donnelly & Lauritzen 2006), cut off at its lower end to reduce light bleeding."""
    variance = jnp.maximum(deviation * deviation, _MIN_VARIANCE)
    bound = variance / (variance + (z - mean) ** 2)
    return jnp.clip((bound - _BLEEDING) / (_FULL - _BLEEDING), 0, 1)


# --- Positions in textures ---


class _Between(NamedTuple):
    """The two texels around a position, and the second one's share."""

    low: Int[Array, "*n"]
    high: Int[Array, "*n"]
    share: Float[Array, "*n"]


def _offsets(samples: int) -> HostArray:
    """Positions of the samples, from -1 to 1, with the additions of the shader."""
    if samples == 1:
        return np.zeros(1, np.float32)
    return np.float32(-1) + np.arange(samples, dtype=np.float32) * (np.float32(2) / np.float32(samples - 1))


def _centres(size: int, offset: Array | float) -> Float[Array, " n"]:
    """The centres of `size` texels, moved by `offset` texels, from 0 to 1 over the texture."""
    moved = jnp.arange(size) + 0.5 + rounded(as_float(offset))
    # A division by a scalar would become a multiplication by its reciprocal.
    return moved / jnp.where(moved == moved, size, moved)


def _in_texels(place: Float[Array, "*n"], size: int) -> Float[Array, "*n"]:
    """A position from 0 to 1, converted to texels and clamped to less than `size`."""
    return rounded(jnp.clip(place, 0, 1 - jnp.finfo(place.dtype).eps / 2) * size)


def _between(place: Float[Array, "*n"], size: int) -> _Between:
    """`place` from 0 to 1 among `size` texels."""
    at = _in_texels(place, size) - 0.5
    low = jnp.floor(lax.stop_gradient(at))
    index = low.astype(jnp.int32)
    return _Between(jnp.maximum(index, 0), jnp.minimum(index + 1, size - 1), at - low)


def _mixed(part: Float[Array, "h w"], columns: _Between) -> Float[Array, "h w"]:
    """Each row, interpolated between the two columns."""
    return mix(part[:, columns.low], part[:, columns.high], columns.share)


def _in_own_row(part: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Each row, read at its own centre. Rounding moves the centre unless the number of rows is a power of two."""
    size = part.shape[0]
    if size & (size - 1) == 0:
        return part
    rows = _between(_centres(size, 0.0), size)
    return mix(part[rows.low], part[rows.high], rows.share[:, None])


def _mixed_between(part: Float[Array, "h w"], columns: _Between, rows: _Between) -> Float[Array, "*n"]:
    at = lambda row: mix(part[row, columns.low], part[row, columns.high], columns.share)
    return mix(at(rows.low), at(rows.high), rows.share)


# --- Rounding ---


def _as_stored(total: Array, squares: Array, samples: int) -> Moments:
    """Mean and standard deviation of sums over `samples`, in half floats."""
    share = as_float(np.float32(1) / np.float32(samples))
    mean, square = total * share, rounded(squares * share)
    return as_half(mean), as_half(safe_sqrt(square - rounded(mean * mean)))
