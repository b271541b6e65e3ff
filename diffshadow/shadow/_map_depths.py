"""Depths at the centres and corners of a shadow map's texels."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .._arithmetic import with_gradient_of
from .._device import chunk_size
from .._types import Faces
from ..geometry import Tile
from ..raster import (
    DepthTest,
    barycentrics,
    by_bands,
    interpolate_depth,
    visible_depth,
)


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
    """The depth as the buffer stores it, without the warp that the faces were drawn with.

    It is the drawn depth times the warp's divisor at the texel. A new interpolation would have the rounding of other
    maps.
    """
    part = lambda face, rows: interpolate_depth(barycentrics(face, clip, faces, rows), unwarped, faces)
    # The warp moves the far plane away. Surfaces beyond it cast no shadow.
    return _rounded(jnp.minimum(by_bands(part, face), 1), test)


@eqx.filter_jit
def depth_at_centres(
    face: Int[Array, "*l h w"], clip: Float[Array, "*m v 4"], faces: Faces, tile: Tile | None
) -> Float[Array, "*l h w"]:
    of_view = lambda view: visible_depth(view[0], view[1], faces, view[2])
    views = face, clip, tile
    if clip.ndim == 2:
        return of_view(views)
    # On a CPU one after another, because bands of several images together do not fit into the cache.
    return lax.map(of_view, views, batch_size=chunk_size(1, clip.shape[0]))
