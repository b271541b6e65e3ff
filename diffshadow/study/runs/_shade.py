"""Shaded pictures of a run, and their perceptual error."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, UInt8

from ... import geometry, metrics, raster
from ..._arithmetic import as_float
from ..._types import HostArray
from ...config import Config, build_shading
from ...settings.shading import INTENSITY
from ...shading import Phong, to_srgb
from .._drawn import Drawn

Pictures = dict[str, UInt8[HostArray, "h w 3"]]
"""Pictures in sRGB, 8 bits per channel, by the names of their arrays."""


def shade(
    config: Config | None, drawn: Sequence[Drawn], visibility: Sequence[Float[HostArray, "h w"]]
) -> Float[HostArray, "h w 3"]:
    """The scene lit by all its lights, each with its visibility: (h, w, 3), in sRGB from 0 to 1.

    **Arguments:** `config`: whose shading it is; the default one if there is none.
    """
    return shade_lit(config, drawn[0].surface, [each.scene for each in drawn], visibility)


def shade_lit(
    config: Config | None,
    surface: raster.Surface,
    lit: Sequence[geometry.Scene],
    visibility: Sequence[Float[HostArray, "h w"]],
) -> Float[HostArray, "h w 3"]:
    """As `shade`, of a `surface` in scenes that have one of the lights each."""
    lights, seen = [scene.light for scene in lit], [as_float(image) for image in visibility]
    shading = Phong(intensity=INTENSITY / len(lights)) if config is None else build_shading(config)
    scene = lit[0]
    if config is not None and config.scene.antialiases:
        drawn = raster.draw_antialiased(scene.mesh, scene.camera)
        linear = _shaded_antialiased(shading, drawn, seen, lights, scene.camera)
    else:
        linear = _shaded(shading, surface, seen, lights, scene.camera)
    return to_srgb(np.clip(np.asarray(linear, dtype=np.float64), 0, 1))


def perceptual_error(
    picture: UInt8[HostArray, "h w 3"], reference: UInt8[HostArray, "h w 3"], drawn: Sequence[Drawn]
) -> float | None:
    """ꟻLIP of a shaded picture as it is stored, over the pixels that count under any of the lights; `None` without the
    package that measures it."""
    mask = np.any([each.mask for each in drawn], axis=0)
    try:
        mean, _ = metrics.flip(picture / 255, reference / 255, mask)
    except ImportError:
        return None
    return mean


_shaded = eqx.filter_jit(lambda shading, *args: shading(*args))
_shaded_antialiased = eqx.filter_jit(lambda shading, *args: shading.antialiased(*args))
