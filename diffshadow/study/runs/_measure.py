"""How images of visibility are measured and shaded."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, UInt8

from ... import fit, geometry, metrics, raster, shadow
from ..._arithmetic import as_float
from ..._types import HostArray
from ...config import Config, build_shading
from ...settings.shading import INTENSITY
from ...shading import Phong, to_srgb
from .._drawn import Drawn
from ..record._runs import Aliasing, Extents

Image = Float[HostArray, "h w"]
Pictures = dict[str, UInt8[HostArray, "h w 3"]]
"""Pictures in sRGB, 8 bits per channel, by the names of their arrays."""


def measured(image: Any, drawn: Drawn) -> dict[str, float]:
    """The errors of `image` (h, w) by name; NaN if no pixel counts."""
    if not drawn.pixels:
        return {field.name: math.nan for field in dataclasses.fields(metrics.ShadowErrors)}
    return metrics.measure_errors(image, drawn.reference.visibility, drawn.mask).as_dict()


def combined(errors: Sequence[Mapping[str, float]], drawn: Sequence[Drawn]) -> dict[str, float]:
    """The errors of all lights together: means, weighted by the number of pixels that count; for RMSEs, the root of the
    mean square."""
    pixels = np.asarray([each.pixels for each in drawn], np.float64)
    weights = pixels / pixels.sum()
    return {
        name: math.sqrt(_mean([one[name] ** 2 for one in errors], weights))
        if name == "rmse"
        else _mean([one[name] for one in errors], weights)
        for name in errors[0]
    }


def _mean(values: Sequence[float], weights: np.ndarray) -> float:
    # A light without pixels that count has weight 0, and its errors are NaN.
    return float(sum(value * weight for value, weight in zip(values, weights, strict=True) if weight > 0))


def noise(drawn: Sequence[Drawn]) -> float | None:
    """The reference's own error over all lights; `None` if it is unknown."""
    floors = [each.noise_floor for each in drawn]
    if any(floor is None for floor in floors):
        return None
    return combined([{"rmse": floor} for floor in floors if floor is not None], drawn)["rmse"]


def aliasing(technique: shadow.AbstractTechnique, drawn: Drawn) -> Aliasing | None:
    """The size of the technique's texels on the screen; `None` without a shadow map, or if no surface in the map faces
    the light."""
    if not isinstance(technique, shadow.ShadowMapping):
        return None
    found = technique.aliasing(drawn.state, drawn.surface, drawn.scene.camera)
    if not np.asarray(found.mask).any():
        return None
    extents = lambda extent: Extents.of(metrics.measure_aliasing(extent, found.mask))
    return Aliasing(extent=extents(found.extent), perspective=extents(found.perspective_extent))


def suffix(index: int, drawn: Sequence[Drawn]) -> str:
    """Suffix of the files of the light at `index`; empty if there is only one light."""
    return "" if len(drawn) == 1 else f"_{index}"


def stacked(images: Sequence[Any]) -> np.ndarray:
    """One image (h, w), or the images of several lights (l, h, w)."""
    return np.asarray(images[0]) if len(images) == 1 else fit.stack_of([np.asarray(image) for image in images])


def light_arrays(drawn: Sequence[Drawn]) -> dict[str, Any]:
    """The maps that the technique drew from each light, by name."""
    names = {
        shadow.ShadowMap: ("shadow_map_depth", "depth"),
        shadow.EngineMap: ("shadow_map_depth", "depth"),
        shadow.ProjectiveTexture: ("texture_coverage", "coverage"),
    }
    kind = type(drawn[0].state)
    if kind not in names:
        return {}
    name, field = names[kind]
    return {f"{name}{suffix(i, drawn)}": getattr(each.state, field) for i, each in enumerate(drawn)}


def shaded(config: Config | None, drawn: Sequence[Drawn], visibility: Sequence[Image]) -> UInt8[HostArray, "h w 3"]:
    """The scene lit by all its lights, each with its visibility: (h, w, 3), in sRGB, 8 bits per channel.

    **Arguments:** `config`: the configuration whose shading is used; the default shading if it has none.
    """
    picture = shade_lit(config, drawn[0].surface, [each.scene for each in drawn], visibility)
    return np.rint(picture * 255).astype(np.uint8)


def shade_lit(
    config: Config | None, surface: raster.Surface, lit: Sequence[geometry.Scene], visibility: Sequence[Image]
) -> Float[HostArray, "h w 3"]:
    """Like `shaded`, but from 0 to 1, and for a `surface` in scenes that have one of the lights each."""
    lights, seen = [scene.light for scene in lit], [as_float(image) for image in visibility]
    shading = Phong(intensity=INTENSITY / len(lights)) if config is None else build_shading(config)
    scene = lit[0]
    if config is not None and config.scene.antialiases:
        drawn = raster.draw_antialiased(scene.mesh, scene.camera)
        linear = _shaded_antialiased(shading, drawn, seen, lights, scene.camera)
    else:
        whole = raster.draw_surface(scene.mesh, scene.camera) if surface.albedo is None else surface
        linear = _shaded(shading, whole, seen, lights, scene.camera)
    return to_srgb(np.clip(np.asarray(linear, dtype=np.float64), 0, 1))


def perceptual_error(pictures: Pictures, state: str, drawn: Sequence[Drawn]) -> float | None:
    """ꟻLIP of a state's stored shaded picture, over the pixels that count under any of the lights; `None` without the
    package that measures it."""
    mask = np.any([each.mask for each in drawn], axis=0)
    try:
        mean, _ = metrics.flip(pictures[f"shaded_{state}"] / 255, pictures["shaded_reference"] / 255, mask)
    except ImportError:
        return None
    return mean


_shaded = eqx.filter_jit(lambda shading, *args: shading(*args))
_shaded_antialiased = eqx.filter_jit(lambda shading, *args: shading.antialiased(*args))
