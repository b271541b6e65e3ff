"""The surface that a camera sees."""

import equinox as eqx
import jax.numpy as jnp

from .._misc import normalize
from .._types import FaceMap, Mask, VectorMap
from ..geometry import AbstractCamera, Mesh, face_normals
from ._bins import Capacity, Cull
from ._interpolate import barycentrics, interpolate
from ._rasterize import rasterize


class Surface(eqx.Module):
    """The receiver points of an image; row 0 is the bottom row.

    It does not depend on light, bias or filter: compute it once a view.

    - `position`: (h, w, 3), world units.
    - `normal`: (h, w, 3), unit geometric normal of the face, turned to the camera.
    - `shading_normal`: (h, w, 3), unit interpolated normal, turned likewise.
    - `albedo`: (h, w, 3).
    - `face`: (h, w), the face seen, -1 where there is none.
    - `mask`: (h, w), whether a face is seen.
    """

    position: VectorMap
    normal: VectorMap
    shading_normal: VectorMap
    albedo: VectorMap
    face: FaceMap
    mask: Mask


def draw_surface(
    mesh: Mesh, camera: AbstractCamera, *, cull: Cull = "none", capacity: Capacity | None = None
) -> Surface:
    """The surface of `mesh` that `camera` sees at its pixel centres, differentiable but for which face is seen.

    **Arguments:** `cull` and `capacity` as for `rasterize`.

    **Raises** `ValueError` if `capacity` is left out under a trace.
    """
    view = camera.view()
    clip = view.clip(mesh.vertices)
    face = rasterize(clip, mesh.faces, camera.resolution, cull=cull, capacity=capacity).face
    return _surface(mesh, view.world_to_eye, face, clip, view.is_perspective)


def _surface(mesh, world_to_eye, face, clip, is_perspective):
    at = barycentrics(face, clip, mesh.faces)
    position = interpolate(at, mesh.vertices, mesh.faces)
    normal = jnp.where(at.mask[..., None], face_normals(mesh)[at.face], 0)
    shading = jnp.sum(mesh.corner_normals[at.face] * at.weights[..., None], axis=-2)
    shading = jnp.where(at.mask[..., None], normalize(shading), 0)
    # The way to the camera: its eye, or against its axis.
    eye = -world_to_eye[:3, :3].T @ world_to_eye[:3, 3]
    to_camera = eye - position if is_perspective else world_to_eye[2, :3]
    away = jnp.sum(normal * to_camera, axis=-1, keepdims=True) < 0
    turn = jnp.where(away, -1, 1)
    albedo = jnp.where(at.mask[..., None], mesh.albedo[at.face], 0)
    return Surface(position, normal * turn, shading * turn, albedo, face, at.mask)
