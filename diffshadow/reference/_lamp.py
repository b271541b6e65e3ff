"""Which way a light lies, in float64 and without a call into JAX for each ray."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64

from .._misc import round_up_to_power_of_two
from .._types import HostArray
from ..geometry import AbstractLight
from ._rays import Triangles, in_float64

# The samples that tell where a flat light's centre and the ends of its axes lie.
_AXES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
# A prediction within this fraction of the vectors is exact but for rounding.
_ROUNDING = 1e-9
# The least number of vectors asked for at once.
_LEAST = 32


class Lamp:
    """A light as shadow rays want it: vectors from points of the scene to points of the light.

    To most lights the vector is `centre + x · right + y · up` for the sample `(x, y)`. A light that keeps its place,
    `right` and `up` for all points of the scene, as every flat or infinitely far one does, is evaluated in NumPy; for
    one that shows each point another face, as a sphere does, these three come from its own `towards`. A light of any
    other shape gives every vector by its `towards`.
    """

    def __init__(self, light: AbstractLight, triangles: Triangles):
        self.has_size = light.has_size
        self.is_directional = light.is_directional
        self._light = light
        self._triangles = triangles
        # Probe the light: do its axes foretell the vectors to other samples, and are they the same everywhere?
        rng = np.random.default_rng(0)
        points, samples = rng.uniform(-1, 1, (9, 3)), rng.uniform(-0.7, 0.7, (9, 2))
        points[0] = 0
        found = self._towards(points, samples)
        centre, axes = self._centre_and_axes(points)
        self._origin, self._axes = centre[0], axes[0]
        of_place = self._origin - (0 if self.is_directional else points) + samples @ self._axes
        of_point = centre + np.einsum("ns,nsd->nd", samples, axes)
        limit = _ROUNDING * (1 + float(np.abs(found).max()))
        self._is_flat = bool(np.abs(found - of_place).max() < limit)
        self._has_axes = bool(np.abs(found - of_point).max() < limit)

    def vectors(
        self,
        points: Float64[HostArray, "n 3"],
        normals: Float64[HostArray, "n 3"],
        samples: Float[HostArray, "n s 2"],
    ) -> tuple[Float[HostArray, "n s 3"], Float[HostArray, "n s"]]:
        """Vectors to `samples` of the light, and how high they rise above the surface.

        **Arguments:**

        - `points`, `normals`: (n, 3), of the surface, in the tracing frame.
        - `samples`: (n, s, 2), points of the light's domain; their dtype is that of the result.

        **Returns:** (n, s, 3), and their dot products with the normals, (n, s).
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
        # Project before rounding: on a surface that is edge-on to the light, only the sign is left.
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
        """Vectors from `points` to the light's centre, and from there to the ends of its axes."""
        spread = np.repeat(points, len(_AXES), axis=0)
        ends = self._towards(spread, np.tile(_AXES, (len(points), 1))).reshape(-1, len(_AXES), 3)
        return ends[:, 0], ends[:, 1:] - ends[:, :1]

    def _towards(
        self, points: Float64[HostArray, "n 3"], samples: Float64[HostArray, "n 2"]
    ) -> Float64[HostArray, "n 3"]:
        # Few lengths, for each is compiled.
        count = len(points)
        padding = [(0, max(_LEAST, round_up_to_power_of_two(count)) - count), (0, 0)]
        world, samples = np.pad(self._triangles.to_world(points), padding, mode="edge"), np.pad(samples, padding)
        with jax.enable_x64(True):
            towards = _compiled_towards(in_float64(self._light), jnp.asarray(world), jnp.asarray(samples))
        towards = np.asarray(towards)[:count]
        return towards if self.is_directional else towards * self._triangles.scale


@eqx.filter_jit
def _compiled_towards(
    light: AbstractLight, points: Float[Array, "n 3"], samples: Float[Array, "n 2"]
) -> Float[Array, "n 3"]:
    return light.towards(points, samples)
