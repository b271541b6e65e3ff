"""Babylon.js' shader formulas at a receiver, from a map's texels."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import Scalar
from ._babylon_maps import MAX_EXPONENT

# The upper end of the falloff's step, which avoids a division by 0.
_EDGE = 1.00000012
_PI = 3.1415926


def random_turn(clip: Float[Array, "h w 4"]) -> Float[Array, "h w"]:
    """The pseudo-random angle by which taps are rotated, from the light's clip coordinates."""
    # The engine's x axis is reversed.
    t = 43758.5453 * jnp.sin(12.9898 * -clip[..., 0] + 78.233 * clip[..., 1])
    return _PI * (t - jnp.floor(t))


def exponentially(
    texel: Float[Array, "h w"], metric: Float[Array, "h w"], depth_scale: Scalar, darkness: Scalar, is_close: bool
) -> Float[Array, "h w"]:
    """Visibility from an exponential map, or from a map of the metric if it `is_close`."""
    if is_close:
        return jnp.clip(jnp.exp(jnp.minimum(MAX_EXPONENT, -depth_scale * (metric - texel))), darkness, 1)
    return 1 - jnp.clip(jnp.exp(jnp.minimum(MAX_EXPONENT, depth_scale * metric)) * texel, 0, 1 - darkness)


def falloff(squared: Float[Array, "h w"], width: Scalar) -> Float[Array, "h w"]:
    """The fade of shadows, from 0 to 1, at a squared distance from the map's centre."""
    low = 1 - width
    share = jnp.clip((jnp.clip(squared, 0, 1) - low) / (_EDGE - low), 0, 1)
    return share * share * (3 - 2 * share)
