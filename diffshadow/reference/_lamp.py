"""Which way a light lies, in float64 and without a call into JAX for each ray."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64

from .._types import HostArray
from ..geometry import AbstractLight
from ._rays import Triangles, in_float64


class Lamp:
    """A light as shadow rays want it: vectors from points of the scene to points of the light's disk.

    A light whose vector is `centre(point) + x · right + y · up` for the point `(x, y)` of its disk, as every flat or
    infinitely far disk's is, is evaluated in NumPy; any other one by its own `towards`.
    """

    def __init__(self, light: AbstractLight, triangles: Triangles):
        self.has_size = light.has_size
        self.is_directional = light.is_directional
        self._light = light
        self._triangles = triangles
        # Probe the light at the frame's origin, for its centre and the ends of its disk's axes, and at a few other
        # points of the scene and of the disk, where these must foretell the vectors.
        rng = np.random.default_rng(0)
        points = np.concatenate([np.zeros((3, 3)), rng.uniform(-1, 1, (8, 3))])
        disk = np.concatenate([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], rng.uniform(-0.7, 0.7, (8, 2))])
        found = self._towards(points, disk)
        self._origin = found[0]
        self._axes = found[1:3] - found[0]
        foretold = self._origin - (0 if self.is_directional else points) + disk @ self._axes
        scale = 1 + float(np.abs(foretold).max())
        self._is_flat = bool(np.abs(found - foretold).max() < 1e-9 * scale)

    def vectors(
        self,
        points: Float64[HostArray, "n 3"],
        normals: Float64[HostArray, "n 3"],
        disk: Float[HostArray, "n s 2"],
    ) -> tuple[Float[HostArray, "n s 3"], Float[HostArray, "n s"]]:
        """Vectors to the points `disk` of the light, and how high they rise above the surface.

        **Arguments:**

        - `points`, `normals`: (n, 3), of the surface, in the tracing frame.
        - `disk`: (n, s, 2), points of the unit disk; its dtype is that of the result.

        **Returns:** (n, s, 3), and their dot products with the normals, (n, s).
        """
        dtype = disk.dtype
        if not self._is_flat:
            spread = np.broadcast_to(points[:, None], (*disk.shape[:2], 3))
            exact = self._towards(spread, disk.astype(np.float64))
            return exact.astype(dtype), np.einsum("nsd,nd->ns", exact, normals).astype(dtype)
        centre = np.broadcast_to(self._origin, points.shape) if self.is_directional else self._origin - points
        x, y = disk[..., 0], disk[..., 1]
        # Project before rounding: on a surface that is edge-on to the light, only the sign is left.
        right, up = (normals @ self._axes.T).astype(dtype).T
        height = x * right[:, None] + y * up[:, None] + np.sum(centre * normals, axis=-1).astype(dtype)[:, None]
        axes, centre = self._axes.astype(dtype), centre.astype(dtype)
        vectors = np.empty((*disk.shape[:2], 3), dtype=dtype)
        for k in range(3):
            vectors[..., k] = x * axes[0, k] + y * axes[1, k] + centre[:, k, None]
        return vectors, height

    def _towards(
        self, points: Float64[HostArray, "*n 3"], disk: Float64[HostArray, "*n 2"]
    ) -> Float64[HostArray, "*n 3"]:
        with jax.enable_x64(True):
            world = self._triangles.to_world(points)
            towards = np.asarray(_compiled_towards(in_float64(self._light), jnp.asarray(world), jnp.asarray(disk)))
        return towards if self.is_directional else towards * self._triangles.scale


@eqx.filter_jit
def _compiled_towards(
    light: AbstractLight, points: Float[Array, "*n 3"], disk: Float[Array, "*n 2"]
) -> Float[Array, "*n 3"]:
    return light.towards(points, disk)
