"""Shadow maps (Williams 1978): the scene's depth as the light sees it.

A map holds, for each texel of the light's image, a window depth at the texel's centre, by default the nearest caster's:
(h, w), from 0 at the near plane to 1 at the far plane, and 1 where the light sees nothing. Row 0 is the bottom row.
A light with several views, such as a point light or cascades, has a layer for each: (l, h, w).

Where outlines are needed, a map also holds the casters' silhouettes within its texels. They give shadows derivatives
with respect to lights and meshes.
"""

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from .._checks import as_tuple, check_settings, shown_with_values
from .._misc import as_array, chunk_size, round_up_to_power_of_two, with_gradient_of
from .._pictures import as_html, grey_of, is_known
from .._types import Faces, Resolution
from ..geometry import AbstractLight, Edges, Mesh, MeshLike, Tile, View, as_mesh
from ..raster import (
    DepthTest,
    Fragments,
    barycentrics,
    by_bands,
    interpolate_depth,
    rasterize,
    visible_depth,
)
from ..settings.maps import Cull, DepthFormat, DepthLayer
from ..settings.maps import ShadowMap as Settings
from ..settings.quantities import MAX_TEXELS
from .silhouettes import Outline, SilhouetteMap, find_silhouettes

Overflow = Bool[Array, ""]
"""Whether some of a map's silhouettes are missing, since they cross more sides of texels than there is memory for."""


