"""Limits on the memory and time of a run that depend on several keys."""

from collections.abc import Iterator, Mapping

from ...settings.engines import Engine
from ...settings.quantities import MAX_TEXELS
from ...settings.reference import TracedReference
from ...settings.scene import Light, PointLight
from ...settings.techniques import Mapped, ProjectiveShadow
from ..sections._fit import FitParameterConfig
from ..sections._section import Conflict, fault
from ._parts import Parts

# About 300 bytes each while an image is processed: 5 GB.
MAX_PIXELS = 1 << 24
"""The most pixels of an image, and of all views of a fit together."""
# About 64 bytes each while four moments of a map are blurred: 4 GB. This is one map of 8192 x 8192.
_MAX_TEXELS = 1 << 26
# 36 bytes each, all in memory at once: 2.4 GB.
_MAX_CAMERA_RAYS = 1 << 26
# Two hours at ten million per second.
_MAX_SHADOW_RAYS = 1 << 36
# Float32 entries of the Jacobian, one per pixel and parameter: 1 GB.
_MAX_DERIVATIVES = 1 << 28
FACES_OF_A_CUBE = 6


def cost_faults(config: Parts) -> Iterator[Conflict]:
    """Faults of a `config` that would take too much memory or time."""
    lights = tuple(config.scene.each_light.values())
    yield from _too_many_pixels(config)
    yield from _too_many_texels(config, lights)
    yield from _too_large_a_share(config, lights, {})
    if isinstance(config.reference, TracedReference):
        yield from _too_many_rays(config, config.reference, lights)


def fit_cost_faults(config: Parts) -> Iterator[Conflict]:
    """`cost_faults` that only a fit has."""
    yield from _too_large_a_share(config, tuple(config.scene.each_light.values()), config.fit.parameters)
    pixels, count = _pixels(config) * len(config.scene.each_light), len(config.fit.parameters)
    if pixels * count > _MAX_DERIVATIVES:
        message = f"has {count} parameters, whose derivatives at {pixels:,} pixels are {pixels * count:,} numbers"
        mend = "fit fewer, or lower scene.camera.resolution"
        yield ("fit", "parameters"), fault(message, f"at most {_MAX_DERIVATIVES:,}, which take 1 GB", mend)


def _pixels(config: Parts) -> int:
    height, width = config.scene.camera.resolution
    return height * width


def _too_many_pixels(config: Parts) -> Iterator[Conflict]:
    pixels = _pixels(config)
    if pixels > MAX_PIXELS:
        message = f"is {list(config.scene.camera.resolution)}, which makes {pixels:,} pixels"
        expected = f"at most {MAX_PIXELS:,}, which take 5 GB"
        yield ("scene", "camera", "resolution"), fault(message, expected, "make it smaller, such as [4096, 4096]")


def _too_many_texels(config: Parts, lights: tuple[Light, ...]) -> Iterator[Conflict]:
    match config.technique:
        case Mapped(layers=layers):
            path, (height, width) = ("shadow_map", "resolution"), config.shadow_map.resolution
        case Engine():
            path, layers, (height, width) = ("shadow_map", "resolution"), 1, config.shadow_map.resolution
        case ProjectiveShadow(resolution=(height, width)):
            path, layers = ("technique", "resolution"), 1
        case _:
            return
    maps = sum(FACES_OF_A_CUBE if isinstance(light, PointLight) else layers for light in lights)
    if maps * height * width > _MAX_TEXELS:
        message = f"is [{height}, {width}], and {maps} such maps hold {maps * height * width:,} texels"
        expected = f"at most {_MAX_TEXELS:,}, which take 4 GB while they are blurred"
        yield (
            path,
            fault(message, expected, "make it smaller, or use fewer lights or cascades; a point light has six maps"),
        )


def _too_large_a_share(
    config: Parts, lights: tuple[Light, ...], bounds: Mapping[str, FitParameterConfig]
) -> Iterator[Conflict]:
    """Faults of layers as large as the largest cascade, with fitted shares at their `bounds`."""
    greatest, (height, width) = config.max_share(bounds), config.shadow_map.resolution
    if greatest is None or (bounds and greatest == config.max_share({})):
        # `cost_faults` reports what does not depend on the bounds.
        return
    assert isinstance(config.technique, Mapped)
    layers = config.technique.layers
    side = int((height * width * layers * greatest) ** 0.5)
    texels = side**2 * layers * len(lights)
    if side <= MAX_TEXELS and texels <= _MAX_TEXELS:
        return
    message = f"lets a cascade have {greatest:.3g} of all texels: {side:,}², for which every map has memory"
    most = min(MAX_TEXELS, int((_MAX_TEXELS / (layers * len(lights))) ** 0.5))
    mend = f"lower it, or shadow_map.resolution = [{height}, {width}]"
    path = ("technique", "shares") if not bounds else ("fit", "parameters")
    yield path, fault(message, f"at most {most:,}²", mend)


def _too_many_rays(config: Parts, traced: TracedReference, lights: tuple[Light, ...]) -> Iterator[Conflict]:
    points = _pixels(config) * traced.supersampling**2 * len(lights)
    if points > _MAX_CAMERA_RAYS:
        message = f"is {traced.supersampling}, which makes {points:,} camera rays over all pixels and lights"
        mend = "lower it, or scene.camera.resolution"
        yield ("reference", "supersampling"), fault(message, f"at most {_MAX_CAMERA_RAYS:,}, which take 2.4 GB", mend)
    sized = sum(light.has_size for light in lights)
    rays = _pixels(config) * max(traced.samples, traced.supersampling**2) * sized
    if rays > _MAX_SHADOW_RAYS:
        message = f"is {traced.samples}, which makes {rays:,} shadow rays over all pixels and lights"
        mend = "lower it, or scene.camera.resolution"
        yield ("reference", "samples"), fault(message, f"at most {_MAX_SHADOW_RAYS:,}, which take hours", mend)
