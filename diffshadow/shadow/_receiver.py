"""Receivers: the shaded surface points, as the light sees them.

A camera's image of points (h, w, 3), in world units, is projected into the light's view. Each point gets a position in
the map (h, w, 2), in texels, with the centre of the first texel at (0.5, 0.5), a window depth (h, w), in [0, 1] within
the light's depth range, and a layer (h, w) if the map has several. It also gets the inputs of a bias: the cosine to the
light, the width of a texel in world units, and the receiver plane's depth slope in the map, (h, w, 2). Pixels without a
surface have finite dummy values.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import as_float, dot, normalize, safe_norm, take
from .._types import DepthMap, Mask, Resolution, Scalar, TexelMap, VectorMap
from ..geometry import View, transform_points, transform_vectors
from ..raster import DepthTest, Surface
from ..settings.maps import DepthFormat
from ._map import ShadowMap

# Points closer to the light's plane than this fraction of its near distance count as behind it.
_BESIDE = 1e-3
# Slopes are clamped to this value (89.4°), because grazing light would need an infinite bias.
_MAX_SLOPE = 100.0
# Positions, normals and stored depths are each rounded a few times. The measured sum is 3 units in the last place, or 8
# if triangles are a hundred times as wide as the map.
_ROUNDINGS = 8


class Receiver(eqx.Module):
    """The surface as the light sees it: the input of a bias.

    - `position`: (h, w, 3), world units; `normal`: (h, w, 3), unit, geometric.
    - `cosine`: (h, w), cosine of the angle between the normal and the direction to the light's centre.
    - `texel`: (h, w, 2), its position in the map, x and y in texels; `depth`: (h, w), its window depth.
    - `in_front`: (h, w), whether it is in front of the light.
    - `texel_size`: (h, w), width of a shadow-map texel there, in world units.
    - `depth_per_texel`: (h, w), change of window depth over that length along the light's axis.
    - `slope`: (h, w, 2), the receiver plane's depth slope along the map's x and y, in texel widths per texel.
    - `rounding`: (h, w), bound on the rounding error between the map's depth and the receiver's depth (or the depth of
        the receiver's plane under a kernel), in window depth.
    - `distance`: (h, w), distance along the light's axis, 0 at the map's near plane and 1 at its far plane;
        `depth_range`: the distance between these planes, in world units.
    - `stored`: (h, w), the map's window depth at its texel; 1 beyond the map.
    - `layer`: (h, w), the index of its map; `None` if the light has only one map.
    """

    position: VectorMap
    normal: VectorMap
    cosine: Float[Array, "h w"]
    texel: TexelMap
    depth: DepthMap
    in_front: Bool[Array, "h w"]
    texel_size: Float[Array, "h w"]
    depth_per_texel: Float[Array, "h w"]
    slope: TexelMap
    rounding: Float[Array, "h w"]
    distance: Float[Array, "h w"]
    depth_range: Scalar
    stored: DepthMap
    layer: Int[Array, "h w"] | None


def receiver(shadow_map: ShadowMap, surface: Surface, layer: Int[Array, "h w"] | None = None) -> Receiver:
    """The surface as the light sees it. Pixels without a surface have finite dummy values.

    **Arguments:**

    - `layer`: (h, w), the index of each point's map; by default from the light's `layer`.
    """
    layer = shadow_map.light.layer(surface.position) if layer is None else layer
    view = shadow_map.view.facing(layer)
    eye = transform_points(view.world_to_eye, surface.position)[..., :3]
    # Behind a spot light, the result is unused, but must not divide by zero.
    ahead = jnp.maximum(-eye[..., 2], view.near) if view.is_perspective else -eye[..., 2]
    distance = jnp.where(surface.mask, ahead, view.far)
    texel, depth, in_front = project(view, shadow_map.resolution, surface.position)
    extent = view.texel_extent(distance, shadow_map.resolution, texel)
    texel_size = view.texel_size(distance, shadow_map.resolution, texel)
    depth_per_texel = texel_size * view.depth_slope(distance)
    slope = _slope(shadow_map, view, eye, distance, surface.normal, texel, extent, texel_size)
    return Receiver(
        position=surface.position,
        normal=surface.normal,
        cosine=dot(surface.normal, normalize(shadow_map.light.towards(surface.position))),
        texel=texel,
        depth=depth,
        in_front=in_front,
        texel_size=texel_size,
        depth_per_texel=depth_per_texel,
        slope=slope,
        rounding=_rounding(shadow_map, view, eye, distance, surface.position, texel_size, slope),
        distance=(distance - view.near) / (view.far - view.near),
        depth_range=view.far - view.near,
        stored=_stored(shadow_map, texel, layer),
        layer=layer,
    )


def is_in_front(view: View, w: Float[Array, "*n"]) -> Bool[Array, "*n"]:
    """Whether points are in front of the light, according to `w` of their clip coordinates.

    Points in the plane of a spot light do not count as in front, because the divide overflows there. Nothing so close
    to the light casts a shadow.
    """
    return w > (_BESIDE * view.near if view.is_perspective else 0)


def project(view: View, resolution: Resolution, position: VectorMap) -> tuple[TexelMap, DepthMap, Mask]:
    """Projects `position` (h, w, 3) into a map of this `resolution`: texel, window depth, and whether it is in front of
    the light."""
    clip = view.clip(position)
    w = clip[..., 3]
    in_front = is_in_front(view, w)
    window = lambda axis: jnp.where(in_front, clip[..., axis] / jnp.where(in_front, w, 1), 2.0) * 0.5 + 0.5
    height, width = view.whole(resolution)
    depth = window(2) if view.warp is None else view.unwarped.clip(position)[..., 2] * 0.5 + 0.5
    x, y = window(0) * width, window(1) * height
    if view.tile is not None:
        x, y = x - view.tile.origin[..., 0], y - view.tile.origin[..., 1]
    # One coordinate at a time, because XLA elides a stack that is taken apart again.
    return jnp.stack([x, y], axis=-1), depth, in_front


def _slope(
    shadow_map: ShadowMap,
    view: View,
    eye: VectorMap,
    distance: Float[Array, "h w"],
    normal: VectorMap,
    texel: TexelMap,
    extent: Float[Array, "h w 2"],
    texel_size: Float[Array, "h w"],
) -> TexelMap:
    """The receiver planes' depth slope per texel along the map's x and y, in units of `texel_size`.

    It is `n_xy / -(n · r)`, with `n` the plane's normal and `r` the ray through the point per unit of distance along
    the axis, both in eye space. This is valid for perspective and parallel rays, because window depth is linear in the
    window over a plane. In a warped map, it is linear to first order.
    """
    n = transform_vectors(view.world_to_eye, normal)
    along = eye / distance[..., None] if view.is_perspective else jnp.array([0.0, 0.0, -1.0])
    facing = dot(n, jnp.broadcast_to(along, n.shape))
    across = n[..., :2]
    least = jnp.maximum(safe_norm(across) / _MAX_SLOPE, 1e-12)
    facing = jnp.where(jnp.abs(facing) > least, facing, jnp.where(facing < 0, -least, least))
    across = view.along_axes(across, texel, shadow_map.resolution)
    return jnp.stack([-across[..., i] / facing * extent[..., i] / texel_size for i in range(2)], axis=-1)


def _rounding(
    shadow_map: ShadowMap,
    view: View,
    eye: VectorMap,
    distance: Float[Array, "h w"],
    position: VectorMap,
    texel_size: Float[Array, "h w"],
    slope: TexelMap,
) -> Float[Array, "h w"]:
    """Bound on the rounding error of the receiver plane's depth, under a kernel as wide as the map.

    Coordinates and points of the plane have a relative error. An error across the plane becomes an error of depth that
    grows with the plane's slope. A fixed-point map adds half a step.
    """
    position, eye, distance, texel_size, slope = lax.stop_gradient((position, eye, distance, texel_size, slope))
    size = lambda x: jnp.max(jnp.abs(x), axis=-1)
    reach = size(position) + size(eye) + jnp.maximum(*view.whole(shadow_map.resolution)) * texel_size
    steepness = jnp.sqrt(1 + jnp.sum(slope * slope, axis=-1))
    unit = jnp.finfo(jnp.float32).eps
    rounding = _ROUNDINGS * unit * (1 + view.depth_slope(distance) * reach * steepness)
    return rounding + half_step(shadow_map.depth_format)


def half_step(depth_format: DepthFormat) -> Float[Array, ""]:
    """Half the difference of two neighbouring depths in a map of this format; 0 for floating point."""
    return as_float(0) if depth_format == "float32" else DepthTest(depth_format).decode(as_float(0.5))


def _stored(shadow_map: ShadowMap, texel: TexelMap, layer: Int[Array, "h w"] | None) -> DepthMap:
    """The depth stored in the texel (h, w, 2) of each point; 1 beyond the map."""
    height, width = shadow_map.resolution
    x, y = (jnp.floor(lax.stop_gradient(texel[..., i])) for i in range(2))
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    column, row = (jnp.where(inside, place, 0).astype(jnp.int32) for place in (x, y))
    row = row if layer is None else row + layer * height
    return jnp.where(inside, take(shadow_map.depth.reshape(-1), row * width + column), 1)
