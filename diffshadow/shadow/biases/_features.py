"""The values that a bias may depend on, in JAX and in a shader."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import safe_norm, safe_sqrt
from .._receiver import Receiver

# Blockers farther away than this count as at this distance, in texels.
_MAX_TEXELS = 16.0


class Feature(NamedTuple):
    """A number that a shader knows about a receiver.

    - `of`: its value (h, w), at least 0.
    - `unit`: unit of the value.
    - `shader`: the same number as a shader expression in terms of `at`, a `ShadowReceiver`.
    """

    of: Callable[[Receiver], Float[Array, "h w"]]
    unit: str
    shader: str


def _sine(receiver: Receiver) -> Float[Array, "h w"]:
    cosine = jnp.clip(receiver.cosine, 0, 1)
    return safe_sqrt(1 - cosine * cosine)


def _blocker_distance(receiver: Receiver) -> Float[Array, "h w"]:
    return jnp.clip((receiver.depth - receiver.stored) / receiver.depth_per_texel, 0, _MAX_TEXELS)


_COSINE = "clamp(at.cosine, 0.0, 1.0)"
FEATURES = {
    "one": Feature(lambda at: jnp.ones_like(at.cosine), "", "1.0"),
    # With square texels and a directional light, the tangent of the angle to the light.
    "slope": Feature(lambda at: safe_norm(at.slope), "texels per texel", "length(at.slope)"),
    "sine": Feature(_sine, "", f"sqrt(1.0 - {_COSINE} * {_COSINE})"),
    "one_minus_cosine": Feature(lambda at: 1 - jnp.clip(at.cosine, 0, 1), "", f"1.0 - {_COSINE}"),
    "texel_size": Feature(
        lambda at: 100 * at.texel_size / at.depth_range,
        "percent of the map's depth range",
        "100.0 * at.texel_size / at.depth_range",
    ),
    "distance": Feature(
        lambda at: jnp.clip(at.distance, 0, 1), "parts of the map's depth range", "clamp(at.light_distance, 0.0, 1.0)"
    ),
    "blocker_distance": Feature(
        _blocker_distance, "texels", f"clamp((at.depth - at.stored) / at.depth_per_texel, 0.0, {_MAX_TEXELS})"
    ),
}
"""Each feature by its name. None depends on the scene's scale."""
