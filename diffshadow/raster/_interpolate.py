"""Depth and attributes of the visible triangles, with their gradients.

Which face a pixel sees is an integer and carries no gradient. What it sees there follows smoothly from that face's
plane, so depth and attributes are computed anew from the face's corners in clip space, at the cost of one gather a
pixel. Silhouettes, where the face itself changes, are no business of this file.

With the corners shifted so that the pixel centre lies at the origin, `x' = x - X w`, `y' = y - Y w`, the
perspective-correct barycentric coordinates are `b_i ∝ x'_j y'_k - x'_k y'_j` (2D homogeneous rasterization, Olano &
Greer 1997): no divide by `w`, so faces that reach behind the eye need no clipping here.
"""

from collections.abc import Sequence

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
    X = (jnp.arange(width, dtype=clip.dtype) + 0.5) * (2 / width) - 1
    Y = ((jnp.arange(height, dtype=clip.dtype) + 0.5) * (2 / height) - 1)[:, None]
    corners = [[clip[:, c][vertex] for c in (0, 1, 3)] for vertex in _vertices(face, faces)]
    (x0, y0), (x1, y1), (x2, y2) = ((x - X * w, y - Y * w) for x, y, w in corners)
    areas = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    # A face seen exactly edge-on has no area; its middle then stands for it.
    weights = _shares(areas)
    on_face = (weights[0] > -_OVERSHOOT) & (weights[1] > -_OVERSHOOT) & (weights[2] > -_OVERSHOOT)
    clamped = _shares([jnp.clip(weight, 0, 1) for weight in weights])
    weights = [jnp.where(on_face, weight, held) for weight, held in zip(weights, clamped, strict=True)]
    return Barycentrics(face, mask, jnp.stack(weights, axis=-1))


def interpolate(at: Barycentrics, attribute: Float[Array, "v c"], faces: Faces) -> Float[Array, "h w c"]:
    """A vertex attribute (v, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return _weighted(at, attribute, _vertices(at.face, faces))


def interpolate_corners(at: Barycentrics, attribute: Float[Array, "f 3 c"]) -> Float[Array, "h w c"]:
    """An attribute of each corner of each face (f, 3, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return _weighted(at, attribute.reshape(-1, attribute.shape[-1]), [3 * at.face + k for k in range(3)])


def interpolate_depth(at: Barycentrics, clip: ClipVertices, faces: Faces) -> DepthMap:
    """Window depth at the pixels, (h, w); 1 where nothing is seen."""
    # From the far plane: z and w of a far corner are nearly equal, so their difference is exact and small, where z
    # itself would leave the rounding of a corner's distance behind.
    from_far = jnp.stack([clip[:, 2] - clip[:, 3], clip[:, 3]], axis=-1)
    z, w = jnp.moveaxis(_weighted(at, from_far, _vertices(at.face, faces)), -1, 0)
    return jnp.where(at.mask, 1 + safe_divide(z, w) * 0.5, 1)


def _vertices(face: FaceMap, faces: Faces) -> list[FaceMap]:
    """The three vertices of the face at each pixel."""
    return [faces[:, k][face] for k in range(3)]


def _weighted(at: Barycentrics, attribute: Float[Array, "n c"], corners: list[FaceMap]) -> Float[Array, "h w c"]:
    # One gather for each component of each corner: gathers of whole rows do not vectorize, and cost ten times as much.
    component = lambda values: sum(at.weights[..., k] * values[corner] for k, corner in enumerate(corners))
    value = jnp.stack([component(attribute[:, c]) for c in range(attribute.shape[1])], axis=-1)
    return jnp.where(at.mask[..., None], value, 0)


def _shares(parts: Sequence[Array]) -> list[Array]:
    """Each part over their sum; all alike where that is 0."""
    total = parts[0] + parts[1] + parts[2]
    return [safe_divide(part, total, 1 / 3) for part in parts]
