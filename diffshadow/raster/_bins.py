"""Sorts triangles by the size of their pixel boxes.

A triangle is dropped before its pixels are tested if its box has no pixel centre, if its side is culled, or if it is
outside the frustum. This drops most triangles of a fine mesh. The others are divided into size classes. All triangles
of a class are drawn in windows of the same size. Triangles that do not fit into the largest window are cut into blocks.

Arrays of corners have shape (3, n). The triangles are on the last axis, so that operations vectorize.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import take
from .._types import ClipVertices, Faces, Viewport
from ..settings.maps import Cull
from ._clip import needs_clipping
from ._compact import Groups, group
from ._fixed import OfCorners, first_centre, last_centre, signed_area, snap

Facing = tuple[bool | Bool[Array, ""], bool | Bool[Array, ""]]
"""Whether front faces and back faces are drawn. The values may be known only at run time."""
FACING: dict[Cull, tuple[bool, bool]] = {"none": (True, True), "back": (True, False), "front": (False, True)}
"""The faces that are drawn for each culling mode."""

WINDOWS = (2, 4, 8, 16)
"""The sides of the size classes' windows, in pixels."""
LARGE = len(WINDOWS)
"""The class of triangles that are too large for a window."""
CLIPPED = LARGE + 1
"""The class of triangles that must be clipped first."""
CLASSES = CLIPPED + 1
BLOCK = 16
"""The side of the blocks of large triangles, in pixels."""

NOTHING = -1


WindowCoordinates = tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]
"""Window coordinates: x and y in pixels, not snapped, and depth."""


class Corners(NamedTuple):
    """Corners of triangles: `x`, `y` in whole sub-pixels, and depth `z`; (3, n) each."""

    x: Int[Array, "3 n"]
    y: Int[Array, "3 n"]
    z: Float[Array, "3 n"]

    @classmethod
    def snapped(cls, window: WindowCoordinates) -> "Corners":
        """Snapped corners at window coordinates, (3, n) each."""
        x, y, z = window
        # Without the barrier, XLA rounds them again for every use.
        x, y = lax.optimization_barrier((snap(x), snap(y)))
        return cls(x, y, z)


class Box(NamedTuple):
    """The first and last pixel whose centre is in a triangle's bounding box, within the viewport; (n,) each."""

    left: Int[Array, " n"]
    bottom: Int[Array, " n"]
    right: Int[Array, " n"]
    top: Int[Array, " n"]


class Triangles(eqx.Module):
    """A mesh's triangles in window space.

    - `clip`: (v, 4), the vertices in clip space; `x`, `y`, `z`: (v,), in window coordinates, not snapped.
    - `faces`: (f, 3), indices into the vertices.
    - `groups`: the faces of each class: first the classes of `WINDOWS`, then `LARGE`, then `CLIPPED`.
    """

    clip: ClipVertices
    x: Float[Array, " v"]
    y: Float[Array, " v"]
    z: Float[Array, " v"]
    faces: Int[Array, "f 3"]
    groups: Groups

    def window_corners(self, face: Int[Array, " n"]) -> WindowCoordinates:
        """The corners of the faces `face` in window coordinates, (3, n) each."""
        vertices = take(self.faces, face).T
        return take(self.x, vertices), take(self.y, vertices), take(self.z, vertices)


def to_window(clip: Float[Array, "4 ..."], resolution: Viewport) -> WindowCoordinates:
    """Window x and y in pixels and depth in [0, 1] of clip coordinates, (*n,) each. `w = 0` maps to the centre."""
    height, width = resolution
    w = clip[3]
    # Multiplies by the reciprocal, and scales before it shifts, as graphics hardware does.
    inverse = jnp.where(w == 0, 0, 1 / jnp.where(w == 0, 1, w))
    scaled = lambda k, half: clip[k] * inverse * half + half
    return scaled(0, width * 0.5), scaled(1, height * 0.5), scaled(2, 0.5)


