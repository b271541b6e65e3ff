"""Lines in which meshes cross each other, where no edge of a mesh is.

In the window, depth is linear over a face. So two faces cross where the difference of their planes is zero, which is a
line. It is looked for within each pixel whose centre and corners see faces of different parts of the mesh.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import safe_divide, take
from .._types import ClipVertices, FaceMap, Faces, Resolution

# Corners of a pixel, from its centre.
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]], np.float32)
# Half a pixel, but for as little as keeps the ends of lines off the grid's lines.
_INSIDE = 0.4999


class PlaneCrossings(NamedTuple):
    """Of pixels (m,), the line within each in which two faces cross; the face to its `left` is the nearer one there.

    - `start`, `end`: (m, 2), in pixels of the window; `depth`: (m,), in the window.
    - `used`: (m,), whether there is one.
    """

    start: Float[Array, "m 2"]
    end: Float[Array, "m 2"]
    depth: Float[Array, " m"]
    left: Int[Array, " m"]
    right: Int[Array, " m"]
    used: Bool[Array, " m"]


def mixed_pixels(centres: FaceMap, corners: Int[Array, "H W"], component: Int[Array, " p"]) -> Bool[Array, "h w"]:
    """Which pixels see one part of the mesh at their centre and another one at a corner, by the `component` (p,) that
    each face belongs to."""
    height, width = centres.shape
    part = lambda face: jnp.where(face >= 0, take(component, jnp.maximum(face, 0)), -1)
    own, at_corners = part(centres), part(corners)
    around = [at_corners[j : j + height, i : i + width] for j in (0, 1) for i in (0, 1)]
    return (own >= 0) & sum([(other >= 0) & (other != own) for other in around], jnp.zeros(centres.shape, bool))


def plane_crossings(
    mixed: Bool[Array, "h w"],
    centres: FaceMap,
    corners: Int[Array, "H W"],
    clip: ClipVertices,
    faces: Faces,
    component: Int[Array, " p"],
    capacity: int,
) -> PlaneCrossings:
    """The lines in which meshes cross, in as many of the `mixed` pixels as `capacity`."""
    height, width = centres.shape
    pixels = height * width
    pixel = jnp.nonzero(mixed.reshape(-1), size=max(capacity, 1), fill_value=pixels)[0].astype(jnp.int32)
    used, pixel = pixel < pixels, jnp.minimum(pixel, pixels - 1)
    row, column = pixel // width, pixel % width
    own, middle = centres[row, column], jnp.stack([column, row], axis=1) + 0.5
    # The centre's face is the nearer one at the centre, and the other one at the corner that sees it.
    depth_of = lambda face, at: window_depth(face, clip, faces, at, (height, width))
    around = jnp.stack([corners[row + j, column + i] for j in (0, 1) for i in (0, 1)])
    at_corners = middle + _CORNERS[:, None]
    ours = jnp.broadcast_to(own, around.shape)
    part = lambda face: take(component, jnp.maximum(face, 0))
    crosses = (around >= 0) & (part(around) != part(ours))
    crosses = crosses & (depth_of(own, middle) < depth_of(around, jnp.broadcast_to(middle, at_corners.shape)))
    crosses = crosses & (depth_of(around, at_corners) < depth_of(ours, at_corners))
    other = jnp.take_along_axis(around, jnp.argmax(crosses, axis=0)[None], axis=0)[0]
    used = used & jnp.any(crosses, axis=0)
    # Others have one face twice, whose numbers are finite.
    own, other = jnp.where(used, own, 0), jnp.where(used, other, 0)

    # How much deeper the other face is: value + x · a + y · b, from the pixel's centre.
    places = [middle + np.array(offset, np.float32) for offset in ((0, 0), (1, 0), (0, 1))]
    value, along_x, along_y = (depth_of(other, place) - depth_of(own, place) for place in places)
    slope = jnp.stack([along_x - value, along_y - value], axis=1)
    normal, offset = lax.stop_gradient((slope, value))
    squared = jnp.sum(normal**2, axis=1, keepdims=True)
    # From the point of the line closest to the centre, as far as the pixel's sides, with the nearer face to the left.
    foot = -offset[:, None] * safe_divide(normal, jnp.broadcast_to(squared, normal.shape))
    way = normal[:, ::-1] * np.array([1, -1], np.float32)
    bound = lambda side: safe_divide(side - foot, way, jnp.inf)
    first, last = jnp.sort(jnp.stack([bound(-_INSIDE), bound(_INSIDE)]), axis=0)
    level = way == 0
    first = jnp.max(jnp.where(level, -jnp.inf, first), axis=1)[:, None]
    last = jnp.min(jnp.where(level, jnp.inf, last), axis=1)[:, None]
    used = used & (first < last)[:, 0] & (squared[:, 0] > 0)

    def moving(at: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
        """A point of the line, which moves along its normal."""
        away = value + jnp.sum(slope * at, axis=1)
        shift = safe_divide(normal, jnp.broadcast_to(squared, normal.shape))
        return middle + at - (away - lax.stop_gradient(away))[:, None] * shift

    ends = [jnp.where(used[:, None], foot + jnp.where(used[:, None], t, 0) * way, 0) for t in (first, last)]
    start, end = map(moving, ends)
    return PlaneCrossings(start, end, depth_of(own, (start + end) / 2), own, other, used)


def window_depth(
    face: Int[Array, "*n"], clip: ClipVertices, faces: Faces, at: Float[Array, "*n 2"], resolution: Resolution
) -> Float[Array, "*n"]:
    """Window depth of the planes of faces at places in pixels; infinite where there is no face."""
    height, width = resolution
    corners = take(faces, jnp.maximum(face, 0))
    x, y, z, w = ([take(clip[:, c], corners[..., k]) for k in range(3)] for c in range(4))
    X, Y = at[..., 0] * (2 / width) - 1, at[..., 1] * (2 / height) - 1
    x, y = [x[k] - X * w[k] for k in range(3)], [y[k] - Y * w[k] for k in range(3)]
    areas = [x[i] * y[j] - x[j] * y[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    mean = lambda values: areas[0] * values[0] + areas[1] * values[1] + areas[2] * values[2]
    depth = safe_divide(mean(z), mean(w), 1.0) * 0.5 + 0.5
    return jnp.where(face >= 0, depth, jnp.inf)
