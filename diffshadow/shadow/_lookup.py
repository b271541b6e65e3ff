"""Look-ups: where receivers look into the map once they are biased, and what they compare with."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._types import DepthMap, Mask, TexelMap
from ._map import ShadowMap
from ._receiver import Receiver, project
from .biases import BiasTerms


class Lookup(eqx.Module):
    """Where a receiver looks into the map, and what it compares with.

    - `texel`: (h, w, 2), x and y in texels; the centre of the first texel is at (0.5, 0.5).
    - `depth`: (h, w), the receiver's window depth less its bias.
    - `depth_per_texel`: (h, w), window depth per texel's width, the unit of a soft compare.
    - `inside`: (h, w), whether the receiver lies in front of the light and before the far plane.
    - `slope`: (h, w, 2), window depth per texel along x and y, by which each tap's depth follows the receiver's plane
        to the centre of its texel; none where all taps compare with the one depth.
    - `layer`: (h, w), which of the light's maps is looked into; none where there is but one.
    - `deepest`: (h, w), the window depth at which a plane that taps follow is cut off; none for nowhere.
    """

    texel: TexelMap
    depth: DepthMap
    depth_per_texel: Float[Array, "h w"]
    inside: Bool[Array, "h w"]
    slope: TexelMap | None = None
    layer: Int[Array, "h w"] | None = None
    deepest: DepthMap | None = None


def look_up(shadow_map: ShadowMap, at: Receiver, terms: BiasTerms) -> Lookup:
    """Where receivers look up under a bias."""
    texel, depth, in_front = at.texel, at.depth, at.in_front
    if terms.displacement is not None:
        texel, depth, in_front = project(shadow_map, at.position + terms.displacement, at.layer)
    inside = in_front & (depth <= 1)
    depth = depth - terms.depth
    slope = deepest = None
    if terms.follows_plane:
        slope = at.slope * at.depth_per_texel[..., None]
        deepest = None if terms.deepening is None else depth + terms.deepening
    if shadow_map.depth_format != "float32":
        # Fixed-point maps are compared with what they could hold (OpenGL 4.6, section 8.23.1).
        if slope is None:
            depth = jnp.clip(depth, 0, 1)
        else:
            deepest = jnp.ones_like(depth) if deepest is None else jnp.minimum(deepest, 1)
    return Lookup(texel, depth, at.depth_per_texel, inside, slope, at.layer, deepest)


def within_frustum(lookup: Lookup, shadow_map: ShadowMap) -> Mask:
    """Whether each receiver looks up a texel of the map, rather than its border."""
    height, width = shadow_map.resolution
    low = jnp.all(lookup.texel >= 0, axis=-1)
    return lookup.inside & low & (lookup.texel[..., 0] <= width) & (lookup.texel[..., 1] <= height)
