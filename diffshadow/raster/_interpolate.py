"""Depth and attributes of the visible triangles, with their gradients.

Which face a pixel sees is an integer and carries no gradient. What it sees there follows smoothly from that face's
plane, so depth and attributes are computed again from the face's corners in clip space. Silhouettes, where the face
itself changes, are not handled here.

With the corners shifted so that the pixel centre lies at the origin, `x' = x - X w`, `y' = y - Y w`, the
perspective-correct barycentric coordinates are `b_i ∝ x'_j y'_k - x'_k y'_j` (2D homogeneous rasterization, Olano &
Greer 1997): no divide by `w`, so faces that reach behind the eye need no clipping here.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from .._arithmetic import safe_divide, take, take_in_runs, with_gradient_of
from .._device import chunk_size, is_on_gpu
from .._types import ClipVertices, DepthMap, FaceMap, Faces, Mask, Resolution, VectorMap
from ..geometry import Tile

# A pixel centre may lie outside its face by the half sub-pixel of snapping. For a sliver that can be many times its
# width; beyond this share of the face's height the point is pulled back onto the face.
_OVERSHOOT = 0.1
# Images of more pixels are interpolated in bands on a CPU, so that their attributes fit in its cache.
_BAND, _BAND_ON_GPU = 1 << 16, 1 << 22
# On a CPU, derivatives of depth are found in bands if the image has more pixels than this. Otherwise a program at 2048²
# would need 118 MiB of temporary arrays. The C library takes arrays of more than 64 MiB from fresh pages each time.
_DERIVATIVE_WHOLE, _DERIVATIVE_BAND = 1 << 20, 1 << 18

CornerValues = Callable[[FaceMap], list[list[Array]]]
"""Of the faces at the pixels (h, w), each component's values at the three corners, (h, w) each."""


class Rows(NamedTuple):
    """Part of an image: its first row, and the height of the whole image; for an image of square tiles of a virtual
    image, one above the other, what each shows."""

    first: Int[Array, ""] | int
    height: int
    tile: Tile | None = None


class Points(NamedTuple):
    """Places in the window: normalized device coordinates, (*n,) each."""

    x: Float[Array, "*n"]
    y: Float[Array, "*n"]

    @classmethod
    def centres(cls, resolution: Resolution, dtype: DTypeLike) -> "Points":
        """The centres of an image's pixels, (h, w) each."""
        centres = _centres(resolution, Rows(0, resolution[0]), dtype)
        return cls(*(jnp.broadcast_to(along, resolution) for along in centres))


