"""What a bias may depend on, in JAX and in GLSL."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import safe_norm, safe_sqrt
from .._receiver import Receiver

# Blockers farther away than this count as this far away, in texels.
_MAX_TEXELS = 16.0


class Feature(NamedTuple):
    """A number that a shader knows of a receiver.

    - `of`: its value (h, w), at least 0.
    - `unit`: of the value.
    - `glsl`: the same as an expression of `GLSL_INPUTS`.
    """

    of: Callable[[Receiver], Float[Array, "h w"]]
    unit: str
    glsl: str


GLSL_INPUTS = {
    "slope": ("vec2", "the receiver plane's change of depth per texel along the map's x and y, in texels' widths"),
    "cosine": ("float", "of the angle between the receiver's normal and the direction to the light"),
    "texel_size": ("float", "width of a texel at the receiver, in percent of the map's depth range, far - near"),
    "light_distance": ("float", "along the light's axis, 0 at the map's near plane and 1 at its far plane"),
    "blocker_distance": (
        "float",
        "receiver's depth less the map's depth at the receiver's own texel, along the light's axis, in texels' widths",
    ),
}
"""Type and meaning of each argument of the exported `shadow_bias`, in order."""


def _sine(receiver: Receiver) -> Float[Array, "h w"]:
    cosine = jnp.clip(receiver.cosine, 0, 1)
    return safe_sqrt(1 - cosine * cosine)


def _blocker_distance(receiver: Receiver) -> Float[Array, "h w"]:
    return jnp.clip((receiver.depth - receiver.stored) / receiver.depth_per_texel, 0, _MAX_TEXELS)


_COSINE = "clamp(cosine, 0.0, 1.0)"
FEATURES = {
    "one": Feature(lambda at: jnp.ones_like(at.cosine), "", "1.0"),
    # With square texels and a directional light, the tangent of the angle to the light.
    "slope": Feature(lambda at: safe_norm(at.slope), "texels per texel", "length(slope)"),
    "sine": Feature(_sine, "", f"sqrt(1.0 - {_COSINE} * {_COSINE})"),
    "one_minus_cosine": Feature(lambda at: 1 - jnp.clip(at.cosine, 0, 1), "", f"1.0 - {_COSINE}"),
    "texel_size": Feature(
        lambda at: 100 * at.texel_size / at.depth_range, "percent of the map's depth range", "texel_size"
    ),
    "distance": Feature(
        lambda at: jnp.clip(at.distance, 0, 1), "parts of the map's depth range", "clamp(light_distance, 0.0, 1.0)"
    ),
    "blocker_distance": Feature(_blocker_distance, "texels", f"clamp(blocker_distance, 0.0, {_MAX_TEXELS})"),
}
"""Each feature by its name. None depends on the scene's scale."""