class ShadowMap(eqx.Module):
    """The depth that a light sees.

    - `depth`: (h, w), window depth; 1 where the light sees nothing. Row 0 is the bottom row. (l, h, w) for a light with
        several views, such as a point light.
    - `light`: the light it was drawn from.
    - `depth_format`: how depths are stored.
    - `silhouettes`: the casters' outlines within texels; none if the map was drawn without edges.
    - `padded`: its depths in an `Atlas`, which look-ups then read instead of padding `depth`.
    - `view`: the light's view, found as the map is made, since every program that looks into the map needs it. For
        another light, make another map.
    - `overflow`: whether silhouettes are missing, so that the map is wrong; none if drawing raises instead.
    - `crossings`: how many sides of texels the silhouettes cross, also of those that are missing; known where
        `overflow` is.
    """

    depth: Float[Array, "*l h w"]
    light: AbstractLight
    depth_format: DepthFormat = eqx.field(static=True)
    silhouettes: SilhouetteMap | None
    padded: Any
    view: View
    overflow: Overflow | None
    crossings: Int[Array, ""] | None

    def __init__(
        self,
        depth: Float[Array, "*l h w"],
        light: AbstractLight,
        depth_format: DepthFormat = Settings.depth_format,
        silhouettes: SilhouetteMap | None = None,
        padded: Any = None,
        view: View | None = None,
        overflow: Overflow | None = None,
        crossings: Int[Array, ""] | None = None,
    ):
        self.depth, self.light, self.depth_format = depth, light, depth_format
        self.silhouettes, self.padded = silhouettes, padded
        self.overflow, self.crossings = overflow, crossings
        self.view = light.view() if view is None else view

    def __repr__(self) -> str:
        return shown_with_values(self)

    def _repr_html_(self) -> str | None:
        """A picture of the depths, dark where they are near. Of several layers, the first."""
        if not is_known(self):
            return None
        depth = np.asarray(self.depth)
        size = " x ".join(map(str, depth.shape[::-1]))
        title = f"ShadowMap of a {type(self.light).__name__}: {size} texels, {self.depth_format}"
        return as_html(title, grey_of(depth.reshape(-1, *depth.shape[-2:])[0]))

    @property
    def resolution(self) -> Resolution:
        """(height, width) in texels."""
        height, width = self.depth.shape[-2:]
        return height, width


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
    - `crossings`: how many crossings of silhouettes with the sides of texels there is memory for; a static number, by
        default from `plan_crossings`. Under a trace, it is required with `edges`.
    - `raises`: whether more crossings than that are an error. Otherwise the map's `overflow` says whether there are
        more: throw such a map away, and draw again with more memory.
    - `shift`: (2,), how far the grid of texels is moved, in texels: points lie so much further along x and y of the
        map. It stays within a texel, since the window moves with the grid. None to leave it where the light has it.
    - `buffer`: as for `rasterize`; ignored with `edges`.

    **Raises** `ValueError` if `depth_layer` is unknown, if `edges` are given with another one than `"nearest"` or with
    `cull`, or without `crossings` under a trace, if `edges` or a `polygon_offset` are given for a warped map, or
    `edges` for one with pages or with cascades of several sizes, or a `shift` for any of these, and what `rasterize`
    raises; and a runtime error if the silhouettes have more `crossings`.
    """
    mesh = as_mesh(mesh)
    # It checks them.
    MapSettings(resolution, depth_layer, cull, depth_format, polygon_offset)
    view = light.view() if shift is None else light.view().shifted(shift, resolution)
    if edges is not None:
        _check_allows_edges(view, resolution, depth_layer, cull)
    if polygon_offset is not None and view.warp is not None:
        raise ValueError(
            "the shadow map is warped, and polygon_offset was given; expected none: leave it out, or use a layout "
            "without a warp"
        )
    if edges is not None and crossings is None:
        crossings = plan_crossings(mesh, light, resolution, edges)
    mesh = mesh.padded()
    edges = None if edges is None else edges.padded(mesh.faces.shape[0])
    clip = view.clip_vertices(mesh.vertices)
    # Pages have places in virtual maps of their own; other layers show the virtual map that begins at their corner.
    viewports = None if view.tile is None or view.pages is not None else jnp.stack([view.tile.size] * 2, axis=-1)
    test = DepthTest(depth_format)
    is_plain = depth_format == "float32" and polygon_offset is None

    def draw(behind: Int[Array, "*l h w"] | None = None) -> Fragments:
        return rasterize(
            clip,
            mesh.faces,
            resolution,
            cull=cull,
            depth_test=test if view.warp is None else DepthTest(),
            polygon_offset=polygon_offset,
            behind=behind,
            pages=view.pages,
            viewports=viewports,
            buffer=buffer,
        )

    def depth_of(seen: Fragments) -> Float[Array, "*l h w"]:
        if view.warp is not None:
            return _unwarped_depth(seen.face, clip, view.unwarped.clip_vertices(mesh.vertices), mesh.faces, test)
        depth = _depth(seen.face, clip, mesh.faces, view.tile)
        return depth if is_plain else with_gradient_of(depth, seen.depth)

    if edges is None or crossings is None:
        seen = draw()
        depth = depth_of(seen)
        if depth_layer != "nearest":
            second = depth_of(draw(seen.face))
            depth = second if depth_layer == "second" else _midpoint(depth, second, test)
        return ShadowMap(depth, light, depth_format, view=view)
    seen, corners = _with_corners(clip, mesh.faces, resolution, test, polygon_offset)
    depth = depth_of(seen)
    silhouettes, needed = _silhouettes(depth, corners, clip, mesh, light, edges, crossings)
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


def _check_allows_edges(view: View, resolution: Resolution, depth_layer: DepthLayer, cull: Cull) -> None:
    """**Raises** `ValueError` for a map that cannot have silhouettes."""
    if max(resolution) >= MAX_TEXELS:
        raise ValueError(
            f"edges were given for a map of {resolution} texels, (height, width); expected at most "
            f"{MAX_TEXELS - 1} on a side, since the corners of texels are drawn too: leave edges out, or lower "
            "the resolution"
        )
    if depth_layer != "nearest" or cull != "none":
        raise ValueError(
            f'edges were given with depth_layer {depth_layer!r} and cull {cull!r}; expected "nearest" and "none": '
            "leave edges out, or change depth_layer and cull"
        )
    if not view.has_even_texels:
        layout = "pages" if view.pages is not None else "cascades of several sizes"
        raise ValueError(
            f"edges were given for a map with {layout if view.warp is None else 'a warp'}, which has no silhouettes; "
            "expected no edges: leave them out, or use another layout"
        )


# Pixels along a side. Larger buffers take too much memory, and too much time at each drawing.
_MAX_SHARED = 2049


@dataclasses.dataclass(frozen=True)
class MapSettings:
    """How a shadow map is drawn; see `draw_shadow_map`.

    - `silhouettes`: whether the map holds silhouettes. With `None`, it does if lights or meshes are fitted, because
        derivatives with respect to these need them.

    **Raises** `ValueError` for a value that is not allowed.
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
        """The shadow map of `casters` under `light`; `edges`, `crossings`, `raises` and `shift` as for
        `draw_shadow_map`."""
        given = {name: value for name, value in vars(self).items() if name != "silhouettes"}
        return draw_shadow_map(casters, light, **given, **how, buffer=self.buffer(self.resolution))

    def buffer(self, image: Resolution) -> Resolution | None:
        """The buffer for `draw_surface` with which an `image` of this size and the map are drawn by one program.

        **Returns** `None` if the image does not fit in, if the map is so large that sharing would not pay, or if its
        depths are stored otherwise than an image's, which takes another program.
        """
        if self.depth_format != "float32" or self.polygon_offset is not None:
            return None
        height, width = self.resolution
        # With silhouettes, as in fits of lights or meshes, the corners of texels are drawn too.
        size = (height, width) if self.silhouettes is False else (height + 1, width + 1)
        return size if all(n <= side <= _MAX_SHARED for n, side in zip(image, size, strict=True)) else None


class MapPlan(eqx.Module):
    """What a technique must know of a scene before it draws a shadow map inside `jax.jit`.

    - `edges`: of the casters; none for a map without silhouettes.
    - `crossings`, `raises`: as for `draw_shadow_map`.
    """

    edges: Edges | None = None
    crossings: int | None = eqx.field(static=True, default=None)
    raises: bool = eqx.field(static=True, default=True)


