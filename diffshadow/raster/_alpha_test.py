"""The alpha test: the pixels that a triangle's texture cuts out, like `discard` in a fragment shader.

Texture coordinates are perspective-correct. If the corners' (x, y, w) are the columns of M, their weights at the point
(X, Y) of the view are M⁻¹ (X, Y, 1) up to a factor (2D homogeneous rasterization, Olano & Greer 1997). Triangles that
reach behind the eye therefore need no clipping here. There are no mipmaps.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import safe_divide, take
from .._types import ClipVertices, Faces, Viewport
from ..geometry import Textures, read_texels


class Cutouts(NamedTuple):
    """The parts of textures that an alpha test reads: the `alpha` of all texels (n, 1), and the textures' `table`,
    `cutoff` and `samplers`."""

    alpha: Float[Array, "n 1"]
    table: Int[Array, "t 3"]
    cutoff: Float[Array, " t"]
    samplers: Int[Array, "t 3"] | None

    @classmethod
    def of(cls, textures: Textures) -> "Cutouts":
        """The alpha textures of textures with cutoffs."""
        assert textures.cutoff is not None
        return cls(textures.texels[:, 3:], textures.table, textures.cutoff, textures.samplers)

    def passes(
        self, index: Int[Array, "*m"], uv: Float[Array, "*m 2"], factor: Float[Array, "*m"] | None
    ) -> Bool[Array, "*m"]:
        """Whether points with these textures and texture coordinates pass the test. `factor` is the mean alpha of their
        corners, if the corners have one."""
        alpha = read_texels(self.alpha, self.table, self.samplers, index, uv)[..., 0]
        alpha = alpha if factor is None else alpha * factor
        return (index < 0) | (alpha >= take(self.cutoff, jnp.maximum(index, 0)))


class AlphaForm(NamedTuple):
    """Texture coordinates of triangles relative to each triangle's first pixel, (n,) each.

    At `i` pixels to the right of that pixel and `j` pixels above it, the texture coordinates are `u / w` and `v / w`.
    The mean alpha of the corners is `alpha / w`. Each of the four is its first number, plus `i` times its second, plus
    `j` times its third. A window begins `x` pixels to the right and `y` pixels above. The coordinates of a pixel are
    therefore the same in every part of an image.
    """

    u: list[Float[Array, " n"]]
    v: list[Float[Array, " n"]]
    w: list[Float[Array, " n"]]
    x: Int[Array, " n"]
    y: Int[Array, " n"]
    texture: Int[Array, " n"]
    alpha: list[Float[Array, " n"]] | None


class AlphaTest:
    """Tests the pixels of triangles against their textures' cutoffs.

    **Arguments:**

    - `textures`: the textures of the faces, with cutoffs.
    - `clip`, `faces`, `resolution`: as for `rasterize`, for the whole image.
    """

    def __init__(self, textures: Textures, clip: ClipVertices, faces: Faces, resolution: Viewport):
        self.clip, self.faces, self.resolution = clip, faces, resolution
        self.index, self.cutouts = textures.index, Cutouts.of(textures)
        self.uv, self.corner_alpha = textures.uv - textures.whole_repetitions, textures.corner_alpha

    def form(self, face: Int[Array, " n"], x: Int[Array, " n"], y: Int[Array, " n"]) -> AlphaForm:
        """The texture coordinates of faces in windows that begin at the pixels (`x`, `y`) of the image."""
        corners, uv = take(self.clip, take(self.faces, face)), take(self.uv, face)
        # In single precision, whatever the default precision.
        height, width = (jnp.asarray(size, jnp.float32) for size in self.resolution)
        centre = lambda pixel, size: (pixel.astype(jnp.float32) + 0.5) * (2 / size) - 1
        w = [corners[:, k, 3] for k in range(3)]
        first_x, first_y = (self._pixel(corners[:, 0, axis], w[0], size) for axis, size in enumerate((width, height)))
        xs, ys = (
            [corners[:, k, axis] - at * w[k] for k in range(3)]
            for axis, at in enumerate((centre(first_x, width), centre(first_y, height)))
        )
        pairs = ((1, 2), (2, 0), (0, 1))
        along_x, along_y, here = (
            [a[i] * b[j] - a[j] * b[i] for i, j in pairs] for a, b in ((ys, w), (w, xs), (xs, ys))
        )
        rows = here, [each * (2 / width) for each in along_x], [each * (2 / height) for each in along_y]
        total = lambda values: [_sum_of(row, values) for row in rows]
        ones = [jnp.ones_like(values) for values in w]
        u, v = ([uv[:, k, axis] for k in range(3)] for axis in range(2))
        alpha = None
        if self.corner_alpha is not None:
            of_corners = take(self.corner_alpha, face)
            alpha = total([of_corners[:, k] for k in range(3)])
        return AlphaForm(total(u), total(v), total(ones), x - first_x, y - first_y, take(self.index, face), alpha)

    @staticmethod
    def _pixel(at: Float[Array, " n"], w: Float[Array, " n"], size: Float[Array, ""]) -> Int[Array, " n"]:
        """The pixel at a clip coordinate, or the nearest pixel of the image. Arbitrary for a corner behind the eye."""
        place = (safe_divide(at, jnp.maximum(w, 0)) * 0.5 + 0.5) * size
        return jnp.clip(place, 0, size - 1).astype(jnp.int32)

    def passes(self, form: AlphaForm, side: int) -> Bool[Array, "n side side"]:
        """Which of the `side` x `side` pixels from each triangle's first pixel pass the test."""
        i = jnp.arange(side, dtype=jnp.int32)
        each = lambda values: values[:, None, None]
        x, y = (each(form.x) + i).astype(jnp.float32), (each(form.y) + i[:, None]).astype(jnp.float32)
        at = lambda numbers: each(numbers[0]) + each(numbers[1]) * x + each(numbers[2]) * y
        u, v, w = map(at, form[:3])
        uv = jnp.stack([safe_divide(u, w), safe_divide(v, w)], axis=-1)
        factor = None if form.alpha is None else safe_divide(at(form.alpha), w)
        return self.cutouts.passes(jnp.broadcast_to(each(form.texture), u.shape), uv, factor)


def _sum_of(weights: list[Array], values: list[Array]) -> Any:
    return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
