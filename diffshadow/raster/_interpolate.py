"""Depth and attributes of the visible triangles, with their gradients.

Which face a pixel sees is an integer and carries no gradient. What it sees there follows smoothly from that face's
plane, so depth and attributes are computed again from the face's corners in clip space. Silhouettes, where the face
itself changes, are not handled here.

With the corners shifted so that the pixel centre lies at the origin, `x' = x - X w`, `y' = y - Y w`, the
perspective-correct barycentric coordinates are `b_i ∝ x'_j y'_k - x'_k y'_j` (2D homogeneous rasterization, Olano &
Greer 1997): no divide by `w`, so faces that reach behind the eye need no clipping here.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._misc import safe_divide, take
from .._types import ClipVertices, DepthMap, FaceMap, Faces, Mask, VectorMap

# A pixel centre may lie outside its face by the half sub-pixel of snapping. For a sliver that can be many times its
# width; beyond this share of the face's height the point is pulled back onto the face.
_OVERSHOOT = 0.1
# Images of more pixels are interpolated in bands, whose attributes fit in a processor's cache.
_WHOLE, _BAND = 1 << 18, 1 << 16


class Rows(NamedTuple):
    """Part of an image: its first row, and the height of the whole image."""

    first: Int[Array, ""] | int
    height: int


def by_bands(function: Callable[[FaceMap, Rows], Any], face: FaceMap, *, whole: int = _WHOLE, band: int = _BAND) -> Any:
    """`function` of a face map (h, w), evaluated in bands of rows, one after the other.

    **Arguments:**

    - `function`: from a band's faces and rows to arrays whose first axis is the band's rows.
    - `whole`: images of at most so many pixels are evaluated at once.
    - `band`: the most pixels of a band of several rows.

    **Returns:** the arrays for the whole image.
    """
    height, width = face.shape
    if height * width <= whole:
        return function(face, Rows(0, height))
    # The most rows that divide the height.
    rows = next(n for n in range(max(band // width, 1), 0, -1) if height % n == 0)
    bands = face.reshape(-1, rows, width), jnp.arange(0, height, rows, dtype=jnp.int32)
    found = lax.map(lambda part: function(part[0], Rows(part[1], height)), bands)
    return jax.tree.map(lambda values: values.reshape(height, *values.shape[2:]), found)


class Barycentrics(eqx.Module):
    """Where on its face each pixel's centre lies.

    - `face`: (h, w), the face, 0 where there is none; `mask`: (h, w), whether there is one.
    - `weights`: (h, w, 3), perspective-correct barycentric coordinates, which sum to 1.
    """

    face: FaceMap
    mask: Mask
    weights: VectorMap


def barycentrics(face: FaceMap, clip: ClipVertices, faces: Faces, rows: Rows | None = None) -> Barycentrics:
    """Perspective-correct barycentric coordinates of the pixel centres on the faces they see.

    **Arguments:**

    - `face`: (h, w), from `rasterize`.
    - `clip`: (v, 4), clip coordinates, differentiable.
    - `faces`: (f, 3), indices into `clip`.
    - `rows`: which rows of the image `face` holds; all of them if left out.
    """
    width = face.shape[1]
    first, height = Rows(0, face.shape[0]) if rows is None else rows
    mask = face >= 0
    face = jnp.maximum(face, 0)
    X = (jnp.arange(width, dtype=clip.dtype) + 0.5) * (2 / width) - 1
    row = first + jnp.arange(face.shape[0], dtype=jnp.int32)
    Y = ((row.astype(clip.dtype) + 0.5) * (2 / height) - 1)[:, None]
    corners = [[clip[:, c][vertex] for c in (0, 1, 3)] for vertex in _vertices(face, faces)]
    (x0, y0), (x1, y1), (x2, y2) = ((x - X * w, y - Y * w) for x, y, w in corners)
    areas = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    # A face seen exactly edge-on has no area; its middle then stands for it.
    weights = _fractions(areas)
    on_face = (weights[0] > -_OVERSHOOT) & (weights[1] > -_OVERSHOOT) & (weights[2] > -_OVERSHOOT)
    clamped = _fractions([jnp.clip(weight, 0, 1) for weight in weights])
    weights = [jnp.where(on_face, weight, nearest) for weight, nearest in zip(weights, clamped, strict=True)]
    return Barycentrics(face, mask, jnp.stack(weights, axis=-1))


def interpolate(at: Barycentrics, attribute: Float[Array, "v c"], faces: Faces) -> Float[Array, "h w c"]:
    """A vertex attribute (v, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return _weighted(at, attribute, _vertices(at.face, faces))


def interpolate_corners(at: Barycentrics, attribute: Float[Array, "f 3 c"]) -> Float[Array, "h w c"]:
    """An attribute of each corner of each face (f, 3, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return _weighted(at, attribute.reshape(-1, attribute.shape[-1]), [3 * at.face + k for k in range(3)])


def of_face(at: Barycentrics, attribute: Float[Array, "f c"]) -> Float[Array, "h w c"]:
    """An attribute of each face (f, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return _by_components(at, attribute, lambda values: take(values, at.face))


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
    return _by_components(
        at, attribute, lambda values: sum(at.weights[..., k] * values[corner] for k, corner in enumerate(corners))
    )


def _by_components(
    at: Barycentrics, attribute: Float[Array, "n c"], component: Callable[[Float[Array, " n"]], Any]
) -> Float[Array, "h w c"]:
    """`component` of each column of an attribute, stacked; 0 where nothing is seen."""
    value = jnp.stack([component(attribute[:, c]) for c in range(attribute.shape[1])], axis=-1)
    return jnp.where(at.mask[..., None], value, 0)


def _fractions(parts: Sequence[Array]) -> list[Array]:
    """Each part over their sum; 1/3 where that is 0."""
    total = parts[0] + parts[1] + parts[2]
    return [safe_divide(part, total, 1 / 3) for part in parts]
