"""The faces on both sides of pieces of outlines and creases, from the samples of the pixels around them."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import take
from .._types import ClipVertices, FaceMap, Faces, Resolution
from ..geometry import NO_NEIGHBOUR, Edges, View
from ._boundaries import Boundaries, Pieces
from ._plane_crossings import WindowPlanes
from ._rasterize import NO_FACE

# Samples closer to a line than this, in pixels, may be on the wrong side because of the rasterizer's rounding.
_CLEAR = 1 / 64
# Window depths are equal if they differ by less.
_ROUNDING = 1e-6
# Two parts of a mesh are adjacent if their depths differ by no more than the width of this many pixels.
_ADJOINING = 4.0


class Sides(NamedTuple):
    """The faces to the `left` and `right` of pieces (n,), and whether these are `in_sight`. `correction` corrects the
    area if a piece passes a pixel's centre on the other side than the rasterizer did."""

    left: Int[Array, " n"]
    right: Int[Array, " n"]
    correction: Float[Array, " n"]
    in_sight: Bool[Array, " n"]

    @classmethod
    def of(cls, pieces: Pieces, found: Boundaries, around: "Around", pixels: int) -> "Sides":
        """The sides of `pieces` of `found`, in an image of `pixels` pixels."""
        left, centre = around.left, around.face[0]
        to_right, to_left, inside = around.beside(pieces)
        crease_to = take(found.right, pieces.segment)
        is_crease = crease_to != NO_NEIGHBOUR
        # A mesh's outline may run back for a short distance, within the outline of its nearer faces.
        is_back = ~is_crease & to_right.is_beside & ~to_left.is_beside
        right = jnp.where(is_crease, crease_to, jnp.where(is_back, to_left.face, to_right.face))
        in_sight = jnp.where(is_back, to_left.is_behind, to_right.is_behind & (is_crease | ~to_right.is_beside))
        # Within the rasterizer's rounding, the face at the centre decides on which side of the line the centre lies.
        is_left = jnp.where(is_crease, centre == left, around.is_beside[0] ^ is_back)
        is_close = (jnp.abs(pieces.height) < _CLEAR) & (jnp.abs(pieces.beyond) > 0.25)
        is_wrong = is_close & (is_left != (pieces.height > 0)) & (~is_crease | (centre == left) | (centre == right))
        shaded = jnp.where(is_back, to_right.face, jnp.where(inside.is_beside, inside.face, left))
        exists = pieces.pixel < pixels
        # If a mesh rests on another one, or nearly so, one line is both a silhouette and a crossing. It counts once.
        touches = exists & ~is_crease & in_sight
        touched = jnp.zeros(pixels + 1, bool).at[pieces.pixel].max(touches)[pieces.pixel]
        in_sight = in_sight & ~(touched & take(found.crosses, pieces.segment))
        return cls(
            left=jnp.where(exists, jnp.where(is_crease, left, shaded), NO_FACE),
            right=jnp.where(exists, right, NO_FACE),
            correction=jnp.where(is_wrong, -jnp.sign(pieces.beyond), 0),
            in_sight=in_sight & ~pieces.hidden & (~is_crease | around.nearest(around.distance).is_behind),
        )


