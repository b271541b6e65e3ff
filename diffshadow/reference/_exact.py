"""Brute-force ray tracing in float64: slow, used to validate the fast tracer on small scenes."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float64, Int

from .._types import HostArray
from ..geometry import Scene
from ..settings.reference import Blockers, Sampler
from ..settings.reference import TracedReference as Settings
from ._rays import Hits, Rays, ShadowRays, Triangles
from ._reference import Reference
from ._tracer import AbstractTracer
from ._visibility import trace_with

# Ray-triangle pairs tested at once: at 3 float64 each they take tens of megabytes.
_PAIRS = 1 << 19
# A generous bound on float64 rounding in a frame where the scene's size is 1. Hits nearer than this are the ray's own
# start. A ray that passes an edge by less hits both its faces rather than neither.
_TINY = 1e-12


class ExactTracer(AbstractTracer):
    """Tests all rays against all `triangles` in float64. A shadow ray ignores the face it starts on.

    Möller and Trumbore, "Fast, minimum storage ray-triangle intersection", Journal of Graphics Tools 2(1), 1997.
    """

    dtype = np.float64

    def __init__(self, triangles: Triangles):
        self._corner = triangles.corners[:, 0]
        self._edges = triangles.corners[:, 1:] - triangles.corners[:, :1]
        self._numbers, self._cutouts = triangles.numbers, triangles.cutouts

    def closest(self, rays: Rays) -> Int[HostArray, " n"]:
        face = np.full(len(rays.origin), -1, dtype=np.int32)
        for part in self._parts(len(face)):
            distance = self._distances(rays.origin[part], rays.direction[part])
            distance = np.where((distance >= 0) & (distance <= rays.reach[part, None]), distance, np.inf)
            nearest = distance.argmin(axis=1)
            face[part] = np.where(np.isfinite(distance.min(axis=1)), nearest, -1)
        return face

    def start(self, hits: Hits) -> Float64[HostArray, "n 3"]:
        return hits.position

    def occluded(self, rays: ShadowRays) -> Bool[HostArray, " r"]:
        origin, face, which, direction, reach = rays
        hit = np.zeros(len(which), dtype=bool)
        for part in self._parts(len(which)):
            distance = self._distances(origin[which[part]], direction[part])
            nearest = _TINY / np.linalg.norm(direction[part], axis=-1, keepdims=True)
            others = self._numbers != face[which[part], None]
            hit[part] = ((distance > nearest) & (distance < reach) & others).any(axis=1)
        return hit

    def _parts(self, count: int) -> list[slice]:
        step = max(1, _PAIRS // len(self._corner))
        return [slice(k, min(k + step, count)) for k in range(0, count, step)]

    def _distances(
        self, origin: Float64[HostArray, "n 3"], direction: Float64[HostArray, "n 3"]
    ) -> Float64[HostArray, "n f"]:
        """The distance to each triangle along each ray, in multiples of `direction`, (n, f); infinite for a miss."""
        first, second = self._edges[:, 0], self._edges[:, 1]
        p = np.cross(direction[:, None], second)
        determinant = np.einsum("nfd,fd->nf", p, first)
        parallel = determinant == 0
        inverse = 1 / np.where(parallel, 1, determinant)
        s = origin[:, None] - self._corner
        u = np.einsum("nfd,nfd->nf", s, p) * inverse
        q = np.cross(s, first)
        v = np.einsum("nfd,nd->nf", q, direction) * inverse
        inside = ~parallel & (u >= -_TINY) & (v >= -_TINY) & (u + v <= 1 + _TINY)
        if self._cutouts is not None:
            ray, face = np.nonzero(inside & self._cutouts.tested)
            b, c = u[ray, face], v[ray, face]
            inside[ray, face] = ~self._cutouts.contain(face, np.stack([1 - b - c, b, c], axis=1))
        return np.where(inside, np.einsum("nfd,fd->nf", q, second) * inverse, np.inf)


def trace_visibility_exact(
    scene: Scene,
    samples: int = Settings.samples,
    sampler: Sampler = Settings.sampler,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    supersampling: int = Settings.supersampling,
    blockers: Blockers = Settings.blockers,
) -> Reference:
    """`trace_visibility` with every ray in float64 and tested against every triangle.

    Meant for scenes of a few hundred triangles and images of a few thousand pixels: the time grows with the product of
    pixels, samples and triangles. Arguments, result, errors and sample points are as in `trace_visibility`, so the
    two results differ by rounding only.
    """
    return trace_with(ExactTracer, scene, samples, sampler, seed, progress, supersampling, blockers)
