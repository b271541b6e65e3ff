"""Vectors to points of a light, in float64 and without a JAX call per ray."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Float64

from .._arithmetic import as_float, in_float64
from .._padding import round_up_to_power_of_two
from .._types import HostArray
from ..geometry import AbstractLight
from ._rays import Triangles

# Samples at the centre of a flat light and at the ends of its axes.
_AXES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
# A prediction is exact up to rounding if it is within this fraction of the vectors' size.
_ROUNDING = 1e-9
# The smallest batch of vectors, to which smaller ones are padded.
_LEAST = 32


class Lamp:
    """Computes vectors from points of the scene to points of a light.

    For most lights the vector to the sample `(x, y)` is `centre + x · right + y · up`. There are three cases:

    - Flat and directional lights have the same centre, `right` and `up` for all points. They are evaluated in NumPy.
    - Lights such as a sphere turn towards each point. Their `towards` is called for the centre and axes only.
    - For lights of any other shape, `towards` is called for every vector.
    """

    def __init__(self, light: AbstractLight, triangles: Triangles):
        self.has_size = light.has_size
        self.is_directional = light.is_directional
        self._light = light
        self._triangles = triangles
        # Probe the light at random points: do its axes predict the vectors, and are the axes the same everywhere?
        rng = np.random.default_rng(0)
        points, samples = rng.uniform(-1, 1, (9, 3)), rng.uniform(-0.7, 0.7, (9, 2))
        points[0] = 0
        actual = self._towards(points, samples)
        centre, axes = self._centre_and_axes(points)
        self._origin, self._axes = centre[0], axes[0]
        by_fixed_axes = self._origin - (0 if self.is_directional else points) + samples @ self._axes
        by_own_axes = centre + np.einsum("ns,nsd->nd", samples, axes)
        limit = _ROUNDING * (1 + float(np.abs(actual).max()))
        self._is_flat = bool(np.abs(actual - by_fixed_axes).max() < limit)
        self._has_axes = bool(np.abs(actual - by_own_axes).max() < limit)

    def vectors(
        self,
        points: Float64[HostArray, "n 3"],
        normals: Float64[HostArray, "n 3"],
        samples: Float[HostArray, "n s 2"],
    ) -> tuple[Float[HostArray, "n s 3"], Float[HostArray, "n s"]]:
        """Vectors to `samples` of the light, and their heights above the surface's tangent plane.

        **Arguments:**

        - `points`, `normals`: (n, 3), points and normals of the surface, in the tracing frame.
        - `samples`: (n, s, 2), points of the light's domain; the result has their dtype.

        **Returns:** the vectors, (n, s, 3), and their dot products with the normals, (n, s).
        """
        dtype = samples.dtype
        if not (self._is_flat or self._has_axes):
            spread = np.repeat(points, samples.shape[1], axis=0)
            exact = self._towards(spread, samples.reshape(-1, 2).astype(np.float64)).reshape(*samples.shape[:2], 3)
            return exact.astype(dtype), np.einsum("nsd,nd->ns", exact, normals).astype(dtype)
        if self._is_flat:
            centre = np.broadcast_to(self._origin, points.shape) if self.is_directional else self._origin - points
            axes = self._axes[None]
        else:
            centre, axes = self._centre_and_axes(points)
        x, y = samples[..., 0], samples[..., 1]
        # Project before rounding: on a surface edge-on to the light, the sign of the height decides.
        right, up = np.einsum("nd,nsd->sn", normals, np.broadcast_to(axes, (len(points), 2, 3))).astype(dtype)
        height = x * right[:, None] + y * up[:, None] + np.sum(centre * normals, axis=-1).astype(dtype)[:, None]
        axes, centre = axes.astype(dtype), centre.astype(dtype)
        vectors = np.empty((*samples.shape[:2], 3), dtype=dtype)
        for k in range(3):
            vectors[..., k] = x * axes[:, 0, k, None] + y * axes[:, 1, k, None] + centre[:, k, None]
        return vectors, height

    def _centre_and_axes(
        self, points: Float64[HostArray, "n 3"]
    ) -> tuple[Float64[HostArray, "n 3"], Float64[HostArray, "n 2 3"]]:
        """Vectors from `points` to the light's centre, and from the centre to the ends of its axes."""
        spread = np.repeat(points, len(_AXES), axis=0)
        ends = self._towards(spread, np.tile(_AXES, (len(points), 1))).reshape(-1, len(_AXES), 3)
        return ends[:, 0], ends[:, 1:] - ends[:, :1]

    def _towards(
        self, points: Float64[HostArray, "n 3"], samples: Float64[HostArray, "n 2"]
    ) -> Float64[HostArray, "n 3"]:
        # Padded to few distinct lengths, since each length is compiled separately.
        count = len(points)
        padding = [(0, max(_LEAST, round_up_to_power_of_two(count)) - count), (0, 0)]
        world, samples = np.pad(self._triangles.to_world(points), padding, mode="edge"), np.pad(samples, padding)
        with jax.enable_x64(True):
            towards = _compiled_towards(in_float64(self._light), as_float(world), as_float(samples))
        towards = np.asarray(towards)[:count]
        return towards if self.is_directional else towards * self._triangles.scale


@eqx.filter_jit
def _compiled_towards(
    light: AbstractLight, points: Float[Array, "n 3"], samples: Float[Array, "n 2"]
) -> Float[Array, "n 3"]:
    return light.towards(points, samples)
