"""The geometry of ray tracing in float64: the scene's triangles, camera rays and hit points.

All of it is in the *tracing frame*: world space centred on the scene and scaled by a power of two so that the scene
fits [-1, 1]³. There the rounding of a float32 tracer is the same for every scene size and position, and the scaling
itself is exact.
"""

import copy
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from .._arithmetic import in_float64
from .._types import HostArray
from ..geometry import AbstractCamera, Mesh, View
from ._cutouts import Cutouts

_DIAGONAL = np.sqrt(3.0)


class Triangles:
    """The scene's triangles in the tracing frame.

    - `center`: (3,), the frame's origin in world space.
    - `scale`: frame units per world unit, a power of two.
    - `corners`: (f, 3, 3), each face's corners.
    - `normals`: (f, 3), unit, outwards by the right-hand rule; 0 for a face without area.
    - `areas`: (f,), in squared frame units.
    - `numbers`: (f,), the index of each face in the mesh.
    - `cutouts`: where rays pass through them; none without an alpha test.

    **Raises** `ValueError` if the whole mesh is a single point.
    """

    def __init__(self, mesh: Mesh):
        world = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
        low, high = world.min(axis=(0, 1)), world.max(axis=(0, 1))
        extent = float(np.max(high - low)) / 2
        if extent == 0:
            raise ValueError(
                f"all {len(world)} triangles of the scene lie at the single point {low.tolist()}; "
                "expected surfaces with an area: check the mesh, or the scaling applied to it"
            )
        self.center = (low + high) / 2
        self.scale = float(2.0 ** -np.ceil(np.log2(extent)))
        self.corners = self.to_frame(world)
        a, b, c = np.moveaxis(self.corners, 1, 0)
        normals = np.cross(b - a, c - a)
        self.areas = np.linalg.norm(normals, axis=-1) / 2
        self.normals = normals / np.where(self.areas == 0, 1, 2 * self.areas)[:, None]
        self.numbers = np.arange(len(self.corners))
        self.cutouts = None if mesh.alpha_test is None else Cutouts(mesh.alpha_test)

    def only(self, faces: Bool[HostArray, " f"]) -> "Triangles":
        """The triangles selected by `faces` (f,), in the same frame."""
        some = copy.copy(self)
        some.corners, some.normals, some.areas = self.corners[faces], self.normals[faces], self.areas[faces]
        some.numbers = self.numbers[faces]
        some.cutouts = None if self.cutouts is None else self.cutouts.only(faces)
        return some

    def to_frame(self, points: Float64[HostArray, "*n 3"]) -> Float64[HostArray, "*n 3"]:
        """World `points` in the tracing frame."""
        return (points - self.center) * self.scale

    def to_world(self, points: Float64[HostArray, "*n 3"]) -> Float64[HostArray, "*n 3"]:
        """Points of the tracing frame in world space."""
        return points / self.scale + self.center


class Rays(NamedTuple):
    """Rays from `origin` (n, 3) along the unit `direction` (n, 3), as far as `reach` (n,), in the tracing frame."""

    origin: Float64[HostArray, "n 3"]
    direction: Float64[HostArray, "n 3"]
    reach: Float64[HostArray, " n"]


class ShadowRays(NamedTuple):
    """Rays from points of surfaces towards the light, in the tracing frame.

    - `origin`: (n, 3), where rays begin; `face`: (n,), the faces of the scene's mesh that they begin on.
    - `which`: (r,), the index of each ray's origin.
    - `direction`: (r, 3), directions, of any length.
    - `reach`: the greatest distance of an occluder, in multiples of `direction`; may be infinite.
    """

    origin: Float64[HostArray, "n 3"]
    face: Int[HostArray, " n"]
    which: Int[HostArray, " r"]
    direction: Float[HostArray, "r 3"]
    reach: float


class CameraRays:
    """The rays through a camera's pixel centres, from its near plane to its far plane."""

    def __init__(self, camera: AbstractCamera, triangles: Triangles):
        self.height, self.width = camera.resolution
        self.view = _view(camera)
        self._triangles = triangles
        self._clip_to_eye = np.linalg.inv(np.asarray(self.view.eye_to_clip))
        self._eye_to_world = np.linalg.inv(np.asarray(self.view.world_to_eye))

    def pixels(self, first: int, count: int) -> Rays:
        """The rays of pixels `first` to `first + count - 1`, counted along rows from the bottom left."""
        row, column = np.divmod(np.arange(first, first + count), self.width)
        x, y = 2 * (column + 0.5) / self.width - 1, 2 * (row + 0.5) / self.height - 1
        begin, end = self._unproject(x, y, -1.0), self._unproject(x, y, 1.0)
        along = end - begin
        reach = np.linalg.norm(along, axis=-1)
        direction = along / reach[:, None]
        # Start at the scene's bounding sphere: a float32 origin is accurate only near the scene.
        skipped = np.maximum(-np.sum(begin * direction, axis=-1) - 1.01 * _DIAGONAL, 0)
        return Rays(begin + skipped[:, None] * direction, direction, reach - skipped)

    def _unproject(
        self, x: Float64[HostArray, " n"], y: Float64[HostArray, " n"], z: float
    ) -> Float64[HostArray, "n 3"]:
        clip = np.stack([x, y, np.full_like(x, z), np.ones_like(x)], axis=-1)
        eye = clip @ self._clip_to_eye.T
        world = (eye / eye[:, 3:]) @ self._eye_to_world.T
        return self._triangles.to_frame(world[:, :3])


class Hits(NamedTuple):
    """Points that rays hit.

    - `position`: (n, 3), in the tracing frame.
    - `normal`: (n, 3), the geometric unit normal, facing the ray's origin.
    - `face`: (n,).
    """

    position: Float64[HostArray, "n 3"]
    normal: Float64[HostArray, "n 3"]
    face: Int[HostArray, " n"]


def hits_on_planes(rays: Rays, faces: Int[HostArray, " n"], triangles: Triangles) -> Hits:
    """The points where `rays` meet the planes of the `faces` (n,) that they hit, accurate to float64."""
    corners, normal = triangles.corners[faces], triangles.normals[faces]
    facing = np.sum(normal * rays.direction, axis=-1)
    plane = np.sum(normal * (corners[:, 0] - rays.origin), axis=-1)
    distance = plane / np.where(facing == 0, 1, facing)
    # A face seen nearly edge-on has an ill-conditioned plane, but its corners bound the distance.
    a, b, c = np.einsum("nkd,nd->nk", corners - rays.origin[:, None], rays.direction).T
    # Written out, since NumPy is slow along an axis of three.
    nearest, farthest = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    distance = np.clip(distance, nearest, farthest)
    position = rays.origin + distance[:, None] * rays.direction
    return Hits(position, np.where(facing > 0, -1, 1)[:, None] * normal, faces)


def _view(camera: AbstractCamera) -> View:
    with jax.enable_x64(True):
        return in_float64(camera).view()
