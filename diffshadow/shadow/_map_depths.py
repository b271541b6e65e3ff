"""Depths at the centres and corners of a shadow map's texels."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from .._arithmetic import as_array, with_gradient_of
from .._device import chunk_size
from .._types import Faces, Resolution
from ..geometry import Tile
from ..raster import (
    DepthTest,
    Fragments,
    barycentrics,
    by_bands,
    interpolate_depth,
    rasterize,
    visible_depth,
)


def with_corners(
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
def midpoint(nearest: Float[Array, "*n"], second: Float[Array, "*n"], test: DepthTest) -> Float[Array, "*n"]:
    """The mean of two depths, rounded as the buffer stores it; empty texels stay empty."""
    middle = (nearest + second) / 2
    return _rounded(middle, test)


def _rounded(depth: Float[Array, "*n"], test: DepthTest) -> Float[Array, "*n"]:
    return with_gradient_of(depth, test.decode(test.encode(depth)))


@eqx.filter_jit
def unwarped_depth(
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
def depth_at_centres(
    face: Int[Array, "*l h w"], clip: Float[Array, "*m v 4"], faces: Faces, tile: Tile | None
) -> Float[Array, "*l h w"]:
    of_view = lambda view: visible_depth(view[0], view[1], faces, view[2])
    views = face, clip, tile
    if clip.ndim == 2:
        return of_view(views)
    # On a CPU one after the other: bands of several images at once do not fit into the cache.
    return lax.map(of_view, views, batch_size=chunk_size(1, clip.shape[0]))
