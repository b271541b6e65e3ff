"""Points within each pixel, on the plane of the surface that its centre sees."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._arithmetic import dot, safe_norm
from .._types import VectorMap
from ..geometry import AbstractCamera
from ._surface import Surface

# Of a plane that makes a smaller angle with the direction to the camera, whose sine this is, only one point is known.
_STEEPEST = 0.03
# The ratio of a Fibonacci number to the one before.
_GOLDEN = (1 + 5**0.5) / 2


def points_within_pixels(surface: Surface, camera: AbstractCamera, count: int) -> Surface:
    """So many points in each pixel of an image (h, w): a Fibonacci lattice, if `count` is a Fibonacci number.

    No two points lie in one row or column of such a lattice, so that it sees narrow lines along these as often as
    others. Normals and colours are those of the pixel's centre. So are points of planes that the camera sees nearly
    edge-on.

    **Returns:** an image of (h, w) for each point, one above the other, (count · h, w). Positions are differentiable.
    """
    x = (np.arange(count) + 0.5) / count
    y = (np.arange(count) * round(count / _GOLDEN) % count + 0.5) / count
    each = [_moved(surface, camera, *place) for place in (np.stack([x, y], axis=1) - 0.5).tolist()]
    several = jax.tree.map(lambda values: jnp.concatenate([values] * count), surface)
    return dataclasses.replace(several, position=jnp.concatenate(each))


def _moved(surface: Surface, camera: AbstractCamera, x: float, y: float) -> VectorMap:
    """Where the ray through a point `x` and `y` pixels away from each centre meets the plane seen at the centre.

    A point p is seen at (X, Y) if a · p + a₃ = 0 and b · p + b₃ = 0, with the rows a = m₀ - X m₃ and b = m₁ - Y m₃ of
    the matrix to clip space. With e and f the values of both at the centre's point, it moves by

        -(e (b x n) + f (n x a)) / (n · (a x b))
    """
    height, width = surface.mask.shape
    matrix, normal = camera.view().matrix, surface.normal
    columns, rows = np.meshgrid(np.arange(width) + 0.5 + x, np.arange(height) + 0.5 + y)
    row = lambda k, at, size: matrix[k] - (jnp.asarray(at, matrix.dtype) * (2 / size) - 1)[..., None] * matrix[3]
    a, b = row(0, columns, width), row(1, rows, height)
    value = lambda row: dot(row[..., :3], surface.position) + row[..., 3]
    along_ray = jnp.cross(a[..., :3], b[..., :3])
    away = value(a)[..., None] * jnp.cross(b[..., :3], normal) + value(b)[..., None] * jnp.cross(normal, a[..., :3])
    across, length = dot(normal, along_ray), safe_norm(along_ray)
    is_steep = (jnp.abs(across) <= _STEEPEST * length) | ~surface.mask
    moves = away / jnp.where(is_steep, 1, across)[..., None]
    return surface.position - jnp.where(is_steep[..., None], 0, moves)
