"""Draws a shadow map."""

import dataclasses
import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._arithmetic import is_traced, with_gradient_of
from .._checks import as_tuple, check_settings
from .._device import is_on_gpu
from .._padding import round_up_to_power_of_two
from .._types import Faces, Resolution
from ..geometry import AbstractLight, Edges, Mesh, MeshLike, Tile, View, as_mesh
from ..raster import DepthTest, Fragments, rasterize, rasterize_with_corners
from ..settings.maps import Cull, DepthFormat, DepthLayer
from ..settings.maps import ShadowMap as Settings
from ..settings.quantities import MAX_TEXELS
from ._map import ShadowMap
from ._map_depths import depth_at_centres, midpoint, unwarped_depth
from ._whole_faces import check_whole_faces
from .silhouettes import Outline, SilhouetteMap, find_silhouettes


def draw_shadow_map(
    mesh: MeshLike,
    light: AbstractLight,
    resolution: Resolution,
    *,
    depth_layer: DepthLayer = Settings.depth_layer,
    cull: Cull = Settings.cull,
    depth_format: DepthFormat = Settings.depth_format,
    polygon_offset: tuple[float, float] | None = Settings.polygon_offset,
    edges: Edges | None = None,
    crossings: int | None = None,
    raises: bool = True,
    shift: Float[Array, "2"] | None = None,
    buffer: Resolution | None = None,
) -> ShadowMap:
    """The shadow map of `mesh` under `light`.

    Depth is differentiable with respect to vertices and light, for a fixed visible face in each texel. With `edges`,
    the shadow's outline is differentiable too, and hard shadows have sub-texel accuracy. A map does not depend on bias
    or filter: if the light is fixed, draw it once.

    **Arguments:**

    - `resolution`: (height, width) in texels.
    - `depth_layer`: the surface whose depth a texel stores. `"nearest"`: the nearest. `"midpoint"` (Woo, "The Shadow
        Depth Map Revisited", Graphics Gems III, 1992): the mean of the window depths of the two nearest surfaces, or of
        the nearest surface and the far plane if there is only one surface. It needs no bias except near silhouettes,
        where the two surfaces meet. `"second"` (Wang & Molnar 1994): the second nearest surface. A surface with nothing
        behind it casts no shadow.
    - `cull`: the faces that do not cast. `"front"` moves acne from lit faces to unlit faces, which are dark anyway.
      Light leaks where another surface is close behind the unlit faces. Use it only for closed meshes, because an open
      mesh loses casters.
    - `depth_format`: how depths are stored. Fixed-point depths are rounded to the nearest step, and receivers are
        compared with them at a depth clamped to [0, 1].
    - `polygon_offset`: (factor, units) of OpenGL's polygon offset, a bias stored in the map. Each face is stored deeper
        by `factor · max(|dz/dx|, |dz/dy|) + units · r`, with slopes per texel and `r` the smallest depth difference
        that the format is guaranteed to resolve.
    - `edges`: the mesh's edges, for a map with silhouettes; needs depth layer `"nearest"` and cull `"none"`.
    - `crossings`: the reserved memory, as a number of crossings of silhouettes with the sides of texels. A static
      number, by default from `plan_crossings`. Inside `jit`, it is required with `edges`.
    - `raises`: whether more crossings are an error. If not, check the map's `overflow`. If it is set, draw again with
      more memory.
    - `shift`: (2,), a shift of the grid of texels, in texels. Points move by this amount along x and y of the map,
      together with the window. `None` for no shift.
    - `buffer`: as for `rasterize`; ignored with `edges`.

    **Raises** `ValueError` if `depth_layer` is unknown; if `edges` are given with a `depth_layer` other than
    `"nearest"`, with `cull`, inside `jit` without `crossings`, or for a mesh with an alpha test, because its cut
    outlines are not edges; if a warped map has `edges` or a `polygon_offset`; if a map with pages or with cascades of
    several sizes has `edges`; if any of these maps has a `shift`; and what `rasterize` raises. **Raises** a runtime
    error if the silhouettes have more `crossings`.

    !!! Example

        ```python
        shadow_map = shadow.draw_shadow_map(scene.casters, light, (64, 64))
        shadow_map.depth.shape  # (64, 64)
        ```
    """
    mesh = as_mesh(mesh)
    # The call checks them.
    settings = MapSettings(resolution, depth_layer, cull, depth_format, polygon_offset)
    view = light.view() if shift is None else light.view().shifted(shift, resolution)
    if polygon_offset is not None and view.warp is not None:
        raise ValueError(
            "the shadow map is warped, and polygon_offset was given; expected none: leave it out, or use a layout "
            "without a warp"
        )
    if edges is None:
        depth = _depths(mesh.padded(), view, settings, buffer)
        return ShadowMap(depth, light, depth_format, view=view)
    _check_allows_edges(view, settings)
    check_whole_faces(mesh, "silhouettes", "set the map's silhouettes to false")
    if crossings is None:
        crossings = plan_crossings(mesh, light, resolution, edges)
    mesh = mesh.padded()
    depth, silhouettes, needed = _outlined(mesh, light, view, settings, edges.padded(mesh.faces.shape[0]), crossings)
    overflow = needed > crossings
    if not raises:
        return ShadowMap(depth, light, depth_format, silhouettes, view=view, overflow=overflow, crossings=needed)
    silhouettes = eqx.error_if(
        silhouettes,
        overflow,
        f"the shadow map has memory for {crossings} crossings of silhouettes with the sides of texels, and these edges "
        "have more; expected memory for all: pass crossings=plan_crossings(...), or a plan with a greater margin",
    )
    return ShadowMap(depth, light, depth_format, silhouettes, view=view)


