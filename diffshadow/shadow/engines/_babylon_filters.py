"""What Babylon.js' shaders compute at a receiver from a map's texels."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..._arithmetic import as_float
from ..._types import HostArray, Scalar
from ...settings.engines import BabylonQuality
from ._babylon_maps import MAX_EXPONENT
from ._textures import bilinear

Compared = Callable[[Array], Array]
"""What the compare with the receiver gives, of each stored value."""

# The greater end of the falloff's step, which keeps it from dividing by 0.
_EDGE = 1.00000012
_PI = 3.1415926


def same(x: Array) -> Array:
    return x


def mean_of(tap: Compared, taps: HostArray, shape: tuple[int, ...]) -> Array:
    """The mean of `tap` over `taps` (n, d), whose results are of `shape`."""
    add = lambda total, at: (total + tap(at), None)
    return lax.scan(add, jnp.zeros(shape), as_float(taps))[0] / len(taps)


def tent(
    depth: Float[Array, "m m"],
    u: Float[Array, "h w"],
    v: Float[Array, "h w"],
    compared: Compared,
    quality: BabylonQuality,
) -> Float[Array, "h w"]:
    """The mean under a tent, of 1, 4 or 9 bilinear compares (Castaño, "Shadow mapping summary", 2013)."""
    if quality == "LOW":
        return bilinear(depth, u, v, compared)
    size = depth.shape[-1]
    (weights_x, places_x), (weights_y, places_y) = (_tent_taps(at * size + 0.5, quality) for at in (u, v))
    count = len(weights_x)

    def add(total: Array, k: Array) -> tuple[Array, None]:
        i, j = k % count, k // count
        tap = bilinear(depth, places_x[i] / size, places_y[j] / size, compared)
        return total + weights_x[i] * weights_y[j] * tap, None

    total = lax.scan(add, jnp.zeros_like(u), jnp.arange(count * count, dtype=jnp.int32))[0]
    return total / (16 if quality == "MEDIUM" else 144)


def _tent_taps(at: Float[Array, "h w"], quality: BabylonQuality) -> tuple[Float[Array, "k h w"], Float[Array, "k h w"]]:
    """Weights and places, in texels, of the taps along one axis."""
    whole = jnp.floor(lax.stop_gradient(at))
    s = at - whole
    if quality == "MEDIUM":
        weights = [3 - 2 * s, 1 + 2 * s]
        offsets = [(2 - s) / weights[0] - 1, s / weights[1] + 1]
    else:
        weights = [4 - 3 * s, jnp.full_like(s, 7), 1 + 3 * s]
        offsets = [(3 - 2 * s) / weights[0] - 2, (3 + s) / 7, s / weights[2] + 2]
    return jnp.stack(weights), jnp.stack([whole - 0.5 + offset for offset in offsets])


def random_turn(clip: Float[Array, "h w 4"]) -> Float[Array, "h w"]:
    """The angle by which taps are turned at clip coordinates of the light, pseudo-random."""
    # The engine's x runs the other way.
    t = 43758.5453 * jnp.sin(12.9898 * -clip[..., 0] + 78.233 * clip[..., 1])
    return _PI * (t - jnp.floor(t))


def exponentially(
    texel: Float[Array, "h w"], metric: Float[Array, "h w"], depth_scale: Scalar, darkness: Scalar, is_close: bool
) -> Float[Array, "h w"]:
    """Visibility from an exponential map; or, if it `is_close`, from a map of the metric."""
    if is_close:
        return jnp.clip(jnp.exp(jnp.minimum(MAX_EXPONENT, -depth_scale * (metric - texel))), darkness, 1)
    return 1 - jnp.clip(jnp.exp(jnp.minimum(MAX_EXPONENT, depth_scale * metric)) * texel, 0, 1 - darkness)


def falloff(squared: Float[Array, "h w"], width: Scalar) -> Float[Array, "h w"]:
    """How far shadows have faded out, from 0 to 1, at a squared distance from the map's centre."""
    low = 1 - width
    share = jnp.clip((jnp.clip(squared, 0, 1) - low) / (_EDGE - low), 0, 1)
    return share * share * (3 - 2 * share)
