"""Where an alpha test cuts out triangles, in float64."""

import numpy as np
from jaxtyping import Bool, Float64, Int

from .._types import HostArray
from ..geometry import Textures


class Cutouts:
    """The parts of triangles whose texture's alpha is below its cutoff: rays pass through them.

    - `tested`: (f,), which triangles have an alpha test.
    """

    def __init__(self, textures: Textures):
        assert textures.cutoff is not None
        self.index, self.cutoff = np.asarray(textures.index), np.asarray(textures.cutoff, np.float64)
        self.uv = np.asarray(textures.uv, np.float64)
        self.images = [image[..., 3].astype(np.float64) for image in textures.images()]
        self.tested = (self.index >= 0) & (self.cutoff[np.maximum(self.index, 0)] > 0)

    def only(self, faces: Bool[HostArray, " f"]) -> "Cutouts":
        """Of the triangles selected by `faces` (f,)."""
        some = object.__new__(Cutouts)
        some.cutoff, some.images = self.cutoff, self.images
        some.index, some.uv, some.tested = self.index[faces], self.uv[faces], self.tested[faces]
        return some

    def contain(self, faces: Int[HostArray, " n"], weights: Float64[HostArray, "n 3"]) -> Bool[HostArray, " n"]:
        """Whether points of `faces` (n,), given as barycentric coordinates (n, 3), are cut out."""
        cut = np.zeros(len(faces), bool)
        at = np.flatnonzero(self.tested[faces])
        index, uv = self.index[faces[at]], np.einsum("nk,nkc->nc", weights[at], self.uv[faces[at]])
        for number in np.unique(index):
            of = index == number
            cut[at[of]] = _bilinear(self.images[number], *uv[of].T) < self.cutoff[number]
        return cut


def barycentrics_of(
    position: Float64[HostArray, "n 3"], corners: Float64[HostArray, "n 3 3"]
) -> Float64[HostArray, "n 3"]:
    """The barycentric coordinates of points in the planes of triangles; 1/3 each for one without area."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    squared = np.sum(normal * normal, axis=1)
    of = lambda first, second: np.sum(np.cross(second - first, position - first) * normal, axis=1)
    parts = np.stack([of(b, c), of(c, a), of(a, b)], axis=1)
    return np.where(squared[:, None] > 0, parts / np.where(squared > 0, squared, 1)[:, None], 1 / 3)


def _bilinear(
    image: Float64[HostArray, "h w"], u: Float64[HostArray, " n"], v: Float64[HostArray, " n"]
) -> Float64[HostArray, " n"]:
    """The mean of the four texels around a point of the image, which repeats, by their distances."""
    height, width = image.shape
    x, y = u * width - 0.5, v * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, up = x - column, y - row
    texel = lambda i, j: image[(row + j) % height, (column + i) % width]
    lower = texel(0, 0) * (1 - right) + texel(1, 0) * right
    return lower * (1 - up) + (texel(0, 1) * (1 - right) + texel(1, 1) * right) * up