class Around(NamedTuple):
    """The samples around pieces (n,): at the centre of each piece's pixel, and at the pixel's four corners.

    - `left`: (n,), the nearer of the faces at the piece's edge.
    - `place`: position in pixels. `aside`: distance to the right of the piece. `distance`: squared distance from the
      piece's middle.
    - `is_beside`: whether the face belongs to the same part of the mesh and is adjacent to the piece.
    - `is_behind`: whether the face does not hide the piece.
    """

    left: Int[Array, " n"]
    face: Int[Array, "5 n"]
    place: Float[Array, "5 n 2"]
    aside: Float[Array, "5 n"]
    distance: Float[Array, "5 n"]
    is_beside: Bool[Array, "5 n"]
    is_behind: Bool[Array, "5 n"]

    @classmethod
    def of(
        cls,
        pieces: Pieces,
        found: Boundaries,
        view: View,
        clip: ClipVertices,
        faces: Faces,
        edges: Edges,
        centres: FaceMap,
        corners: Int[Array, "H W"],
    ) -> "Around":
        height, width = centres.shape
        pixel = jnp.minimum(pieces.pixel, height * width - 1)
        row, column = pixel // width, pixel % width
        offset = np.array([[0, 0], [-1, -1], [1, -1], [-1, 1], [1, 1]]) / 2
        own = [centres[row, column]] + [corners[row + j, column + i] for j in (0, 1) for i in (0, 1)]
        face = jnp.stack(own)
        place = jnp.stack([column, row], axis=1) + 0.5 + offset[:, None]
        from_middle = place - pieces.middle
        across = pieces.right * _CLEAR
        candidates = take(found.left, pieces.segment).T
        every = jnp.concatenate([candidates, face])
        about = jnp.broadcast_to(pieces.middle, (*every.shape, 2))
        planes = WindowPlanes.of(every, clip, faces, about, (height, width))
        of_left, samples = planes.some(slice(2)), planes.some(slice(2, None))
        # The nearer of the two faces counts as the left face.
        depths = of_left.away(jnp.broadcast_to(-across, (*candidates.shape, 2)))
        nearer = jnp.argmin(depths, axis=0)[None]
        left, depth = (jnp.take_along_axis(values, nearer, axis=0)[0] for values in (candidates, of_left.depth))
        steep = jnp.abs(samples.slope_x * across[:, 0] + samples.slope_y * across[:, 1])
        slack = steep + jnp.abs(jnp.min(depths, axis=0) - depth) + _ROUNDING
        # A part of the same mesh at nearly the depth of the line is beside it, not behind it.
        component = lambda face: take(edges.component, jnp.maximum(face, 0))
        is_near = jnp.abs(samples.depth - depth) <= slack + adjoining(view, depth, (height, width))
        return cls(
            left=left,
            face=face,
            place=place,
            aside=jnp.sum(from_middle * pieces.right, axis=-1),
            distance=jnp.sum(from_middle**2, axis=-1),
            is_beside=(face >= 0) & (component(face) == component(left)) & is_near,
            is_behind=samples.depth >= depth - slack,
        )

    def beside(self, pieces: Pieces) -> tuple["_Sample", "_Sample", "_Sample"]:
        """The samples to the right of each piece, to its left, and farther inside its own face."""
        # A sample that is farther away is better than a sample of the same part of the mesh or beyond another piece.
        across_wall = lambda at: jnp.sum(pieces.wall[:, :2] * at, axis=-1) + pieces.wall[:, 2]
        is_beyond = across_wall(self.place) * across_wall(pieces.middle) < 0
        behind_first = self.distance + jnp.where(self.is_beside, 4, 0) + jnp.where(is_beyond, 16, 0)
        right, left = (self.nearest(jnp.where(turn * self.aside > _CLEAR, behind_first, jnp.inf)) for turn in (1, -1))
        # At a smooth silhouette, the face is seen edge-on. A sample farther inside has the colour that moves with it.
        own_first = self.distance + jnp.where(self.is_beside, 0, 4)
        return right, left, self.nearest(jnp.where(self.aside < -_CLEAR, own_first, jnp.inf))

    def nearest(self, cost: Float[Array, "5 n"]) -> "_Sample":
        """The sample of the lowest cost for each piece."""
        chosen = jnp.argmin(cost, axis=0)[None]
        pick = lambda values: jnp.take_along_axis(values, chosen, axis=0)[0]
        return _Sample(pick(self.face), pick(self.is_beside), pick(self.is_behind))


class _Sample(NamedTuple):
    """The nearest sample with a known face on one side of each piece. `Around` describes the fields."""

    face: Int[Array, " n"]
    is_beside: Bool[Array, " n"]
    is_behind: Bool[Array, " n"]


def adjoining(view: View, depth: Float[Array, " n"], resolution: Resolution) -> Float[Array, " n"]:
    """The maximum difference between window depths of adjacent surfaces."""
    away = view.eye_depth(depth)
    return _ADJOINING * view.depth_slope(away) * view.texel_size(away, resolution)
