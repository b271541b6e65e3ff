"""Lines in which meshes cross each other, where no edge of a mesh is.

In the window, depth is linear over a face. So two faces cross where the difference of their planes is zero, which is a
line. It is looked for within each pixel whose centre and corners see faces of different parts of the mesh.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import safe_divide, take
from .._types import ClipVertices, FaceMap, Faces, Resolution
from ._items import Items
from ._rasterize import NO_FACE

# Corners of a pixel, from its centre.
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]], np.float32)
# Half a pixel, but for as little as keeps the ends of lines off the grid's lines.
_INSIDE = 0.4999
# How many pixels are looked at together.
_AT_ONCE = 2048


class WindowPlanes(NamedTuple):
    """Window depth over the window of the planes of faces: `depth` (*n) at the places that they were made about, and
    `slope_x`, `slope_y` (*n), its changes a pixel. The depth is infinite where there is no face."""

    depth: Float[Array, "*n"]
    slope_x: Float[Array, "*n"]
    slope_y: Float[Array, "*n"]

    @classmethod
    def of(
        cls,
        face: Int[Array, "*n"],
        clip: ClipVertices,
        faces: Faces,
        about: Float[Array, "*n 2"],
        resolution: Resolution,
    ) -> "WindowPlanes":
        """The planes of faces about places in pixels; the formula is that of `_interpolate._depth_planes`."""
        height, width = resolution
        corners = take(clip, take(faces, jnp.maximum(face, 0)))
        x, y, z, w = ([corners[..., k, c] for k in range(3)] for c in range(4))
        X, Y = about[..., 0] * (2 / width) - 1, about[..., 1] * (2 / height) - 1
        x, y = [x[k] - X * w[k] for k in range(3)], [y[k] - Y * w[k] for k in range(3)]
        total = lambda a, b: a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        pairs = ((1, 2), (2, 0), (0, 1))
        by_x, by_y, here = ([a[i] * b[j] - a[j] * b[i] for i, j in pairs] for a, b in ((y, w), (w, x), (x, y)))
        determinant = total(here, w)
        slope = lambda column, size: jnp.where(face >= 0, safe_divide(total(column, z), determinant) / size, 0)
        depth = jnp.where(face >= 0, safe_divide(total(here, z), determinant, 1.0) * 0.5 + 0.5, jnp.inf)
        return cls(depth, slope(by_x, width), slope(by_y, height))

    def some(self, of: int | slice) -> "WindowPlanes":
        """The planes at an index or a slice of the first axis."""
        return jax.tree.map(lambda values: values[of], self)

    def away(self, by: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
        """The depth so many pixels away."""
        return self.depth + self.slope_x * by[..., 0] + self.slope_y * by[..., 1]


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


def crossing_faces(
    centres: FaceMap, corners: Int[Array, "H W"], clip: ClipVertices, faces: Faces, component: Int[Array, " p"]
) -> FaceMap:
    """For each pixel, the face that crosses the face at the pixel's centre within the pixel, or `NO_FACE`.

    The two faces belong to different parts of the mesh, by the `component` (p,) of each face. The centre's face is
    nearer at the centre, and the other one is nearer at a corner that sees it.
    """
    height, width = centres.shape
    resolution = height, width
    clip, flat = lax.stop_gradient(clip), centres.reshape(-1)
    part = lambda face: jnp.where(face >= 0, take(component, jnp.maximum(face, 0)), -1)
    own, at_corners = part(centres), part(corners)
    others = [at_corners[j : j + height, i : i + width] for j in (0, 1) for i in (0, 1)]
    mixed = (own >= 0) & sum([(other >= 0) & (other != own) for other in others], jnp.zeros(centres.shape, bool))
    items = Items.of(mixed.reshape(-1).astype(jnp.int32))

    def some(number: Int[Array, ""], found: Int[Array, " n"]) -> Int[Array, " n"]:
        pixel, _, exists = items.chunk(number * _AT_ONCE, _AT_ONCE)
        row, column = pixel // width, pixel % width
        around = jnp.stack([corners[row + j, column + i] for j in (0, 1) for i in (0, 1)])
        seen = jnp.concatenate([flat[pixel][None], around])
        middle = jnp.stack([column, row], axis=1) + 0.5
        planes = WindowPlanes.of(seen, clip, faces, jnp.broadcast_to(middle, (5, *middle.shape)), resolution)
        ours, theirs = planes.some(slice(1)), planes.some(slice(1, 5))
        crosses = (around >= 0) & (part(around) != part(seen[:1])) & (ours.depth < theirs.depth)
        to_corners = jnp.broadcast_to(_CORNERS[:, None], (4, *middle.shape))
        crosses = exists & crosses & (theirs.away(to_corners) < ours.away(to_corners))
        other = jnp.take_along_axis(around, jnp.argmax(crosses, axis=0)[None], axis=0)[0]
        other = jnp.where(jnp.any(crosses, axis=0), other, NO_FACE)
        return found.at[jnp.where(exists, pixel, found.size)].set(other, mode="drop")

    none = jnp.full(height * width, NO_FACE, centres.dtype)
    return lax.fori_loop(0, (items.total + (_AT_ONCE - 1)) // _AT_ONCE, some, none).reshape(height, width)


def plane_crossings(
    other: FaceMap, centres: FaceMap, clip: ClipVertices, faces: Faces, capacity: int
) -> PlaneCrossings:
    """The lines where the face at a pixel's centre meets the face that `crossing_faces` found, for up to `capacity`
    pixels."""
    height, width = centres.shape
    resolution = height, width
    pixel, _, used = Items.of((other >= 0).reshape(-1).astype(jnp.int32)).chunk(0, max(capacity, 1))
    row, column = pixel // width, pixel % width
    middle = jnp.stack([column, row], axis=1) + 0.5
    # Unused ones have one face twice, whose numbers are finite.
    own, other = both = jnp.where(used, jnp.stack([centres[row, column], other[row, column]]), 0)
    planes = WindowPlanes.of(both, clip, faces, jnp.broadcast_to(middle, (2, *middle.shape)), resolution)
    ours, theirs = planes.some(0), planes.some(1)

    # How much deeper the other face is: value + x · a + y · b, from the pixel's centre.
    value = theirs.depth - ours.depth
    slope = jnp.stack([theirs.slope_x - ours.slope_x, theirs.slope_y - ours.slope_y], axis=1)
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
    return PlaneCrossings(start, end, ours.away((start + end) / 2 - middle), own, other, used)
