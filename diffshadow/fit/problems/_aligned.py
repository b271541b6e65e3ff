"""Screens whose pixels coincide with the texels of a light's map, for example a screen that faces the sun.

With a bilinear look-up without a bias, each pixel's visibility is then the mean over one texel. It needs no filter,
which would be half of a step's work and of its compiled program.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..._types import DepthMap, Mask, Visibility
from ...shadow import Bilinear, ConstantBias, HardCompare, ShadowMap, ShadowMapping

# The maximum distance between a pixel's centre and its texel's centre, in texels.
_SAME_PLACE = 1e-3


class Receivers(eqx.Module):
    """The points of a screen, as the light sees them.

    - `depth`: (h, w), window depth; `active`: (h, w), whether it is compared with the map.
    - `otherwise`: (h, w), visibility of pixels that are not compared.
    - `off`: (), the distance between pixels and the texels with the same indices, in texels.

    Arrays of several views have a first axis for the views.
    """

    depth: DepthMap
    active: Mask
    otherwise: Visibility
    off: Float[Array, ""]

    @classmethod
    def of(cls, clip: Float[Array, "h w 4"], mask: Mask, is_turned: Mask) -> "Receivers":
        """The receivers at the pixels of a screen.

        **Arguments:**

        - `clip`: clip coordinates in the light's view; `mask`: where there is a surface; `is_turned`: whether the
          surface faces the light.
        """
        height, width = mask.shape
        x, y, depth = (clip[..., axis] / clip[..., 3] * 0.5 + 0.5 for axis in range(3))
        column, row = jnp.arange(width) + 0.5, jnp.arange(height)[:, None] + 0.5
        off = jnp.maximum(jnp.abs(x * width - column), jnp.abs(y * height - row))
        active = mask & is_turned & (clip[..., 3] > 0) & (depth <= 1)
        otherwise = jnp.where(mask & ~is_turned, 0.0, 1.0).astype(depth.dtype)
        return cls(depth, active, otherwise, jnp.max(jnp.where(active, off, 0)))

    def seen(self, shadow_map: ShadowMap) -> Visibility:
        """Their visibility, (h, w)."""
        assert shadow_map.silhouettes is not None
        part, *depths = shadow_map.silhouettes.by_texel(shadow_map.depth)
        inside, outside = (HardCompare()(stored, self.depth, self.depth) for stored in lax.stop_gradient(depths))
        return jnp.where(self.active, outside + part * (inside - outside), self.otherwise)


def may_be_aligned(technique: ShadowMapping) -> bool:
    """Whether a look-up at a texel's centre is the mean over the texel."""
    is_plain = isinstance(technique.filter, Bilinear) and technique.compare == HardCompare()
    is_unbiased = isinstance(technique.bias, ConstantBias) and float(technique.bias.value) == 0
    return is_plain and is_unbiased and technique.map.depth_format == "float32"


def are_aligned(receivers: Receivers, technique: ShadowMapping) -> bool:
    """Whether the pixels of several views coincide with the texels of their maps."""
    same_size = receivers.depth.shape[-2:] == tuple(technique.map.resolution)
    return same_size and float(np.max(receivers.off)) < _SAME_PLACE