# In texels. Larger maps of several views are drawn view by view on a CPU.
_MAX_TOGETHER = 1 << 19


def _depths(mesh: Mesh, view: View, settings: "MapSettings", buffer: Resolution | None) -> Float[Array, "*l h w"]:
    """The depths of a map without silhouettes, of the layer in `settings`."""
    clip = view.clip_vertices(mesh.vertices)
    # Pages have positions in separate virtual maps. Other layers show the virtual map that begins at their corner.
    viewports = None if view.tile is None or view.pages is not None else jnp.stack([view.tile.size] * 2, axis=-1)
    views: tuple[Any, Any, Any] = clip, view.tile, viewports
    draw = lambda each: _layer_depths(mesh, each[0], each[1], each[2], view, settings, buffer)
    if clip.ndim == 2 or is_on_gpu() or math.prod(settings.resolution) <= _MAX_TOGETHER:
        return draw(views)
    # Arrays of all views together do not fit into the cache, and the C library takes arrays of more than 64 MiB from
    # fresh pages.
    if is_traced((clip, mesh)):
        return lax.map(draw, views)
    # Finished arrays are copied in this thread, whose memory the C library keeps at any size.
    return _stacked(jax.block_until_ready([draw(each) for each in _apart(views)]))


_stacked = jax.jit(jnp.stack)


@jax.jit
def _apart(views: tuple[Array, Tile | None, Array | None]) -> list[Any]:
    """The depths of each of several views."""
    of_view = lambda i: jax.tree.map(lambda leaf: leaf[i], views)
    return [of_view(i) for i in range(len(views[0]))]


