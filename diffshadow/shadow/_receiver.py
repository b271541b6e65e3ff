"""Receivers: the surface points whose visibility is asked for, seen from the light."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._misc import dot, normalize
from .._types import DepthMap, Mask, TexelMap, VectorMap
from ..geometry import View
from ..raster import Surface
from ._map import ShadowMap

# Points nearer to a spot light's plane than this share of its near distance count as behind it.
_BESIDE = 1e-3


class Receiver(eqx.Module):
    """What a bias needs to know of the surface.

    - `position`: (h, w, 3), world units; `normal`: (h, w, 3), unit, geometric.
    - `cosine`: (h, w), of the angle between the normal and the way to the light's centre.
    - `texel`: (h, w), the width of a shadow-map texel there, in world units.
    - `depth_per_texel`: (h, w), how much window depth changes over that length along the light's axis.
    """

    position: VectorMap
    normal: VectorMap
    cosine: Float[Array, "h w"]
    texel: Float[Array, "h w"]
    depth_per_texel: Float[Array, "h w"]


class Lookup(eqx.Module):
    """Where a receiver looks into the map, and what it compares with.

    - `texel`: (h, w, 2), x and y in texels; the centre of the first texel is at (0.5, 0.5).
    - `depth`: (h, w), the receiver's window depth less its bias.
    - `depth_per_texel`: (h, w), window depth per texel's width, the unit of a soft compare.
    - `inside`: (h, w), whether the receiver lies in front of the light and before the far plane.
    """

    texel: TexelMap
    depth: DepthMap
    depth_per_texel: Float[Array, "h w"]
    inside: Bool[Array, "h w"]


def receiver(shadow_map: ShadowMap, surface: Surface) -> Receiver:
    """The surface as the light sees it. Pixels without a surface hold harmless numbers."""
    view = shadow_map.view
    distance = _distance(view, surface)
    texel = view.texel_size(distance, shadow_map.resolution)
    to_light = normalize(shadow_map.light.towards(surface.position))
    return Receiver(
        position=surface.position,
        normal=surface.normal,
        cosine=dot(surface.normal, to_light),
        texel=texel,
        depth_per_texel=texel * view.depth_slope(distance),
    )


def _distance(view: View, surface: Surface) -> Float[Array, "h w"]:
    axis, offset = view.world_to_eye[2, :3], view.world_to_eye[2, 3]
    distance = -(dot(surface.position, axis) + offset)
    # Behind a spot light the answer does not matter, but must not divide by zero.
    return jnp.where(surface.mask, jnp.maximum(distance, view.near) if view.is_perspective else distance, view.far)


def within_frustum(lookup: Lookup, shadow_map: ShadowMap) -> Mask:
    """Whether each receiver looks up a texel of the map, rather than its border."""
    height, width = shadow_map.resolution
    low = jnp.all(lookup.texel >= 0, axis=-1)
    return lookup.inside & low & (lookup.texel[..., 0] <= width) & (lookup.texel[..., 1] <= height)


def look_up(shadow_map: ShadowMap, position: VectorMap, bias: DepthMap, depth_per_texel: DepthMap) -> Lookup:
    """Projects `position` (h, w, 3) by the shadow matrix, and takes `bias` (h, w), in window depth, off its depth."""
    view = shadow_map.view
    clip = view.clip(position)
    w = clip[..., 3:]
    # Beside a spot light the divide overflows; so near to it, nothing casts a shadow.
    before = w > (_BESIDE * view.near if view.is_perspective else 0)
    window = jnp.where(before, clip[..., :3] / jnp.where(before, w, 1), 2.0) * 0.5 + 0.5
    height, width = shadow_map.resolution
    texel = window[..., :2] * jnp.array([width, height], dtype=window.dtype)
    inside = before[..., 0] & (window[..., 2] <= 1)
    return Lookup(texel, window[..., 2] - bias, depth_per_texel, inside)
