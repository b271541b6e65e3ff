"""Which way a light lies, in float64 and without a call into JAX for each ray."""

import jax
import numpy as np
from jaxtyping import Float, Float64

from .._types import HostArray
from ..geometry import AbstractLight
from ._rays import Triangles, in_float64


class Lamp:
    """A light as shadow rays want it: `centre(points)` and the vectors to points of its disk.

    A light whose vector is `centre(point) + x · right + y · up` for the point `(x, y)` of its disk, as every flat or
    infinitely far disk's is, is evaluated in NumPy; any other one by its own `towards`.
    """

    def __init__(self, light: AbstractLight, triangles: Triangles):
        self.has_size = light.has_size
        self.is_directional = light.is_directional
        self._light = light
        self._triangles = triangles
        # Probe the light at the frame's origin: its centre, and where the disk's axes lead.
        probes = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        origin, right, up = self._towards(np.zeros((3, 3)), probes)
        self._origin, self._axes = origin, np.stack([right - origin, up - origin])
        self._is_flat = self._holds_elsewhere()

    def centre(self, points: Float64[HostArray, "n 3"]) -> Float64[HostArray, "n 3"]:
        """Vectors from `points` (n, 3) to the light's centre, in the tracing frame."""
        if self._is_flat:
            return np.broadcast_to(self._origin, points.shape) if self.is_directional else self._origin - points
        return self._towards(points, np.zeros((len(points), 2)))

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
        centre = self.centre(points)
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
            towards = np.asarray(in_float64(self._light).towards(jax.numpy.asarray(world), jax.numpy.asarray(disk)))
        return towards if self.is_directional else towards * self._triangles.scale

    def _holds_elsewhere(self) -> bool:
        """Whether the form found at the origin holds at a few other points of the scene and of the disk."""
        rng = np.random.default_rng(0)
        points, disk = rng.uniform(-1, 1, (8, 3)), rng.uniform(-0.7, 0.7, (8, 2))
        expected = self._origin - (0 if self.is_directional else points) + disk @ self._axes
        scale = 1 + float(np.abs(expected).max())
        return bool(np.abs(self._towards(points, disk) - expected).max() < 1e-9 * scale)