def by_bands(
    function: Callable[[Any, Rows], Any], images: Any, *, band: int | None = None, tile: Tile | None = None
) -> Any:
    """`function` of a face map or of several images (h, w), evaluated in bands of rows, one after the other.

    **Arguments:**

    - `function`: from a band's part of the images, and its rows, to arrays whose first axis is the band's rows.
    - `images`: an array (h, w), or a tree of such arrays.
    - `band`: the most pixels of a band of several rows; if left out, what suits the device.
    - `tile`: of an image of square tiles, see `Rows`.

    **Returns:** the arrays for the whole image.
    """
    height, width = jax.tree.leaves(images)[0].shape
    band = band or chunk_size(_BAND, _BAND_ON_GPU)
    if height * width <= band:
        return function(images, Rows(0, height, tile))
    # A number of rows that divides the height, if one is large enough. Otherwise the last band is padded.
    most = max(band // width, 1)
    rows = next(
        (n for n in range(most, most // 2, -1) if height % n == 0), math.ceil(height / math.ceil(height / most))
    )
    count = math.ceil(height / rows)
    padded = jax.tree.map(lambda image: jnp.pad(image, ((0, count * rows - height), (0, 0))), images)
    bands = jax.tree.map(lambda image: image.reshape(count, rows, width), padded)
    bands = bands, jnp.arange(0, count * rows, rows, dtype=jnp.int32)
    found = lax.map(lambda part: function(part[0], Rows(part[1], height, tile)), bands)
    return jax.tree.map(lambda values: values.reshape(count * rows, *values.shape[2:])[:height], found)


def corner_values(attribute: Float[Array, "v c"], faces: Faces, pixels: int) -> CornerValues:
    """Looks up a vertex attribute at the corners of the faces that so many pixels see.

    Called outside of `by_bands`, so that what is the same for all bands is done once.
    """
    # Columns of their own: positions from gathers of whole rows take a tenth longer.
    values, vertices = ([array[:, k] for k in range(array.shape[1])] for array in (attribute, faces))
    values, vertices = _computed((values, vertices))
    if faces.shape[0] > pixels:
        return lambda face: [[take(value, take(vertex, face)) for vertex in vertices] for value in values]
    # One gather for each pixel instead of two.
    tables = _computed([[take(value, vertex) for vertex in vertices] for value in values])
    return lambda face: [[_at_pixels(table, face) for table in corners] for corners in tables]


def _at_pixels(values: Array, face: FaceMap) -> Array:
    """Values (f, ...) of the faces that the pixels see: (h, w, ...)."""
    return (take_in_runs if is_on_gpu() else take)(values, face)


class Barycentrics(eqx.Module):
    """Where on its face each pixel's centre lies.

    - `face`: (h, w), the face, 0 where there is no face; `mask`: (h, w), whether there is a face.
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
    - `rows`: the rows of the image that `face` has; by default all.
    """
    return barycentrics_at(face, corner_values(clip, faces, face.size), rows or Rows(0, face.shape[0]))


def barycentrics_at(face: FaceMap, clip: CornerValues, places: Rows | Points) -> Barycentrics:
    """`barycentrics` in some rows of an image, or at points, of the faces `face`; `clip` has all four coordinates."""
    return _locate(face, clip, places)[0]


def _locate(face: FaceMap, clip: CornerValues, places: Rows | Points) -> tuple[Barycentrics, Mask]:
    """Where pixels' centres, or points, lie on their faces, and which of them were not pulled back onto them."""
    mask = face >= 0
    face = jnp.maximum(face, 0)
    x, y, _, w = clip(face)
    X, Y = places if isinstance(places, Points) else _centres(face.shape, places, w[0].dtype)
    (x0, y0), (x1, y1), (x2, y2) = ((x[k] - X * w[k], y[k] - Y * w[k]) for k in range(3))
    areas = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    # A face seen exactly edge-on has no area; its middle then stands for it.
    weights = _fractions(areas)
    on_face = (weights[0] > -_OVERSHOOT) & (weights[1] > -_OVERSHOOT) & (weights[2] > -_OVERSHOOT)
    clamped = _fractions([jnp.clip(weight, 0, 1) for weight in weights])
    # Barrier: otherwise XLA computes the weights again for each component that is interpolated.
    weights = _computed([jnp.where(on_face, weight, near) for weight, near in zip(weights, clamped, strict=True)])
    return Barycentrics(face, mask, jnp.stack(weights, axis=-1)), on_face


def _centres(shape: tuple[int, ...], rows: Rows, dtype: Any) -> tuple[Float[Array, "*n w"], Float[Array, "h 1"]]:
    """Normalized device coordinates of the pixel centres in some rows of an image."""
    height, width = shape
    column = jnp.arange(width, dtype=jnp.int32)
    row = (rows.first + jnp.arange(height, dtype=jnp.int32))[:, None]
    centre = lambda index, size: (index.astype(dtype) + 0.5) * (2.0 / size) - 1
    if rows.tile is None:
        return centre(column, width), centre(row, rows.height)
    left, bottom, size = (take(values, row // width) for values in (*rows.tile.origin.T, rows.tile.size))
    return centre(left + column, size), centre(bottom + row % width, size)


def interpolate(at: Barycentrics, attribute: Float[Array, "v c"], faces: Faces) -> Float[Array, "h w c"]:
    """A vertex attribute (v, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return interpolate_values(at, corner_values(attribute, faces, at.face.size))


def interpolate_values(at: Barycentrics, values: CornerValues) -> Float[Array, "h w c"]:
    """`interpolate` of values that `corner_values` looks up."""
    return _stacked(at, [_mean(at, corners) for corners in values(at.face)])


def interpolate_corners(at: Barycentrics, attribute: Float[Array, "f 3 c"]) -> Float[Array, "h w c"]:
    """An attribute of each corner of each face (f, 3, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    columns = [[attribute[:, k, c] for k in range(3)] for c in range(attribute.shape[-1])]
    return _stacked(at, [_mean(at, [_at_pixels(column, at.face) for column in corners]) for corners in columns])


def of_face(at: Barycentrics, attribute: Float[Array, "f c"]) -> Float[Array, "h w c"]:
    """An attribute of each face (f, c) at the pixels, (h, w, c); 0 where nothing is seen."""
    return jnp.where(at.mask[..., None], _at_pixels(attribute, at.face), 0)


def interpolate_depth(at: Barycentrics, clip: ClipVertices, faces: Faces) -> DepthMap:
    """Window depth at the pixels, (h, w); 1 where nothing is seen."""
    return _depth(at, corner_values(_from_far(clip), faces, at.face.size))


def _from_far(clip: ClipVertices) -> ClipVertices:
    """Clip coordinates with z measured from the far plane.

    z and w of a far corner are nearly equal, so their difference is exact and small, where z itself would leave the
    rounding of a corner's distance behind.
    """
    return jnp.stack([clip[:, 0], clip[:, 1], clip[:, 2] - clip[:, 3], clip[:, 3]], axis=-1)


def _depth(at: Barycentrics, from_far: CornerValues) -> DepthMap:
    _, _, z, w = (_mean(at, corners) for corners in from_far(at.face))
    return jnp.where(at.mask, 1 + safe_divide(z, w) * 0.5, 1)


def visible_depth(
    face: Int[Array, "*l h w"], clip: ClipVertices, faces: Faces, tile: Tile | None = None
) -> Float[Array, "*l h w"]:
    """Window depth of the faces that the pixels see, (h, w); 1 where nothing is seen.

    The result equals `interpolate_depth` with the `barycentrics` of the same clip coordinates, and takes less time to
    differentiate. Depth is linear in the window, so the derivative at a pixel follows from three numbers of its face. A
    pixel whose centre was pulled back onto its face has the derivative of the face's middle.

    **Arguments:** as for `barycentrics`, and

    - `tile`: for face maps (l, h, w) that are square tiles of a virtual image, the place of each tile.
    """
    if tile is not None:
        flat, tiles = face.reshape(-1, face.shape[-1]), Tile(tile.origin.reshape(-1, 2), tile.size.reshape(-1))
        return _visible_depth(flat, clip, faces, tiles).reshape(face.shape)
    return _visible_depth(face, clip, faces, None)


def _visible_depth(face: FaceMap, clip: ClipVertices, faces: Faces, tile: Tile | None) -> DepthMap:
    if faces.shape[0] > face.size:
        # Most faces are not seen, so their planes would cost more than they save.
        return interpolate_depth(barycentrics(face, clip, faces, Rows(0, face.shape[0], tile)), clip, faces)
    from_far = _from_far(clip)
    values = corner_values(lax.stop_gradient(from_far), faces, face.size)

    def band(face: FaceMap, rows: Rows) -> tuple[DepthMap, Mask]:
        at, on_face = _locate(face, values, rows)
        return _depth(at, values), on_face

    depth, on_face = by_bands(band, face, tile=tile)
    planes = _depth_planes(from_far, faces)

    def on_planes(seen: tuple[FaceMap, Mask], rows: Rows) -> DepthMap:
        face, on_face = seen
        X, Y = _centres(face.shape, rows, clip.dtype)
        plane = _planes_at(planes, jnp.maximum(face, 0))
        linear = plane.depth + plane.slope_x * (X - plane.x) + plane.slope_y * (Y - plane.y)
        return jnp.where(face >= 0, jnp.where(on_face, linear, plane.middle) * 0.5, 1)

    is_whole = is_on_gpu() or face.size <= _DERIVATIVE_WHOLE
    # In reverse mode, a band's arrays are computed again instead of kept.
    again = lambda seen, rows: jax.checkpoint(partial(on_planes, rows=rows))(seen)
    smooth = by_bands(again, (face, on_face), band=face.size if is_whole else _DERIVATIVE_BAND, tile=tile)
    return with_gradient_of(smooth, depth)


class _Planes(NamedTuple):
    """Planes of z / w over normalized device coordinates, (f,) each.

    - `depth`: z / w at the point (`x`, `y`), and `slope_x`, `slope_y`, its derivatives.
    - `middle`: z / w at the face's middle.
    """

    depth: Float[Array, " f"]
    slope_x: Float[Array, " f"]
    slope_y: Float[Array, " f"]
    middle: Float[Array, " f"]
    x: Float[Array, " f"]
    y: Float[Array, " f"]


def _depth_planes(clip: ClipVertices, faces: Faces) -> _Planes:
    """The planes that the faces lie in.

    Let the columns of M be the corners' (x, y, w), and z the row of their z. The point of the face at (X, Y) is
    M⁻¹ (X, Y, 1), as weights of the corners whose mean w is 1; so z / w is z M⁻¹ (X, Y, 1) there.
    """
    x, y, z, w = ([take(clip[:, c], faces[:, k]) for k in range(3)] for c in range(4))
    total = lambda a, b=(1, 1, 1): a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    # About a point near the face, since about a distant one they would be small differences of large numbers.
    X, Y = (lax.stop_gradient(jnp.clip(safe_divide(total(values), total(w)), -1, 1)) for values in (x, y))
    x, y = [x[k] - X * w[k] for k in range(3)], [y[k] - Y * w[k] for k in range(3)]
    # The rows of the adjugate of M: M⁻¹ times the determinant.
    pairs = ((1, 2), (2, 0), (0, 1))
    adjugate = [[a[i] * b[j] - a[j] * b[i] for i, j in pairs] for a, b in ((y, w), (w, x), (x, y))]
    determinant = total(adjugate[2], w)
    slope_x, slope_y, depth = (safe_divide(total(column, z), determinant) for column in adjugate)
    return _computed(_Planes(depth, slope_x, slope_y, safe_divide(total(z), total(w)), X, Y))


def _planes_at(planes: _Planes, face: FaceMap) -> _Planes:
    """The planes of the faces that the pixels see, (h, w) each."""
    if is_on_gpu():
        return jax.tree.map(lambda values: _at_pixels(values, face), planes)
    # What is differentiated is a row for each face: in reverse, a pixel then adds to one place instead of four.
    rows = _at_pixels(jnp.stack([planes.depth, planes.slope_x, planes.slope_y, planes.middle], axis=-1), face)
    depth, slope_x, slope_y, middle = jnp.moveaxis(rows, -1, 0)
    return _Planes(depth, slope_x, slope_y, middle, _at_pixels(planes.x, face), _at_pixels(planes.y, face))


def _fractions(parts: Sequence[Array]) -> list[Array]:
    """Each part over their sum; 1/3 where that is 0."""
    total = parts[0] + parts[1] + parts[2]
    return [safe_divide(part, total, 1 / 3) for part in parts]


def _mean(at: Barycentrics, corners: list[Array]) -> Float[Array, "h w"]:
    """The mean of the corners' values by the pixels' weights."""
    return at.weights[..., 0] * corners[0] + at.weights[..., 1] * corners[1] + at.weights[..., 2] * corners[2]


def _stacked(at: Barycentrics, components: list[Array]) -> Float[Array, "h w c"]:
    """The components along the last axis; 0 where nothing is seen."""
    return jnp.where(at.mask[..., None], jnp.stack(components, axis=-1), 0)


def _computed(arrays: Any) -> Any:
    """The arrays, behind barriers: XLA computes each once, instead of again for every element that is read."""
    return jax.tree.map(lax.optimization_barrier, arrays)
