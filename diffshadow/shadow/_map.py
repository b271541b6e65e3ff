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

    - `depth`: (h, w), window depth; 1 where the light sees nothing. Row 0 is the bottom row. (l, h, w) for a light with
        several views, such as a point light.
    - `light`: the light it was drawn from.
    - `depth_format`: how depths are stored.
    - `silhouettes`: the casters' outlines within texels; none if the map was drawn without edges.
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
    depth_layer: DepthLayer = "nearest",
    cull: Cull = "none",
    depth_format: DepthFormat = "float32",
    polygon_offset: tuple[float, float] | None = None,
    edges: Edges | None = None,
    capacity: "MapCapacity | None" = None,
    overflows: list[Overflow] | None = None,
) -> ShadowMap:
    """The shadow map of `mesh` under `light`.

    Depth is differentiable with respect to vertices and light, with the face that each texel sees held constant. With
    `edges`, the shadow's outline is differentiable too, and hard shadows have sub-texel accuracy. A map does not depend
    on bias or filter: if the light is fixed, draw it once.

    **Arguments:**

    - `resolution`: (height, width) in texels.
    - `depth_layer`: which surface each texel holds. `"nearest"`: the nearest. `"midpoint"` (Woo, "The Shadow Depth Map
        Revisited", Graphics Gems III, 1992): the mean of the window depths of the two nearest, or of the nearest and
        the far plane if there is only one. It needs no bias except near silhouettes, where the two surfaces meet.
        `"second"` (Wang & Molnar 1994): the second nearest; a surface with nothing behind it casts no shadow.
    - `cull`: which faces do not cast. `"front"` moves acne from lit faces to unlit ones, which are dark anyway; light
        leaks where another surface lies close behind the unlit faces. It is for closed meshes only: an open mesh loses
        casters.
    - `depth_format`: how depths are stored. Fixed-point depths are rounded to the nearest step, and receivers are
        compared with them at a depth clamped to [0, 1].
    - `polygon_offset`: (factor, units) of OpenGL's polygon offset, a bias stored in the map. Each face is stored deeper
        by `factor · max(|dz/dx|, |dz/dy|) + units · r`, with slopes per texel and `r` the smallest depth difference
        that the format is guaranteed to resolve.
    - `edges`: the mesh's edges, for a map with silhouettes; needs depth layer `"nearest"` and cull `"none"`.
    - `capacity`: how many triangles and silhouettes can be drawn, from `plan_shadow_map`; required under a trace.
    - `overflows`: a list. Instead of raising, each capacity appends whether it is too small; see `rasterize`.

    **Raises** `ValueError` if `depth_layer` is unknown, if `edges` are given with another one than `"nearest"` or with
    `cull`, and what `rasterize` raises.
    """
    if depth_layer not in ("nearest", "midpoint", "second"):
        raise ValueError(
            f'the shadow map\'s depth_layer is {depth_layer!r}; expected "nearest", "midpoint" or "second"'
        )
    if edges is not None and (depth_layer != "nearest" or cull != "none"):
        raise ValueError(
            f'edges were given with depth_layer {depth_layer!r} and cull {cull!r}; expected "nearest" and "none": '
            "leave edges out, or change depth_layer and cull"
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
    if depth_layer != "nearest":
        _, second = draw(face)
        depth = second if depth_layer == "second" else _midpoint(depth, second, test)
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

    - `silhouettes`: whether the map holds silhouettes. With `None`, it does if lights or meshes are fitted, because
        derivatives with respect to these need them.
    """

    resolution: Resolution = (512, 512)
    depth_layer: DepthLayer = "nearest"
    cull: Cull = "none"
    depth_format: DepthFormat = "float32"
    polygon_offset: tuple[float, float] | None = None
    silhouettes: bool | None = None

    def draw(self, casters: Mesh, light: AbstractLight, **how: Any) -> ShadowMap:
        """The shadow map of `casters` under `light`; edges, capacities and `overflows` as for `draw_shadow_map`."""
        given = {name: value for name, value in self._asdict().items() if name != "silhouettes"}
        return draw_shadow_map(casters, light, **given, **how)


class MapCapacity(NamedTuple):
    """How much a shadow map can draw: `triangles`, and crossings of `silhouettes` with the sides of texels.

    Both are static: a new capacity recompiles.
    """

    triangles: Capacity
    silhouettes: int = 0

    def grown_to(self, other: "MapCapacity") -> "MapCapacity":
        """The smallest capacity that is enough for both."""
        return MapCapacity(self.triangles.grown_to(other.triangles), max(self.silhouettes, other.silhouettes))


def plan_shadow_map(
    mesh: Mesh, light: AbstractLight, resolution: Resolution, *, cull: Cull = "none", edges: Edges | None = None
) -> MapCapacity:
    """The capacity needed to draw this map, each number rounded up.

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
    """Clip coordinates of an image whose pixel centres are the corners of the map's texels."""
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
    """The silhouettes in a map, and whether some did not fit the capacity, which is an error if `checked`."""
    height, width = depth.shape[-2:]
    outline = Outline.of(clip, mesh, light, edges, (height, width))
    overflow = jnp.sum(outline.counts) > capacity
    if checked:
        outline = eqx.error_if(
            outline,
            overflow,
            f"the shadow map's silhouette capacity of {capacity} is too small for these edges; expected at least as "
            "many as the sides of texels that they cross: call plan_shadow_map(...) with them",
        )
    return find_silhouettes(depth, corners.astype(depth.dtype), outline, capacity), overflow


@eqx.filter_jit
def _midpoint(nearest: Float[Array, "*n"], second: Float[Array, "*n"], test: DepthTest) -> Float[Array, "*n"]:
    """The mean of two depths, rounded as the buffer stores it; empty texels stay empty."""
    middle = (nearest + second) / 2
    return with_gradient_of(middle, test.decode(test.encode(middle)))


@eqx.filter_jit
def clip_vertices(mesh: Mesh, light: AbstractLight) -> Float[Array, "*l v 4"]:
    """Clip coordinates of a mesh's vertices in each of the light's views."""
    view = light.view()
    layers = view.world_to_eye.shape[:-2]
    # Broadcasts each layer's matrix over all vertices.
    spread = view.world_to_eye[..., None, :, :] if layers else view.world_to_eye
    return eqx.tree_at(lambda view: view.world_to_eye, view, spread).clip(mesh.vertices)


@eqx.filter_jit
def _depth(face: Int[Array, "*l h w"], clip: Float[Array, "*l v 4"], faces: Faces) -> Float[Array, "*l h w"]:
    of_view = lambda face, clip: interpolate_depth(barycentrics(face, clip, faces), clip, faces)
    return jax.vmap(of_view)(face, clip) if face.ndim > 2 else of_view(face, clip)
