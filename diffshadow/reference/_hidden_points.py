"""Surfaces behind others, as seen from a light: where shadows fall, whether a camera sees them or not."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from .._arithmetic import as_float, normalize
from .._types import HostArray
from ..geometry import Scene
from ._embree import EmbreeTracer
from ._rays import Rays, Triangles, hits_on_planes

# A ray meets so many surfaces on its way out of a caster.
_MOST_SURFACES = 8
# In the tracing frame: a ray goes on so far behind a surface. What lies closer behind it touches it.
_STEP = 1e-5


class HiddenPoints(NamedTuple):
    """Points that casters hide from a light. All lengths are in world units.

    - `caster`: (n,), the index, among the given faces, of the face that hides a point.
    - `position`, `normal`: (n, 3), the hidden points, and unit normals there, turned to the light.
    - `area`: (n,), the caster's area across the light that each point represents.
    """

    caster: Int[HostArray, " n"]
    position: Float32[HostArray, "n 3"]
    normal: Float32[HostArray, "n 3"]
    area: Float64[HostArray, " n"]


def hidden_points(scene: Scene, faces: Int[HostArray, " n"], solid: Bool[HostArray, " f"]) -> HiddenPoints:
    """The hidden points along rays that start on a face and go away from the light.

    Rays pass through solids: a point inside a solid, or where a solid touches the surface that it rests on, is not a
    hidden point. Rays also end where they leave the scene.

    **Arguments:**

    - `scene`: concrete, not traced by JAX, with one light.
    - `faces`: (n,), where rays start: faces of the scene's mesh, some of them many times. Points are random.
    - `solid`: (f,), whether each face of the scene's mesh is a part of a closed surface that bounds a volume.
    """
    triangles = Triangles(scene.mesh)
    tracer = EmbreeTracer(triangles)
    rng = np.random.default_rng(0)
    a, b = rng.uniform(size=(2, len(faces), 1))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    corners = triangles.corners[faces]
    start = corners[:, 0] + a * (corners[:, 1] - corners[:, 0]) + b * (corners[:, 2] - corners[:, 0])
    world = as_float(triangles.to_world(start))
    away = -np.asarray(normalize(scene.light.towards(world)), np.float64)
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    across = np.abs(np.sum(triangles.normals[faces] * away, axis=-1))
    times = np.bincount(faces, minlength=len(solid))[faces]
    area = triangles.areas[faces] * across / times

    depth, way = solid[faces].astype(int), np.arange(len(faces))
    origin = start + _STEP * away
    found: list[tuple[HostArray, HostArray, HostArray]] = []
    for _ in range(_MOST_SURFACES):
        rays = Rays(origin[way], away[way], np.full(len(way), np.inf))
        face = tracer.closest(rays)
        met = np.flatnonzero(face >= 0)
        way, face, rays = way[met], face[met], Rays(*(values[met] for values in rays))
        if not len(way):
            break
        hits = hits_on_planes(rays, face, triangles)
        origin[way] = hits.position + _STEP * rays.direction
        enters = np.sum(triangles.normals[face] * rays.direction, axis=-1) < 0
        ends = (depth[way] <= 0) & (enters | ~solid[face])
        found.append((way[ends], hits.position[ends], hits.normal[ends]))
        depth[way] = np.maximum(depth[way] + np.where(solid[face], np.where(enters, 1, -1), 0), 0)
        way = way[~ends]
    found.append((way[:0], start[:0], start[:0]))
    which, position, normal = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return HiddenPoints(
        which,
        triangles.to_world(position).astype(np.float32),
        normal.astype(np.float32),
        area[which] / triangles.scale**2,
    )