def plan_crossings(mesh: Mesh, light: AbstractLight, resolution: Resolution, edges: Edges) -> int:
    """How many sides of texels this map's silhouettes cross, rounded up to a power of two.

    **Arguments:** as for `draw_shadow_map`.

    **Raises** `ValueError` under a trace.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((mesh, light, edges))):
        raise ValueError(
            "a shadow map with edges was drawn inside jax.jit (or grad, or vmap) without crossings; expected their "
            "number, since shapes must be known there: call plan_crossings(...) outside, and pass its result to "
            "draw_shadow_map as crossings"
        )
    mesh = mesh.padded()
    return round_up_to_power_of_two(int(_crossings(mesh, light, edges.padded(mesh.faces.shape[0]), resolution)))


def _with_corners(
    clip: Float[Array, "*l v 4"],
    faces: Faces,
    resolution: Resolution,
    test: DepthTest,
    polygon_offset: Any,
) -> tuple[Fragments, Float[Array, "*l H W"]]:
    """What the texels of a map see at their centres, and the window depth at their corners.

    Both are views of one drawing, so that the rasterizer is compiled once.
    """
    height, width = resolution
    views = _centres_and_corners(clip, resolution)
    sides = np.repeat(np.array([[height, width], [height + 1, width + 1]], np.int32), len(views) // 2, axis=0)
    seen = rasterize(
        views,
        faces,
        (height + 1, width + 1),
        depth_test=test,
        polygon_offset=polygon_offset,
        viewports=as_array(sides),
    )
    return _parted(seen, clip.shape[:-2], resolution)


@eqx.filter_jit
def _centres_and_corners(clip: Float[Array, "*l v 4"], resolution: Resolution) -> Float[Array, "m v 4"]:
    """Clip coordinates of all layers of a map, and then of all layers of an image of its texels' corners."""
    layers = clip.reshape(-1, *clip.shape[-2:])
    return jnp.concatenate([layers, _about_corners(layers, resolution)])


@eqx.filter_jit
def _parted(
    seen: Fragments, layers: tuple[int, ...], resolution: Resolution
) -> tuple[Fragments, Float[Array, "*l H W"]]:
    """A map, and the depth at its texels' corners, of the views of `_centres_and_corners`."""
    height, width = resolution
    parts = jax.tree.map(lambda image: image.reshape(2, *layers, *image.shape[-2:]), seen)
    return jax.tree.map(lambda image: image[0, ..., :height, :width], parts), parts.depth[1]


def _about_corners(clip: Float[Array, "*l v 4"], resolution: Resolution) -> Float[Array, "*l v 4"]:
    """Clip coordinates of an image whose pixel centres are the corners of the map's texels."""
    height, width = resolution
    return clip * jnp.array([width / (width + 1), height / (height + 1), 1, 1], clip.dtype)


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
    """The silhouettes in a map, and how many sides of texels they cross. If there are more than `crossings`, some are
    missing."""
    height, width = depth.shape[-2:]
    outline = Outline.of(clip, mesh, light, edges, (height, width))
    found = find_silhouettes(depth, corners.astype(depth.dtype), outline, crossings)
    return found, jnp.sum(outline.counts)


@eqx.filter_jit
def _midpoint(nearest: Float[Array, "*n"], second: Float[Array, "*n"], test: DepthTest) -> Float[Array, "*n"]:
    """The mean of two depths, rounded as the buffer stores it; empty texels stay empty."""
    middle = (nearest + second) / 2
    return _rounded(middle, test)


def _rounded(depth: Float[Array, "*n"], test: DepthTest) -> Float[Array, "*n"]:
    return with_gradient_of(depth, test.decode(test.encode(depth)))


@eqx.filter_jit
def _unwarped_depth(
    face: Int[Array, "h w"],
    clip: Float[Array, "v 4"],
    unwarped: Float[Array, "v 4"],
    faces: Faces,
    test: DepthTest,
) -> Float[Array, "h w"]:
    """Depth without the warp that the faces were drawn with, as the buffer stores it.

    It is the depth that was drawn, times the warp's divisor at the texel. Interpolated afresh, it has the rounding of
    other maps.
    """
    part = lambda face, rows: interpolate_depth(barycentrics(face, clip, faces, rows), unwarped, faces)
    # The warp moves the far plane away. What lies beyond it casts no shadow.
    return _rounded(jnp.minimum(by_bands(part, face), 1), test)


@eqx.filter_jit
def _depth(
    face: Int[Array, "*l h w"], clip: Float[Array, "*m v 4"], faces: Faces, tile: Tile | None
) -> Float[Array, "*l h w"]:
    of_view = lambda view: visible_depth(view[0], view[1], faces, view[2])
    views = face, clip, tile
    if clip.ndim == 2:
        return of_view(views)
    # On a CPU one after the other: bands of several images at once do not fit into the cache.
    return lax.map(of_view, views, batch_size=chunk_size(1, clip.shape[0]))