def _layer_depths(
    mesh: Mesh,
    clip: Float[Array, "*m v 4"],
    tile: Tile | None,
    viewports: Int[Array, "*m 2"] | None,
    view: View,
    settings: "MapSettings",
    buffer: Resolution | None,
) -> Float[Array, "*l h w"]:
    """`_depths` of one or several of the views in `view`."""
    test = DepthTest(settings.depth_format)

    def draw(behind: Int[Array, "*l h w"] | None = None) -> Fragments:
        return rasterize(
            clip,
            mesh.faces,
            settings.resolution,
            cull=settings.cull,
            depth_test=test if view.warp is None else DepthTest(),
            polygon_offset=settings.polygon_offset,
            behind=behind,
            pages=view.pages,
            viewports=viewports,
            buffer=buffer,
            alpha_test=mesh.alpha_test,
        )

    def depth_of(seen: Fragments) -> Float[Array, "*l h w"]:
        if view.warp is not None:
            return unwarped_depth(seen.face, clip, view.unwarped.clip_vertices(mesh.vertices), mesh.faces, test)
        return _stored(seen, clip, mesh.faces, tile, settings)

    seen = draw()
    depth = depth_of(seen)
    if settings.depth_layer == "nearest":
        return depth
    second = depth_of(draw(seen.face))
    return second if settings.depth_layer == "second" else midpoint(depth, second, test)


def _outlined(
    mesh: Mesh, light: AbstractLight, view: View, settings: "MapSettings", edges: Edges, crossings: int
) -> tuple[Float[Array, "*l h w"], SilhouetteMap, Int[Array, ""]]:
    """The depths and silhouettes of a map, and the number of texel sides that the silhouettes cross."""
    clip, test = view.clip_vertices(mesh.vertices), DepthTest(settings.depth_format)
    seen, corners = rasterize_with_corners(
        clip, mesh.faces, settings.resolution, depth_test=test, polygon_offset=settings.polygon_offset
    )
    depth = _stored(seen, clip, mesh.faces, view.tile, settings)
    return depth, *_silhouettes(depth, corners.depth, clip, mesh, light, edges, crossings)


def _stored(
    seen: Fragments, clip: Float[Array, "*m v 4"], faces: Faces, tile: Tile | None, settings: "MapSettings"
) -> Float[Array, "*l h w"]:
    """The depths in the buffer, with the derivatives of the visible faces."""
    depth = depth_at_centres(seen.face, clip, faces, tile)
    is_plain = settings.depth_format == "float32" and settings.polygon_offset is None
    return depth if is_plain else with_gradient_of(depth, seen.depth)


def _check_allows_edges(view: View, settings: "MapSettings") -> None:
    """**Raises** `ValueError` for a map that cannot have silhouettes."""
    if max(settings.resolution) >= MAX_TEXELS:
        raise ValueError(
            f"edges were given for a map of {settings.resolution} texels, (height, width); expected at most "
            f"{MAX_TEXELS - 1} per side, because the corners of texels are also drawn: leave edges out, or lower "
            "the resolution"
        )
    if settings.depth_layer != "nearest" or settings.cull != "none":
        raise ValueError(
            f"edges were given with depth_layer {settings.depth_layer!r} and cull {settings.cull!r}; expected "
            '"nearest" and "none": leave edges out, or change depth_layer and cull'
        )
    if not view.has_even_texels:
        layout = "pages" if view.pages is not None else "cascades of several sizes"
        raise ValueError(
            f"edges were given for a map with {layout if view.warp is None else 'a warp'}, which has no silhouettes; "
            "expected no edges: leave them out, or use another layout"
        )


# Pixels per side. Larger buffers take too much memory, and too much time for each drawing.
_MAX_SHARED = 2049


