"""Ray tracing with Embree: float32, fast, watertight."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Float64, Int

from .._types import HostArray
from ..geometry import Mesh
from ._cutouts import barycentrics_of
from ._rays import Hits, Rays, ShadowRays, Triangles, hits_on_planes
from ._tracer import AbstractTracer

_ROUNDING = 2.0**-24
# Origins and corners lie in [-1, 1]³ and are rounded to float32: each is off by at most sqrt(3)/2 roundings, and
# Embree's subtraction of them adds the same amount. Over random triangles, 4 roundings were enough to avoid self-hits.
_ROUNDINGS_OF_POSITION = 8.0
# The float32 normal of a face with longest edge L and height h is tilted by about L/h roundings, which lifts its plane
# by at most L²/h roundings. The largest lift measured over random triangles is 0.1 of that.
_ROUNDINGS_OF_TILT = 0.25
# Faces thinner than this are invisible at any resolution, and the offset must not become visible.
_MAX_SLENDERNESS = 2.0**14
# A ray passes through so many cut-outs at most; what it then meets stops it.
_MOST_LAYERS = 4096


class EmbreeTracer(AbstractTracer):
    """Embree's robust mode over `triangles`.

    Embree rounds to float32, so a ray that starts on a surface may hit that same surface. Shadow rays therefore start
    at an offset along the normal that bounds the rounding. In the tracing frame the bound is nearly constant, about
    5e-7 of half the scene's extent; long thin triangles need more. `offsets` holds it for each face.

    Wächter and Binder, "A fast and robust method for avoiding self-intersection", Ray Tracing Gems, chapter 6, 2019,
    offset each coordinate by units in the last place instead.
    """

    dtype = np.float32

    def __init__(self, triangles: Triangles):
        self.offsets = self_hit_offsets(triangles)
        self._triangles, self._scene = triangles, _scene_of(triangles)
        self._whole, self._cut = self._scene, None
        if triangles.cutouts is not None and triangles.cutouts.tested.any():
            # Whole triangles stop shadow rays at once; rays pass through parts of the others.
            tested = triangles.cutouts.tested
            self._whole = None if tested.all() else _scene_of(triangles.only(~tested))
            self._cut = EmbreeTracer._of_cut(triangles.only(tested))

    @classmethod
    def _of_cut(cls, triangles: Triangles) -> "EmbreeTracer":
        """Of triangles that all have an alpha test, for rays to any of them."""
        tracer = object.__new__(cls)
        tracer.offsets, tracer._triangles = self_hit_offsets(triangles), triangles
        tracer._scene = _scene_of(triangles)
        tracer._whole, tracer._cut = None, tracer
        return tracer

    def closest(self, rays: Rays) -> Int[HostArray, " n"]:
        found = self._first(rays)
        if self._cut is None:
            return found
        cutouts = self._triangles.cutouts
        assert cutouts is not None
        waiting, ahead = np.arange(len(found)), rays
        for _ in range(_MOST_LAYERS):
            # Of the rays that are under way, those that have met a cut-out go on behind it.
            face = found[waiting]
            met = np.flatnonzero(face >= 0)
            met = met[cutouts.tested[face[met]]]
            ahead, waiting, face = Rays(*(values[met] for values in ahead)), waiting[met], face[met]
            hits = hits_on_planes(ahead, face, self._triangles)
            cut = cutouts.contain(face, barycentrics_of(hits.position, self._triangles.corners[face]))
            if not cut.any():
                break
            hits, waiting = Hits(*(values[cut] for values in hits)), waiting[cut]
            origin = hits.position - self.offsets[hits.face, None] * hits.normal
            gone = np.sum((origin - ahead.origin[cut]) * ahead.direction[cut], axis=1)
            ahead = Rays(origin, ahead.direction[cut], ahead.reach[cut] - gone)
            found[waiting] = np.where(ahead.reach > 0, self._first(ahead), -1)
        return found

    def _first(self, rays: Rays) -> Int[HostArray, " n"]:
        """The first face that each ray hits, whole or not."""
        single = (np.ascontiguousarray(values, np.float32) for values in (rays.origin, rays.direction, rays.reach))
        origin, direction, reach = single
        return self._scene.run(origin, direction, dists=reach)

    def start(self, hits: Hits) -> Float64[HostArray, "n 3"]:
        offset = hits.position + self.offsets[hits.face, None] * hits.normal
        # Rounded here, so that directions to near lights are computed from the ray's actual origin.
        return offset.astype(np.float32).astype(np.float64)

    def occluded(self, rays: ShadowRays) -> Bool[HostArray, " r"]:
        origin, _, which, direction, reach = rays
        starts = np.take(origin.astype(np.float32), which, axis=0)
        if self._whole is None:
            hit = np.zeros(len(which), bool)
        else:
            hit = self._whole.run(starts, direction, dists=reach, query="OCCLUDED") != -1
        if self._cut is not None:
            free = np.flatnonzero(~hit)
            towards = direction[free].astype(np.float64)
            length = np.linalg.norm(towards, axis=1)
            rest = Rays(starts[free].astype(np.float64), towards / length[:, None], reach * length)
            hit[free] = self._cut.closest(rest) >= 0
        return hit


def _scene_of(triangles: Triangles) -> EmbreeScene:
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(triangles.corners, dtype=np.float32))
    # The first query builds the BVH, which is not thread-safe.
    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
    return scene


def occluded(
    mesh: Mesh, points: Float[HostArray, "n 3"], directions: Float[HostArray, "n 3"], reach: float
) -> Bool[HostArray, " n"]:
    """Whether a mesh blocks the rays that start at points, (n,). None of the points lies on the mesh.

    **Arguments:**

    - `reach`: how far the rays go, in multiples of `directions`; may be infinite.
    """
    scene = EmbreeScene(robust=True)
    single = lambda values: np.ascontiguousarray(values, dtype=np.float32)
    TriangleMesh(scene, single(np.asarray(mesh.vertices)[np.asarray(mesh.faces)]))
    return scene.run(single(points), single(directions), dists=reach, query="OCCLUDED") != -1


def self_hit_offsets(triangles: Triangles) -> Float64[HostArray, " f"]:
    """The distance from each face at which a float32 shadow ray must start, (f,), in the tracing frame."""
    edges = np.linalg.norm(triangles.corners - np.roll(triangles.corners, 1, axis=1), axis=-1)
    longest = edges.max(axis=1)
    height = 2 * triangles.areas / np.where(longest == 0, 1, longest)
    slenderness = np.minimum(longest**2 / np.maximum(height, 1e-30), _MAX_SLENDERNESS)
    return _ROUNDING * (_ROUNDINGS_OF_POSITION + _ROUNDINGS_OF_TILT * slenderness)
