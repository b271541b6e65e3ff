"""Shaded images of a run, for display only: nothing is measured on them."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._types import HostArray
from ...config import Config, build_shading
from ._setup import Drawn


def shade(
    config: Config, drawn: Sequence[Drawn], visibility: Sequence[Float[HostArray, "h w"]]
) -> Float[HostArray, "h w 3"]:
    """The scene lit by all its lights, each with its visibility: (h, w, 3), in sRGB from 0 to 1."""
    lights, seen = [each.scene.light for each in drawn], [jnp.asarray(image) for image in visibility]
    linear = _shaded(build_shading(config), drawn[0].surface, seen, lights, drawn[0].scene.camera)
    return _to_srgb(np.clip(np.asarray(linear, dtype=np.float64), 0, 1))


_shaded = eqx.filter_jit(lambda shading, *args: shading(*args))


def _to_srgb(linear: Float[HostArray, "h w 3"]) -> Float[HostArray, "h w 3"]:
    """The transfer function of sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
