"""The colours of Babylon.js' maps: depth as a metric, its exponential, and the results of the blurs."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._types import HostArray, Resolution, Scalar
from ...geometry import AbstractLight, PointLight, View
from ._textures import bilinear, rounded

# Digits of numbers in the blur's shader.
_DIGITS = 8
# Larger exponents would overflow a float.
MAX_EXPONENT = 87.0


def metric_in_window(depth: Float[Array, "h w"], view: View) -> Float[Array, "h w"]:
    """(d - n) / (f - n) of window `depth`, where d is the distance along the axis; in a parallel view this is window
    depth itself."""
    if not view.is_perspective:
        return depth
    return view.near * depth / (view.far - depth * (view.far - view.near))


def metric_in_cube(depth: Float[Array, "6 n n"], light: PointLight) -> Float[Array, "6 n n"]:
    """(r + n) / (f + n) of window `depth`, where r is the distance to the light."""
    near, far = light.near, light.far
    return (near * far / (far - depth * (far - near)) * _lengths(depth.shape[-1]) + near) / (far + near)


def depth_of_metric(metric: Float[Array, "*l h w"], light: AbstractLight) -> Float[Array, "*l h w"]:
    """Window depth from a map's `metric`."""
    if isinstance(light, PointLight):
        near, far = light.near, light.far
        distance = (metric * (near + far) - near) / _lengths(metric.shape[-1])
        return far * (distance - near) / ((far - near) * distance)
    view = light.view()
    return metric * view.far / (view.near + metric * (view.far - view.near)) if view.is_perspective else metric


def _lengths(size: int) -> Float[Array, "n n"]:
    """The distance to the centre of each texel of a cube's face, per unit of distance along its axis."""
    across = (jnp.arange(size) + 0.5) * (2 / size) - 1
    return jnp.sqrt(1 + across * across + across[:, None] ** 2)


def exponential(metric: Array, depth_scale: Scalar, is_drawn: Array) -> Array:
    """exp(-k metric), from 0 to 1; 0 where nothing is drawn."""
    return jnp.where(is_drawn, jnp.clip(jnp.exp(-jnp.minimum(MAX_EXPONENT, depth_scale * metric)), 0, 1), 0)


def box_blurred(image: Float[Array, "h w"], size: Resolution, step: Scalar, offset: int) -> Array:
    """The mean of (2 offset + 1)² bilinear taps `step` apart, at each texel of a map of `size`."""
    reach = np.arange(-offset, offset + 1)
    x, y = (part.ravel() for part in np.meshgrid(reach, reach, indexing="ij"))
    share = np.float32(1) / np.float32(x.size)
    # The fragment shader adds the offset.
    place = lambda count, offset: _interpolated(count, 0.0) + offset
    return _blurred(image, size, step, np.stack([x, y], -1), np.ones(x.size), place) * share


def kernel_blurred(
    image: Float[Array, "h w"], size: Resolution, step: Scalar, kernel: float | int, stored: Any
) -> Array:
    """A Gaussian blur along x and then along y; `stored` rounds the result of each pass as a map stores it."""
    places, shares = _gaussian(kernel)
    for axis in np.eye(2):
        # The vertex shader adds the offset.
        image = stored(_blurred(image, size, step, places[:, None] * axis, shares, _interpolated))
    return image


def _blurred(
    image: Array, size: Resolution, step: Scalar, taps: HostArray, shares: HostArray, place: Callable[[int, Any], Array]
) -> Array:
    """The sum of bilinear `taps` (n, 2) times their `shares`, at each texel of a map of `size`.

    `place` gives the coordinates of texels along an axis, moved by an offset.
    """
    height, width = size

    def add(total: Array, tap: tuple[Array, Array]) -> tuple[Array, None]:
        offset, share = rounded(tap[0] * step), tap[1]
        u, v = jnp.broadcast_arrays(place(width, offset[0]), place(height, offset[1])[:, None])
        return total + rounded(share * bilinear(image, u, v, lambda texel: texel)), None

    start = jnp.zeros(size, image.dtype)
    return lax.scan(add, start, (jnp.asarray(taps, start.dtype), jnp.asarray(shares, start.dtype)))[0]


def _interpolated(count: int, offset: Array | float) -> Float[Array, " n"]:
    """The centres of `count` texels moved by `offset`, from 0 to 1, as the rasterizer interpolates them between the
    ends of the map."""
    slope = ((1 + offset) - offset) * (np.float32(1) / np.float32(count))
    return rounded((jnp.arange(count) + 0.5) * slope) + offset


def _gaussian(kernel: float | int) -> tuple[HostArray, HostArray]:
    """Positions, in texels, and shares of the taps, in the engine's order and with its shader's digits.

    Each tap reads two texels of the kernel at once, at a position between them.
    """
    ideal = int(np.floor(kernel + 0.5))
    # The engine's nearest kernel: odd, with an even number of texels on either side of the centre, and at least 3.
    near = (k for k in (ideal, ideal - 1, ideal + 1, ideal - 2, ideal + 2) if k > 0 and k % 2 and k // 2 % 2 == 0)
    count = max(next(near, ideal), 3)
    share = np.exp(-4.5 * (2 * np.arange(count) / (count - 1) - 1) ** 2)
    share /= share.sum()
    centre = (count - 1) // 2
    first, second = share[0:centre:2], share[1 : centre + 1 : 2]
    places = np.arange(0, centre, 2) - centre + second / (first + second)
    # With 3 texels, the centre belongs to both pairs.
    second = second / 2 if centre % 2 else second
    places, shares = np.stack([places, -places], -1).ravel(), np.repeat(first + second, 2)
    if centre % 2 == 0:
        places, shares = np.r_[places, 0], np.r_[shares, share[centre]]
    return places.round(_DIGITS), shares.round(_DIGITS)