@dataclasses.dataclass(frozen=True)
class MapSettings:
    """The settings for drawing a shadow map; see `draw_shadow_map`.

    - `silhouettes`: whether the map stores silhouettes. With `None`, it does if lights or meshes are fitted, because
        derivatives with respect to lights and meshes need silhouettes.

    **Raises** `ValueError` for an invalid value.

    !!! Example

        ```python
        settings = shadow.MapSettings((64, 64), depth_format="unorm16", cull="back")
        technique = shadow.ShadowMapping(shadow.Nearest(), shadow.Bias(constant=2.0), map=settings)
        ```
    """

    settings: ClassVar = Settings

    resolution: Resolution = Settings.resolution
    depth_layer: DepthLayer = Settings.depth_layer
    cull: Cull = Settings.cull
    depth_format: DepthFormat = Settings.depth_format
    polygon_offset: tuple[float, float] | None = Settings.polygon_offset
    silhouettes: bool | None = Settings.silhouettes

    def __post_init__(self):
        # Lists could not be part of a compiled program.
        for name in ("resolution", "polygon_offset"):
            object.__setattr__(self, name, as_tuple(getattr(self, name)))
        check_settings(self)

    def draw(self, casters: Mesh, light: AbstractLight, **how: Any) -> ShadowMap:
        """The shadow map of `casters` under `light`. `edges`, `crossings`, `raises` and `shift` are as for
        `draw_shadow_map`."""
        given = {name: value for name, value in vars(self).items() if name != "silhouettes"}
        return draw_shadow_map(casters, light, **given, **how, buffer=self.buffer(self.resolution))

    def buffer(self, image: Resolution) -> Resolution | None:
        """The buffer for `draw_surface` with which one program draws both the map and an `image` of this size.

        **Returns** `None` if the image does not fit into the map's buffer, if the map is too large for sharing to pay,
        or if the map stores depths in a different format than an image, which needs another program.
        """
        if self.depth_format != "float32" or self.polygon_offset is not None:
            return None
        height, width = self.resolution
        # With silhouettes, as in fits of lights or meshes, the corners of texels are also drawn.
        size = (height, width) if self.silhouettes is False else (height + 1, width + 1)
        return size if all(n <= side <= _MAX_SHARED for n, side in zip(image, size, strict=True)) else None


class MapPlan(eqx.Module):
    """The data that a technique needs to draw a scene's shadow map inside `jax.jit`: edges, and memory for silhouettes.

    - `edges`: edges of the casters; `None` for a map without silhouettes.
    - `crossings`, `raises`: as for `draw_shadow_map`.
    """

    edges: Edges | None = None
    crossings: int | None = eqx.field(static=True, default=None)
    raises: bool = eqx.field(static=True, default=True)


def plan_crossings(mesh: Mesh, light: AbstractLight, resolution: Resolution, edges: Edges) -> int:
    """The number of texel sides that this map's silhouettes cross, rounded up to a power of two.

    **Arguments:** as for `draw_shadow_map`.

    **Raises** `ValueError` inside `jit`.
    """
    if is_traced((mesh, light, edges)):
        raise ValueError(
            "a shadow map with edges was drawn inside jax.jit (or grad, or vmap) without crossings; expected their "
            "number, because shapes must be known there: call plan_crossings(...) outside, and pass its result to "
            "draw_shadow_map as crossings"
        )
    mesh = mesh.padded()
    return round_up_to_power_of_two(int(_crossings(mesh, light, edges.padded(mesh.faces.shape[0]), resolution)))


@eqx.filter_jit
def _crossings(mesh: Mesh, light: AbstractLight, edges: Edges, resolution: Resolution) -> Int[Array, ""]:
    return jnp.sum(Outline.of(light.view().clip_vertices(mesh.vertices), mesh, light, edges, resolution).counts)


@eqx.filter_jit
def _silhouettes(
    depth: Float[Array, "*l h w"],
    corners: Float[Array, "*l H W"],
    clip: Float[Array, "*l v 4"],
    mesh: Mesh,
    light: AbstractLight,
    edges: Edges,
    crossings: int,
) -> tuple[SilhouetteMap, Int[Array, ""]]:
    """The silhouettes in a map, and the number of texel sides that they cross. If there are more than `crossings`, some
    silhouettes are missing."""
    height, width = depth.shape[-2:]
    outline = Outline.of(clip, mesh, light, edges, (height, width))
    found = find_silhouettes(depth, corners.astype(depth.dtype), outline, crossings)
    return found, jnp.sum(outline.counts)
