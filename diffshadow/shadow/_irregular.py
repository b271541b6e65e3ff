"""The irregular z-buffer: exact hard shadows at the surface's own points (Johnson et al. 2005; Aila & Laine 2004).

The samples of a shadow map are on a grid of texels and miss the surface points. Here the samples are the visible
surface points, projected into the light's view. Triangles are tested against them. There are no texels, and therefore
no aliasing. There is no bias, because the face of a point is left out.
"""

from typing import ClassVar

import equinox as eqx
from jax import lax
from jaxtyping import Array, Bool

from .._arithmetic import as_array, as_float, dot, normalize
from .._padding import padded_to
from .._types import Mask, Visibility
from ..geometry import AbstractLight, Mesh, Scene
from ..raster import Surface, hidden_points, seen_points
from ..settings import techniques
from ._technique import AbstractTechnique


class IrregularScene(eqx.Module):
    """The input of an irregular z-buffer.

    - `mesh`: all surfaces; `casts`: (f,), whether each of its faces casts.
    - `light`: the light in whose views the points are sorted.
    """

    mesh: Mesh
    casts: Bool[Array, " f"]
    light: AbstractLight


class IrregularZBuffer(AbstractTechnique):
    """Hard shadows by testing triangles against the surface's points in the light's view.

    The result equals rays traced to the light's centre, up to the rounding of the surface's positions. It has one
    visibility for each point. For several points per pixel, pass the surface of a camera with more pixels, and average
    (Wyman, Hoetzlein & Lefohn 2015, "Frustum-traced raster shadows", take 32).

    A light's size is ignored. As in a shadow map, a point outside of the light's frustum, or behind a light with a
    cone, is lit and does not count as covered. The frustum's near and far planes clip nothing.

    Visibility is 0 or 1 and has no gradient.
    """

    settings: ClassVar = techniques.IrregularZBuffer

    def prepare(self, scene: Scene, surface: Surface | None = None) -> IrregularScene:
        """The scene's triangles. It does not depend on `surface`, whose points `visibility` sorts."""
        mesh = scene.mesh.padded()
        casts = padded_to(scene.casting_faces, mesh.faces.shape[0])
        return IrregularScene(mesh, as_array(casts), scene.light)

    def visibility(self, state: IrregularScene, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        A surface that faces away from the light's centre is dark. A surface outside the light's frustum is lit. Pixels
        without a surface are lit.
        """
        points, face = surface.position.reshape(-1, 3), surface.face.reshape(-1)
        hidden = hidden_points(state.mesh, state.casts, state.light, points, face)
        return _lit(surface, state.light, hidden)

    def covered(self, state: IrregularScene, surface: Surface) -> Mask:
        """Pixels whose surface is within the light's frustum and in front of the light, (h, w)."""
        points, face = surface.position.reshape(-1, 3), surface.face.reshape(-1)
        return seen_points(state.mesh, state.light, points, face).reshape(surface.mask.shape)


@eqx.filter_jit
def _lit(surface: Surface, light: AbstractLight, hidden: Bool[Array, " n"]) -> Visibility:
    cosine = dot(surface.normal, normalize(light.towards(surface.position)))
    lit = (cosine > 0) & ~hidden.reshape(surface.mask.shape)
    return lax.stop_gradient(as_float(lit | ~surface.mask))
