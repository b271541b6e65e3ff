"""Shaded pictures of a run, for the eye alone: nothing is measured on them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import shading
from .._types import HostArray
from ._setup import Drawn


def shade(drawn: Drawn, visibility: Float[HostArray, "h w"]) -> Float[HostArray, "h w 3"]:
    """The scene under `visibility`, (h, w, 3), in sRGB from 0 to 1."""
    scene = drawn.scene
    linear = _shaded(shading.Phong(), drawn.surface, jnp.asarray(visibility), scene.light, scene.camera)
    return _to_srgb(np.clip(np.asarray(linear, dtype=np.float64), 0, 1))


_shaded = eqx.filter_jit(lambda phong, *args: phong(*args))


def _to_srgb(linear: Float[HostArray, "h w 3"]) -> Float[HostArray, "h w 3"]:
    """The transfer function of sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
