"""Points within each pixel, on the plane of the surface that its centre sees."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arithmetic import dot, safe_norm
from .._checks import check_value
from .._types import HostArray
from ..geometry import AbstractCamera
from ..settings.quantities import PixelPointCount
from ._surface import Surface

# Of a plane that makes a smaller angle with the direction to the camera, whose sine this is, only one point is known.
_STEEPEST = 0.03
# The ratio of a Fibonacci number to the one before.
_GOLDEN = (1 + 5**0.5) / 2


class PixelPoints(eqx.Module):
    """Several points within each pixel of an image, from `points_within_pixels`.

    - `surface`: (count · h, w), the surface at the points: an image (h, w) for each point, stacked vertically.
    - `count`: of the points within a pixel.
    """

    surface: Surface
    count: int = eqx.field(static=True)

    def mean(self, values: Float[Array, "H w *c"]) -> Float[Array, "h w *c"]:
        """The mean over each pixel of values at all points, such as visibility."""
        return jnp.mean(values.reshape(self.count, -1, *values.shape[1:]), axis=0)


def points_within_pixels(surface: Surface, camera: AbstractCamera, count: int) -> PixelPoints:
    """Places `count` points in each pixel of `surface` (h, w), on the plane of the surface that the pixel's centre
    sees. If `count` is a Fibonacci number, the points form a Fibonacci lattice.

    A shadow's outline may be narrower than a pixel. Then few pixel centres lie in the outline, so the mean over the
    centres, and its derivative by the outline's position, are far off. No two points of such a lattice share a row or a
    column, so narrow lines along rows and columns are sampled as well as others. All points have the normal and colour
    of the pixel's centre. So are points of planes that the camera sees nearly edge-on. Positions are differentiable.

    **Arguments:**

    - `surface`: from `draw_surface` with the same `camera`.
    - `count`: 1, 2, 3, 5, 8, 13 or 21 are lattices.

    **Raises** `ValueError` if `count` is less than 1 or no whole number.

    !!! Example

        ```python
        points = raster.points_within_pixels(surface, camera, 8)
        points.mean(technique.visibility(state, points.surface)).shape  # (32, 32)
        ```
    """
    check_value("the count of points", count, PixelPointCount)
    if count == 1:
        return PixelPoints(surface, 1)
    x = (np.arange(count) + 0.5) / count
    y = (np.arange(count) * round(count / _GOLDEN) % count + 0.5) / count
    position = _moved(surface, camera, x - 0.5, y - 0.5).reshape(-1, *surface.position.shape[1:])
    several = jax.tree.map(lambda values: jnp.concatenate([values] * count), surface)
    return PixelPoints(dataclasses.replace(several, position=position), count)


def _moved(
    surface: Surface, camera: AbstractCamera, x: Float[HostArray, " n"], y: Float[HostArray, " n"]
) -> Float[Array, "n h w 3"]:
    """Where the rays through points `x` and `y` pixels away from each centre meet the plane seen at the centre.

    A point p is seen at (X, Y) if a · p + a₃ = 0 and b · p + b₃ = 0, with the rows a = m₀ - X m₃ and b = m₁ - Y m₃ of
    the matrix to clip space. With e and f the values of both at the centre's point, it moves by

        -(e (b x n) + f (n x a)) / (n · (a x b))
    """
    height, width = surface.mask.shape
    matrix, normal = camera.view().matrix, surface.normal
    columns = (np.arange(width) + 0.5) + x[:, None, None]
    rows = (np.arange(height) + 0.5)[:, None] + y[:, None, None]
    row = lambda k, at, size: matrix[k] - (jnp.asarray(at, matrix.dtype) * (2 / size) - 1)[..., None] * matrix[3]
    a, b = row(0, columns, width), row(1, rows, height)
    value = lambda row: dot(row[..., :3], surface.position) + row[..., 3]
    along_ray = jnp.cross(a[..., :3], b[..., :3])
    away = value(a)[..., None] * jnp.cross(b[..., :3], normal) + value(b)[..., None] * jnp.cross(normal, a[..., :3])
    across, length = dot(normal, along_ray), safe_norm(along_ray)
    is_steep = (jnp.abs(across) <= _STEEPEST * length) | ~surface.mask
    moves = away / jnp.where(is_steep, 1, across)[..., None]
    return surface.position - jnp.where(is_steep[..., None], 0, moves)
