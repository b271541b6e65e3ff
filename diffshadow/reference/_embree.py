"""Rays by Embree: float32, fast, watertight."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Float64, Int

from .._types import HostArray
from ._rays import Hits, Rays, Triangles
from ._tracer import AbstractTracer

_ROUNDING = 2.0**-24
# Origins and corners lie in [-1, 1]³ and are rounded to float32: each is off by at most sqrt(3)/2 roundings, and
# Embree's subtraction of them adds as much again. Measured over random triangles, 4 roundings leave no self-hit.
_ROUNDINGS_OF_POSITION = 8.0
# The float32 normal of a face of longest edge L and height h is tilted by about L/h roundings, which lifts its plane by
# L²/h of them at most. Measured over random triangles: 0.1 of that.
_ROUNDINGS_OF_TILT = 0.25
# Past this a face is too thin for a pixel to see, and the offset must not grow visible.
_MAX_SLENDERNESS = 2.0**14


class EmbreeTracer(AbstractTracer):
    """Embree's robust mode over `triangles`.

    Embree rounds to float32, so that a ray that starts on a surface may meet that very surface. Shadow rays therefore
    start off it, along its normal, by a bound on that rounding. In the tracing frame the bound is nearly a constant,
    some 5e-7 of half the scene's extent; long thin triangles need more, and `offsets` says how much.

    Wächter and Binder, "A fast and robust method for avoiding self-intersection", Ray Tracing Gems, chapter 6, 2019,
    reach the same end by stepping in units in the last place of each coordinate.
    """

    dtype = np.float32

    def __init__(self, triangles: Triangles):
        self.offsets = self_hit_offsets(triangles)
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, np.ascontiguousarray(triangles.corners, dtype=np.float32))
        # The first query builds the hierarchy, which is not safe to do from several threads.
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def closest(self, rays: Rays) -> Int[HostArray, "n"]:
        return self._scene.run(
            rays.origin.astype(np.float32), rays.direction.astype(np.float32), dists=rays.reach.astype(np.float32)
        )

    def start(self, hits: Hits) -> Float64[HostArray, "n 3"]:
        offset = hits.position + self.offsets[hits.face, None] * hits.normal
        # Rounded here, so that the direction to a near light is taken from where the ray does start.
        return offset.astype(np.float32).astype(np.float64)

    def occluded(
        self,
        origin: Float64[HostArray, "n 3"],
        face: Int[HostArray, "n"],
        which: Int[HostArray, "r"],
        direction: Float[HostArray, "r 3"],
        reach: float,
    ) -> Bool[HostArray, "r"]:
        starts = np.take(origin.astype(np.float32), which, axis=0)
        return self._scene.run(starts, direction, dists=reach, query="OCCLUDED") != -1


def self_hit_offsets(triangles: Triangles) -> Float64[HostArray, "f"]:
    """How far off each face a float32 shadow ray must start, (f,), in the tracing frame."""
    edges = np.linalg.norm(triangles.corners - np.roll(triangles.corners, 1, axis=1), axis=-1)
    longest = edges.max(axis=1)
    height = 2 * triangles.areas / np.where(longest == 0, 1, longest)
    slenderness = np.minimum(longest**2 / np.maximum(height, 1e-30), _MAX_SLENDERNESS)
    return _ROUNDING * (_ROUNDINGS_OF_POSITION + _ROUNDINGS_OF_TILT * slenderness)
