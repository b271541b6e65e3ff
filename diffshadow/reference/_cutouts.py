"""Where an alpha test cuts out triangles, in float64."""

import numpy as np
from jaxtyping import Bool, Float64, Int

from .._types import HostArray
from ..geometry import Sampler, Textures


class Cutouts:
    """The parts of triangles whose texture's alpha is below its cutoff: rays pass through them.

    - `tested`: (f,), which triangles have an alpha test.
    """

    def __init__(self, textures: Textures):
        assert textures.cutoff is not None
        self.index, self.cutoff = np.asarray(textures.index), np.asarray(textures.cutoff, np.float64)
        self.uv = np.asarray(textures.uv, np.float64)
        self.images = [image[..., 3].astype(np.float64) for image in textures.images()]
        self.samplers = [*textures.each_sampler()]
        alpha = textures.corner_alpha
        self.alpha = np.ones(self.uv.shape[:2]) if alpha is None else np.asarray(alpha, np.float64)
        self.tested = (self.index >= 0) & (self.cutoff[np.maximum(self.index, 0)] > 0)

    def only(self, faces: Bool[HostArray, " f"]) -> "Cutouts":
        """The cutouts of the triangles that `faces` (f,) selects."""
        some = object.__new__(Cutouts)
        some.cutoff, some.images, some.samplers = self.cutoff, self.images, self.samplers
        some.index, some.uv, some.tested = self.index[faces], self.uv[faces], self.tested[faces]
        some.alpha = self.alpha[faces]
        return some

    def contain(self, faces: Int[HostArray, " n"], weights: Float64[HostArray, "n 3"]) -> Bool[HostArray, " n"]:
        """Whether points of `faces` (n,), given as barycentric coordinates (n, 3), are cut out."""
        cut = np.zeros(len(faces), bool)
        at = np.flatnonzero(self.tested[faces])
        index, uv = self.index[faces[at]], np.einsum("nk,nkc->nc", weights[at], self.uv[faces[at]])
        factor = np.einsum("nk,nk->n", weights[at], self.alpha[faces[at]])
        for number in np.unique(index):
            of = index == number
            alpha = factor[of] * _read(self.images[number], self.samplers[number], *uv[of].T)
            cut[at[of]] = alpha < self.cutoff[number]
        return cut


def barycentrics_of(
    position: Float64[HostArray, "n 3"], corners: Float64[HostArray, "n 3 3"]
) -> Float64[HostArray, "n 3"]:
    """The barycentric coordinates of points in the planes of triangles; 1/3 each for a triangle without area."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    squared = np.sum(normal * normal, axis=1)
    of = lambda first, second: np.sum(np.cross(second - first, position - first) * normal, axis=1)
    parts = np.stack([of(b, c), of(c, a), of(a, b)], axis=1)
    return np.where(squared[:, None] > 0, parts / np.where(squared > 0, squared, 1)[:, None], 1 / 3)


def _read(
    image: Float64[HostArray, "h w"],
    sampler: Sampler,
    u: Float64[HostArray, " n"],
    v: Float64[HostArray, " n"],
) -> Float64[HostArray, " n"]:
    """The texel that holds a point of the image, or the mean of the four texels around it, by their distances."""
    (height, width), (along_u, along_v) = image.shape, sampler.wrap
    texel = lambda row, column: image[_wrapped(row, height, along_v), _wrapped(column, width, along_u)]
    x, y = u * width, v * height
    if sampler.filter == "nearest":
        return texel(np.floor(y).astype(np.int64), np.floor(x).astype(np.int64))
    x, y = x - 0.5, y - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, up = x - column, y - row
    lower = texel(row, column) * (1 - right) + texel(row, column + 1) * right
    return lower * (1 - up) + (texel(row + 1, column) * (1 - right) + texel(row + 1, column + 1) * right) * up


def _wrapped(number: Int[HostArray, " n"], size: int, wrap: str) -> Int[HostArray, " n"]:
    """The texels of the image, of `size` texels along an axis, that stand at these numbers along the whole axis."""
    if wrap == "repeat":
        return number % size
    if wrap == "clamp":
        return np.clip(number, 0, size - 1)
    # Two images long, the second mirrored.
    both = number % (2 * size)
    return np.where(both < size, both, 2 * size - 1 - both)
