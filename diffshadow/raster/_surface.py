"""The surface that a camera sees."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._arithmetic import dot, normalize, take
from .._checks import check_instance
from .._pictures import as_html, is_known, lit
from .._types import ClipVertices, FaceMap, Mask, Resolution, Vec3, VectorMap
from ..geometry import NO_TEXTURE, AbstractCamera, Mesh, MeshLike, View, as_mesh, face_normals
from ..settings import maps
from ..settings.maps import Cull
from ._alpha_test import Cutouts
from ._drawn_view import drawn_view
from ._fixed import at_steps
from ._interpolate import (
    Barycentrics,
    Points,
    Rows,
    barycentrics_at,
    by_bands,
    corner_values,
    interpolate_corners,
    interpolate_values,
    of_face,
)
from ._rasterize import rasterize


class Surface(eqx.Module):
    """The receiver points of an image; row 0 is the bottom row.

    It does not depend on light, bias or filter: compute it once per view.

    - `position`: (h, w, 3), world units.
    - `normal`: (h, w, 3), unit geometric normal of the face, turned to the camera.
    - `interpolated_normal`: (h, w, 3), the vertices' normals as they interpolate: neither of unit length nor turned.
    - `albedo`: (h, w, 3).
    - `face`: (h, w), the face seen, -1 where there is none.
    - `mask`: (h, w), whether a face is seen.
    - `from_behind`: (h, w), whether the pixel sees a back face, whose `normal` is flipped; `None` if no pixel does.
    """

    position: VectorMap
    normal: VectorMap
    interpolated_normal: VectorMap
    albedo: VectorMap
    face: FaceMap
    mask: Mask
    from_behind: Mask | None = None

    def _repr_html_(self) -> str | None:
        """A picture of the surface, lit from above."""
        if not is_known(self):
            return None
        colours = lit(np.asarray(self.normal), np.array([0.4, 0.8, 0.5]), np.asarray(self.albedo))
        mask = np.asarray(self.mask)
        height, width = mask.shape
        title = f"Surface: {width} x {height} pixels, {mask.mean():.0%} of them with a face"
        return as_html(title, np.where(mask[..., None], colours, 1.0))

    @property
    def shading_normal(self) -> VectorMap:
        """(h, w, 3), unit interpolated normal, turned as `normal` is."""
        unit = normalize(self.interpolated_normal)
        return unit if self.from_behind is None else jnp.where(self.from_behind[..., None], -unit, unit)


def draw_surface(
    mesh: MeshLike,
    camera: AbstractCamera,
    *,
    cull: Cull = maps.ShadowMap.cull,
    buffer: Resolution | None = None,
    subpixels: int | None = None,
) -> Surface:
    """The surface of `mesh` that `camera` sees at its pixel centres. Everything is differentiable except the choice of
    the visible face.

    **Arguments:**

    - `cull`, `buffer`: as for `rasterize`.
    - `subpixels`: steps to a pixel; an engine's rasterizer places vertices at whole steps before it
        interpolates: 16 in Chromium without graphics hardware. If left out, surfaces are interpolated between the
        vertices themselves.

    **Raises** `ValueError` unless `subpixels` is a positive whole number.

    !!! Example

        ```python
        surface = raster.draw_surface(scene.mesh, camera)
        surface.position.shape, surface.mask.shape  # ((32, 32, 3), (32, 32))
        ```
    """
    check_instance("the camera", camera, AbstractCamera, "a camera, such as a PinholeCamera")
    mesh = as_mesh(mesh).padded()
    view = drawn_view(camera.view(), mesh)
    clip = view.clip_vertices(mesh.vertices)
    if subpixels is not None:
        if not (isinstance(subpixels, int) and subpixels > 0):
            raise ValueError(f"subpixels is {subpixels!r}; expected a whole number of steps to a pixel, such as 16")
        clip = at_steps(clip, camera.resolution, subpixels)
    face = rasterize(clip, mesh.faces, camera.resolution, cull=cull, buffer=buffer, alpha_test=mesh.alpha_test).face
    return surface_at_centres(mesh, camera.eye, view, face, clip)


@eqx.filter_jit
def surface_at_centres(mesh: Mesh, eye: Vec3, view: View, face: FaceMap, clip: ClipVertices) -> Surface:
    """The surface that pixel centres see, given the face that each sees."""
    return by_bands(_surface_of(mesh, eye, view, face.size, clip), face)


def surface_at_points(mesh: Mesh, eye: Vec3, view: View, face: FaceMap, clip: ClipVertices, points: Points) -> Surface:
    """The surface of given faces at given points of the window, both (h, w)."""
    of = _surface_of(mesh, eye, view, face.size, clip)
    return by_bands(lambda seen, _: of(*seen), (face, points))


def passes_at_points(mesh: Mesh, face: FaceMap, clip: ClipVertices, points: Points) -> Mask:
    """Where the mesh's alpha test does not cut out given faces at given points of the window, both (h, w)."""
    textures = mesh.alpha_test
    assert textures is not None
    at = barycentrics_at(face, corner_values(clip, mesh.faces, face.size), points)
    index = jnp.where(at.mask, take(textures.index, at.face), NO_TEXTURE)
    alpha = textures.corner_alpha
    factor = None if alpha is None else interpolate_corners(at, alpha[..., None])[..., 0]
    return Cutouts.of(textures).passes(index, interpolate_corners(at, textures.uv), factor)


def _surface_of(
    mesh: Mesh, eye: Vec3, view: View, pixels: int, clip: ClipVertices
) -> Callable[[FaceMap, Rows | Points], Surface]:
    """The surface as a function of faces and of where they are seen, for so many `pixels` in all."""
    normals = face_normals(mesh)
    clip_values, positions = (corner_values(values, mesh.faces, pixels) for values in (clip, mesh.vertices))

    def surface(face: FaceMap, places: Rows | Points) -> Surface:
        at = barycentrics_at(face, clip_values, places)
        position = interpolate_values(at, positions)
        normal = of_face(at, normals)
        # The direction to the camera: to its eye, or against its axis.
        to_camera = eye - position if view.is_perspective else view.world_to_eye[2, :3]
        # Barrier: otherwise XLA computes this again for each component of the normal.
        from_behind = lax.optimization_barrier(dot(normal, to_camera) < 0)
        return Surface(
            position=position,
            normal=jnp.where(from_behind[..., None], -normal, normal),
            interpolated_normal=interpolate_corners(at, mesh.corner_normals),
            albedo=_albedo(at, mesh),
            face=face,
            mask=at.mask,
            from_behind=from_behind,
        )

    return surface


def _albedo(at: Barycentrics, mesh: Mesh) -> VectorMap:
    """The diffuse colour: the face's, times the mean of its corners', times its texture's."""
    albedo = of_face(at, mesh.albedo)
    if mesh.corner_colours is not None:
        albedo = albedo * interpolate_corners(at, mesh.corner_colours)
    if mesh.textures is not None:
        index = jnp.where(at.mask, take(mesh.textures.index, at.face), NO_TEXTURE)
        albedo = albedo * mesh.textures.at(index, interpolate_corners(at, mesh.textures.uv))[..., :3]
    return albedo
