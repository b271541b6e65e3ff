"""The surface that a camera sees."""

import equinox as eqx
import jax.numpy as jnp

from .._misc import dot, normalize
from .._types import ClipVertices, FaceMap, Mask, VectorMap
from ..geometry import AbstractCamera, Mesh, face_normals
from ._bins import Cull
from ._interpolate import (
    Rows,
    barycentrics_in_rows,
    by_bands,
    corner_values,
    interpolate_corners,
    interpolate_values,
    of_face,
)
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
    mesh: Mesh,
    camera: AbstractCamera,
    *,
    cull: Cull = "none",
) -> Surface:
    """The surface of `mesh` that `camera` sees at its pixel centres, differentiable but for which face is seen.

    **Arguments:** `cull` as for `rasterize`.
    """
    mesh = mesh.padded()
    clip = _clip(mesh, camera)
    face = rasterize(clip, mesh.faces, camera.resolution, cull=cull).face
    return _surface(mesh, camera, face, clip)


@eqx.filter_jit
def _clip(mesh: Mesh, camera: AbstractCamera) -> ClipVertices:
    return camera.view().clip(mesh.vertices)


@eqx.filter_jit
def _surface(mesh: Mesh, camera: AbstractCamera, face: FaceMap, clip: ClipVertices) -> Surface:
    normals, view = face_normals(mesh), camera.view()
    clip_values, positions = (corner_values(values, mesh.faces, face.size) for values in (clip, mesh.vertices))

    def band(face: FaceMap, rows: Rows) -> Surface:
        at = barycentrics_in_rows(face, clip_values, rows)
        position = interpolate_values(at, positions)
        normal = of_face(at, normals)
        shading_normal = interpolate_corners(at, mesh.corner_normals)
        # The direction to the camera: to its eye, or against its axis.
        to_camera = camera.eye - position if view.is_perspective else view.world_to_eye[2, :3]
        sign = jnp.where(dot(normal, to_camera) < 0, -1, 1)[..., None]
        return Surface(
            position=position,
            normal=normal * sign,
            shading_normal=normalize(shading_normal) * sign,
            albedo=of_face(at, mesh.albedo),
            face=face,
            mask=at.mask,
        )

    return by_bands(band, face)
