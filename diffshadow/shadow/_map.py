"""Shadow maps (Williams 1978): the scene's depth as the light sees it."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._misc import round_up_to_power_of_two, with_gradient_of
from .._types import Faces, Resolution
from ..geometry import AbstractLight, Edges, Mesh, View
from ..raster import (
    Capacity,
    Cull,
    DepthTest,
    Overflow,
    barycentrics,
    interpolate_depth,
    plan,
    rasterize,
    rasterize_depth,
)
from .silhouettes import Outline, SilhouetteMap, find_silhouettes

DepthFormat = Literal["float32", "unorm24", "unorm16"]
DepthLayer = Literal["nearest", "midpoint", "second"]


class ShadowMap(eqx.Module):
    """The depth that a light sees.

    - `depth`: (h, w), window depth; 1 where the light meets nothing. Row 0 is the bottom row. Of a light that looks
        several ways, such as a point light, (l, h, w).
    - `light`: the light it was drawn from.
    - `depth_format`: how depths are stored.
    - `silhouettes`: where casters end within texels; none where that is not known.
    """

    depth: Float[Array, "*l h w"]
    light: AbstractLight
    depth_format: DepthFormat = eqx.field(static=True, default="float32")
    silhouettes: SilhouetteMap | None = None

    @property
    def view(self) -> View:
        """The projection it was drawn with."""
        return self.light.view()

    @property
    def resolution(self) -> Resolution:
        """(height, width) in texels."""
        height, width = self.depth.shape[-2:]
        return height, width


def draw_shadow_map(
    mesh: Mesh,
    light: AbstractLight,
    resolution: Resolution,
    *,
    layer: DepthLayer = "nearest",
    cull: Cull = "none",
    depth_format: DepthFormat = "float32",
    polygon_offset: tuple[float, float] | None = None,
    edges: Edges | None = None,
    capacity: "MapCapacity | None" = None,
    overflows: list[Overflow] | None = None,
) -> ShadowMap:
    """The shadow map of `mesh` under `light`.

    Depth differentiates with respect to vertices and light, but for which face a texel sees. With `edges`, so does the
    shadow's outline, and hard shadows are accurate below a texel. A map does not depend on bias or filter: with the
    light fixed, draw it once.

    **Arguments:**

    - `resolution`: (height, width) in texels.
    - `layer`: which surface each texel holds. `"nearest"`. `"midpoint"` (Woo, "The Shadow Depth Map Revisited",
        Graphics Gems III, 1992), the mean of the window depths of the two nearest, or of the nearest and the far plane
        where there is but one: no bias is needed but near silhouettes, where the two meet. `"second"`, the second
        nearest (Wang & Molnar 1994), where a surface that has none behind it casts no shadow.
    - `cull`: which faces do not cast. `"front"` moves acne from lit faces to unlit ones, which are dark anyway; light
        leaks where a face lies close behind them. Only for closed meshes: of an open one it leaves out what casts.
    - `depth_format`: how depths are stored; fixed-point ones are rounded to the nearest of their steps, and receivers
        are compared with them at a depth clamped to [0, 1].
    - `polygon_offset`: (factor, units) of OpenGL's polygon offset, a bias that is stored in the map: each face lies
        deeper by `factor · max(|dz/dx|, |dz/dy|) + units · r`, slopes per texel and `r` the least difference of depths
        that the format is sure to resolve.
    - `edges`: of the mesh, for a map with silhouettes, which holds the nearest surface with nothing culled.
    - `capacity`: how many triangles and silhouettes can be drawn, by `plan_shadow_map`; needed under a trace.
    - `overflows`: a list that is appended whether each capacity is too small, instead of an error; see `rasterize`.

    **Raises** `ValueError` if `layer` is unknown, if `edges` are given with another `layer` than `"nearest"` or with
    `cull`, and what `rasterize` raises.
    """
    if layer not in ("nearest", "midpoint", "second"):
        raise ValueError(f'the shadow map\'s layer is {layer!r}; expected "nearest", "midpoint" or "second"')
    if edges is not None and (layer != "nearest" or cull != "none"):
        raise ValueError(
            f'silhouettes were asked for of the {layer!r} layer with cull {cull!r}; expected "nearest" and "none": '
            "leave edges out, or change these"
        )
    clip = clip_vertices(mesh, light)
    triangles = None if capacity is None else capacity.triangles
    test = DepthTest(depth_format)
    is_plain = depth_format == "float32" and polygon_offset is None

    def draw(behind: Int[Array, "*l h w"] | None = None) -> tuple[Array, Array]:
        seen = rasterize(
            clip,
            mesh.faces,
            resolution,
            cull=cull,
            depth_test=test,
            polygon_offset=polygon_offset,
            behind=behind,
            capacity=triangles,
            overflows=overflows,
        )
        depth = _depth(seen.face, clip, mesh.faces)
        return seen.face, depth if is_plain else with_gradient_of(depth, seen.depth)

    face, depth = draw()
    if layer != "nearest":
        _, second = draw(face)
        depth = second if layer == "second" else _midpoint(depth, second, test)
    if edges is None:
        return ShadowMap(depth, light, depth_format)
    most = _plan_silhouettes(clip, mesh, light, edges, resolution) if capacity is None else capacity.silhouettes
    about_corners, size = _about_corners(clip, resolution), _corners(resolution)
    corners = rasterize_depth(about_corners, mesh.faces, size, capacity=triangles, overflows=overflows)
    silhouettes, overflow = _silhouettes(depth, corners, clip, mesh, light, edges, most, overflows is None)
    if overflows is not None:
        overflows.append(overflow)
    return ShadowMap(depth, light, depth_format, silhouettes)


class MapSettings(NamedTuple):
    """How a shadow map is drawn; see `draw_shadow_map`.

    - `silhouettes`: whether the map holds silhouettes. With `None`, it does where lights or meshes are fitted, since
        derivatives with respect to these need them.
    """

    resolution: Resolution = (512, 512)
    layer: DepthLayer = "nearest"
    cull: Cull = "none"
    depth_format: DepthFormat = "float32"
    polygon_offset: tuple[float, float] | None = None
    silhouettes: bool | None = None

    def draw(self, casters: Mesh, light: AbstractLight, **how: Any) -> ShadowMap:
        """The shadow map of `casters` under `light`; edges, capacities and `overflows` as for `draw_shadow_map`."""
        given = {name: value for name, value in self._asdict().items() if name != "silhouettes"}
        return draw_shadow_map(casters, light, **given, **how)


class MapCapacity(NamedTuple):
    """The capacity to draw a shadow map: of `triangles`, and of crossings of `silhouettes` with sides of texels.

    Both are static: another capacity compiles another program.
    """

    triangles: Capacity
    silhouettes: int = 0

    def grown_to(self, other: "MapCapacity") -> "MapCapacity":
        """The least capacity that is enough for both."""
        return MapCapacity(self.triangles.grown_to(other.triangles), max(self.silhouettes, other.silhouettes))


def plan_shadow_map(
    mesh: Mesh, light: AbstractLight, resolution: Resolution, *, cull: Cull = "none", edges: Edges | None = None
) -> MapCapacity:
    """The capacity that drawing this map needs, each number rounded up.

    **Arguments:** as for `draw_shadow_map`; not for use inside `jax.jit`.
    """
    clip = clip_vertices(mesh, light)
    triangles = plan(clip, mesh.faces, resolution, cull=cull)
    if edges is None:
        return MapCapacity(triangles)
    corners = plan(_about_corners(clip, resolution), mesh.faces, _corners(resolution))
    return MapCapacity(triangles.grown_to(corners), _plan_silhouettes(clip, mesh, light, edges, resolution))


def _corners(resolution: Resolution) -> Resolution:
    height, width = resolution
    return height + 1, width + 1


def _about_corners(clip: Float[Array, "*l v 4"], resolution: Resolution) -> Float[Array, "*l v 4"]:
    """Clip coordinates of an image whose pixels' centres are the corners of a map's texels."""
    height, width = resolution
    return clip * jnp.array([width / (width + 1), height / (height + 1), 1, 1], clip.dtype)


def _plan_silhouettes(
    clip: Float[Array, "*l v 4"], mesh: Mesh, light: AbstractLight, edges: Edges, resolution: Resolution
) -> int:
    return round_up_to_power_of_two(int(_crossings(clip, mesh, light, edges, resolution)))


@eqx.filter_jit
def _crossings(clip, mesh, light, edges, resolution) -> Int[Array, ""]:
    return jnp.sum(Outline.of(clip, mesh, light, edges, resolution).counts)


@eqx.filter_jit
def _silhouettes(
    depth: Float[Array, "*l h w"],
    corners: Float[Array, "*l H W"],
    clip: Float[Array, "*l v 4"],
    mesh: Mesh,
    light: AbstractLight,
    edges: Edges,
    capacity: int,
    checked: bool,
) -> tuple[SilhouetteMap, Overflow]:
    """The silhouettes in a map, and whether some are missing, which is an error if it is `checked`."""
    height, width = depth.shape[-2:]
    outline = Outline.of(clip, mesh, light, edges, (height, width))
    overflow = jnp.sum(outline.counts) > capacity
    if checked:
        outline = eqx.error_if(
            outline,
            overflow,
            f"the shadow map's silhouette capacity of {capacity} is too small for these edges, and none may be "
            "dropped; expected as much as there are sides of texels that they cross: call plan_shadow_map(...) on them",
        )
    return find_silhouettes(depth, corners.astype(depth.dtype), outline, capacity), overflow


@eqx.filter_jit
def _midpoint(nearest: Float[Array, "*n"], second: Float[Array, "*n"], test: DepthTest) -> Float[Array, "*n"]:
    """The mean of two depths, as a buffer would hold it; what is empty stays so."""
    middle = (nearest + second) / 2
    return with_gradient_of(middle, test.decode(test.encode(middle)))


@eqx.filter_jit
def clip_vertices(mesh: Mesh, light: AbstractLight) -> Float[Array, "*l v 4"]:
    """Clip coordinates of a mesh's vertices in each of the light's views."""
    view = light.view()
    layers = view.world_to_eye.shape[:-2]
    # A matrix of each layer for all vertices.
    spread = view.world_to_eye[..., None, :, :] if layers else view.world_to_eye
    return eqx.tree_at(lambda view: view.world_to_eye, view, spread).clip(mesh.vertices)


@eqx.filter_jit
def _depth(face: Int[Array, "*l h w"], clip: Float[Array, "*l v 4"], faces: Faces) -> Float[Array, "*l h w"]:
    of_view = lambda face, clip: interpolate_depth(barycentrics(face, clip, faces), clip, faces)
    return jax.vmap(of_view)(face, clip) if face.ndim > 2 else of_view(face, clip)
