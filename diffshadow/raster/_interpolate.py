"""Depth and attributes of the visible triangles, with their gradients.

Which face a pixel sees is an integer and carries no gradient. What it sees there follows smoothly from that face's
plane, so depth and attributes are computed anew from the face's corners in clip space, at the cost of one gather a
pixel. Silhouettes, where the face itself changes, are no business of this file.

With the corners shifted so that the pixel centre lies at the origin, `x' = x - X w`, `y' = y - Y w`, the
perspective-correct barycentric coordinates are `b_i ∝ x'_j y'_k - x'_k y'_j` (2D homogeneous rasterization, Olano &
Greer 1997): no divide by `w`, so faces that reach behind the eye need no clipping here.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._misc import safe_divide
from .._types import ClipVertices, DepthMap, FaceMap, Faces, Mask, VectorMap

# A pixel centre may lie outside its face by the half sub-pixel of snapping. For a sliver that can be many times its
# width; beyond this share of the face's height the point is pulled back onto the face.
_OVERSHOOT = 0.1


class Barycentrics(eqx.Module):
    """Where on its face each pixel's centre lies.

    - `face`: (h, w), the face, 0 where there is none; `mask`: (h, w), whether there is one.
    - `weights`: (h, w, 3), perspective-correct barycentric coordinates, which sum to 1.
    """

    face: FaceMap
    mask: Mask
    weights: VectorMap


def barycentrics(face: FaceMap, clip: ClipVertices, faces: Faces) -> Barycentrics:
    """Perspective-correct barycentric coordinates of the pixel centres on the faces they see.

    **Arguments:**

    - `face`: (h, w), from `rasterize`.
    - `clip`: (v, 4), clip coordinates, differentiable.
    - `faces`: (f, 3), indices into `clip`.
    """
    height, width = face.shape
    mask = face >= 0
    face = jnp.maximum(face, 0)
    corners = clip[faces[face]]
    X = ((jnp.arange(width, dtype=clip.dtype) + 0.5) * (2 / width) - 1)[:, None]
    Y = ((jnp.arange(height, dtype=clip.dtype) + 0.5) * (2 / height) - 1)[:, None, None]
    x = corners[..., 0] - X * corners[..., 3]
    y = corners[..., 1] - Y * corners[..., 3]
    x1, x2, y1, y2 = jnp.roll(x, -1, -1), jnp.roll(x, -2, -1), jnp.roll(y, -1, -1), jnp.roll(y, -2, -1)
    areas = x1 * y2 - x2 * y1
    # A face seen exactly edge-on has no area; its middle then stands for it.
    total = jnp.sum(areas, axis=-1, keepdims=True)
    weights = safe_divide(areas, jnp.broadcast_to(total, areas.shape), 1 / 3)
    on_face = jnp.all(weights > -_OVERSHOOT, axis=-1, keepdims=True)
    clamped = jnp.clip(weights, 0, 1)
    clamped = safe_divide(clamped, jnp.broadcast_to(jnp.sum(clamped, -1, keepdims=True), clamped.shape), 1 / 3)
    return Barycentrics(face, mask, jnp.where(on_face, weights, clamped))


def interpolate(at: Barycentrics, attribute: Float[Array, "v c"], faces: Faces) -> Float[Array, "h w c"]:
    """A vertex attribute (v, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return interpolate_corners(at, attribute, faces[at.face])


def interpolate_corners(at: Barycentrics, attribute: Float[Array, "n c"], corner: Array) -> Float[Array, "h w c"]:
    """Rows `corner` (h, w, 3) of an attribute (n, c), weighted; 0 where nothing is seen."""
    value = jnp.sum(attribute[corner] * at.weights[..., None], axis=-2)
    return jnp.where(at.mask[..., None], value, 0)


def interpolate_depth(at: Barycentrics, clip: ClipVertices, faces: Faces) -> DepthMap:
    """Window depth at the pixels, (h, w); 1 where nothing is seen."""
    zw = jnp.sum(clip[faces[at.face]][..., 2:] * at.weights[..., None], axis=-2)
    depth = safe_divide(zw[..., 0], zw[..., 1]) * 0.5 + 0.5
    return jnp.where(at.mask, depth, 1)
