"""The faces at the centres and at the corners of an image's pixels."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arithmetic import as_array, is_traced
from .._types import Faces, Resolution
from ._rasterize import Fragments, rasterize


def rasterize_with_corners(
    clip: Float[Array, "*l v 4"], faces: Faces, resolution: Resolution, **how: Any
) -> tuple[Fragments, Fragments]:
    """The faces that each layer sees at pixel centres, (h, w), and at pixel corners, (h + 1, w + 1).

    Both are views of one drawing, so that the rasterizer is compiled once. Arguments, including `how`, are as for
    `rasterize`.
    """
    height, width = resolution
    if not is_traced((clip, faces)):
        # They share a program anyway, so they need not be combined.
        draw = partial(rasterize, faces=faces, buffer=(height + 1, width + 1), **how)
        return draw(clip, resolution=resolution), draw(
            _about_corners(clip, resolution), resolution=(height + 1, width + 1)
        )
    views = _centres_and_corners(clip, resolution)
    sides = np.repeat(np.array([[height, width], [height + 1, width + 1]], np.int32), len(views) // 2, axis=0)
    seen = rasterize(views, faces, (height + 1, width + 1), viewports=as_array(sides), **how)
    return _parted(seen, clip.shape[:-2], resolution)


@eqx.filter_jit
def _centres_and_corners(clip: Float[Array, "*l v 4"], resolution: Resolution) -> Float[Array, "m v 4"]:
    """Clip coordinates of all layers of an image, followed by all layers of the image of its pixel corners."""
    layers = clip.reshape(-1, *clip.shape[-2:])
    return jnp.concatenate([layers, _about_corners(layers, resolution)])


@eqx.filter_jit
def _about_corners(clip: Float[Array, "*l v 4"], resolution: Resolution) -> Float[Array, "*l v 4"]:
    """Clip coordinates for an image whose pixel centres are this image's pixel corners."""
    height, width = resolution
    return clip * jnp.array([width / (width + 1), height / (height + 1), 1, 1], clip.dtype)


@eqx.filter_jit
def _parted(seen: Fragments, layers: tuple[int, ...], resolution: Resolution) -> tuple[Fragments, Fragments]:
    """The images at centres and at corners, from the views of `_centres_and_corners`."""
    height, width = resolution
    parts = jax.tree.map(lambda image: image.reshape(2, *layers, *image.shape[-2:]), seen)
    centres = jax.tree.map(lambda image: image[0, ..., :height, :width], parts)
    return centres, jax.tree.map(lambda image: image[1], parts)
