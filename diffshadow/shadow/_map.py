"""Shadow maps (Williams 1978): the scene's depth as the light sees it."""

import equinox as eqx

from .._types import ClipVertices, DepthMap, FaceMap, Resolution
from ..geometry import AbstractLight, Mesh, View
from ..raster import Capacity, Cull, barycentrics, interpolate_depth, rasterize


class ShadowMap(eqx.Module):
    """The depth of the surface nearest to a light.

    - `depth`: (h, w), window depth; 1 where the light meets nothing. Row 0 is the bottom row.
    - `light`: the light it was drawn from.
    """

    depth: DepthMap
    light: AbstractLight

    @property
    def view(self) -> View:
        """The projection it was drawn with."""
        return self.light.view()

    @property
    def resolution(self) -> Resolution:
        """(height, width) in texels."""
        height, width = self.depth.shape
        return height, width


def draw_shadow_map(
    mesh: Mesh,
    light: AbstractLight,
    resolution: Resolution,
    *,
    cull: Cull = "none",
    capacity: Capacity | None = None,
) -> ShadowMap:
    """The shadow map of `mesh` under `light`.

    Depth differentiates with respect to vertices and light, but for which face a texel sees. It does not depend on
    bias or filter: with the light fixed, draw it once.

    **Arguments:**

    - `resolution`: (height, width) in texels.
    - `cull`: which faces do not cast. `"front"` moves acne from lit faces to unlit ones; only for closed meshes.
    - `capacity`: as for `rasterize`; needed under a trace.
    """
    clip = _clip(mesh, light)
    face = rasterize(clip, mesh.faces, resolution, cull=cull, capacity=capacity).face
    return ShadowMap(_depth(face, clip, mesh), light)


@eqx.filter_jit
def _clip(mesh: Mesh, light: AbstractLight) -> ClipVertices:
    return light.view().clip(mesh.vertices)


@eqx.filter_jit
def _depth(face: FaceMap, clip: ClipVertices, mesh: Mesh) -> DepthMap:
    return interpolate_depth(barycentrics(face, clip, mesh.faces), clip, mesh.faces)