def pixel_box(x: OfCorners, y: OfCorners, resolution: Viewport) -> Box:
    """The pixel box of triangles with corners at fixed-point `x` and `y`."""
    height, width = resolution
    least = lambda values: jnp.minimum(jnp.minimum(values[0], values[1]), values[2])
    greatest = lambda values: jnp.maximum(jnp.maximum(values[0], values[1]), values[2])
    return Box(
        jnp.maximum(first_centre(least(x)), 0),
        jnp.maximum(first_centre(least(y)), 0),
        jnp.minimum(last_centre(greatest(x)), width - 1),
        jnp.minimum(last_centre(greatest(y)), height - 1),
    )


class Classified(NamedTuple):
    """Triangles in window space, not grouped yet: `x`, `y`, `z` (v,) as in `Triangles`, each triangle's `box`, and its
    class `of_class` (f,), which is -1 if it draws nothing. The boxes of triangles that must be clipped are
    meaningless."""

    x: Float[Array, " v"]
    y: Float[Array, " v"]
    z: Float[Array, " v"]
    box: Box
    of_class: Int[Array, " f"]

    def grouped(self, clip: ClipVertices, faces: Faces) -> Triangles:
        """Groups the triangles by class. `clip` and `faces` are the vertices and faces that they were made from."""
        return Triangles(clip, self.x, self.y, self.z, faces, group(self.of_class, CLASSES))


def bin_triangles(clip: ClipVertices, faces: Faces, resolution: Viewport, facing: Facing) -> Triangles:
    """All triangles, grouped by class."""
    return classify(clip, faces, resolution, facing).grouped(clip, faces)


def classify(clip: ClipVertices, faces: Faces, resolution: Viewport, facing: Facing) -> Classified:
    """The class of each triangle."""
    visible, clipped = _sides(clip, faces, resolution)
    # Without the barrier, XLA computes each vertex again for every corner that gathers it.
    x, y, z = lax.optimization_barrier(to_window(clip.T, resolution))
    fixed_x, fixed_y = lax.optimization_barrier((snap(x), snap(y)))
    # One gather per corner, which XLA fuses with the operations that follow. A million faces take half the time.
    xs, ys = ([take(values, faces[:, k]) for k in range(3)] for values in (fixed_x, fixed_y))
    box = pixel_box(xs, ys, resolution)
    size = jnp.maximum(box.right - box.left, box.top - box.bottom) + 1
    of_class = jnp.full_like(size, LARGE)
    for k, side in reversed(tuple(enumerate(WINDOWS))):
        of_class = jnp.where(size <= side, k, of_class)
    of_class = jnp.where(visible & draws(xs, ys, box, facing), of_class, NOTHING)
    return Classified(x, y, z, box, lax.optimization_barrier(jnp.where(clipped, CLIPPED, of_class)))


def draws(x: OfCorners, y: OfCorners, box: Box, facing: Facing) -> Bool[Array, " n"]:
    """Whether triangles with corners at fixed-point `x` and `y` may cover a pixel in their `box`."""
    area = signed_area(x, y)
    front, back = facing
    faces = ((area > 0) & front) | ((area < 0) & back)
    return faces & (box.left <= box.right) & (box.bottom <= box.top)


def _sides(clip: ClipVertices, faces: Faces, resolution: Viewport) -> tuple[Bool[Array, " f"], Bool[Array, " f"]]:
    """Which faces may be visible, and which of these need clipping."""
    x, y, z, w = (clip[:, k] for k in range(4))
    # One code per vertex needs one gather per corner: 6 bits for the frustum's planes, and 1 bit for clipping.
    tests = [x > w, x < -w, y > w, y < -w, z > w, z < -w, needs_clipping(clip, resolution)]
    codes = lax.optimization_barrier(sum(test.astype(jnp.int32) << bit for bit, test in enumerate(tests)))
    first, second, third = take(codes, faces.T)
    # Many faces of padded meshes are points.
    visible = ((first & second & third & 0b111111) == 0) & (faces[:, 0] != faces[:, 1])
    return visible, visible & (((first | second | third) >> 6) != 0)
