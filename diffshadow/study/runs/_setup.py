"""What fits and renders begin with: the scene drawn from both sides, and the truth."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32

from ... import geometry, io, raster, reference
from ..._types import HostArray
from ...config import (
    Casting,
    Config,
    ConfigError,
    ImageReferenceConfig,
    Problem,
    Technique,
    TracedReferenceConfig,
    build_casting,
    build_shading,
)
from . import _techniques as techniques
from ._progress import Stages
from ._sight import blind_camera, blind_light


class Drawn(NamedTuple):
    """A scene as one of its lights and the camera see it, and its truth.

    - `key`: of the light, such as `"scene.light"`.
    - `casting`: the scene with that light alone.
    - `from_light`: what the technique drew from the light.
    - `mask`: (h, w), the pixels that count: where raster and reference see a surface, and the technique covers it.
    """

    key: str
    casting: Casting
    from_light: techniques.FromLight
    surface: raster.Surface
    reference: reference.Reference
    mask: Bool[HostArray, "h w"]

    @property
    def scene(self) -> geometry.Scene:
        """The scene with that light alone."""
        return self.casting.scene

    @property
    def noise_floor(self) -> float | None:
        """Of the reference, in visibility; `None` if that is not known, since it was not traced here."""
        return self.reference.noise_floor if self.reference.samples else None

    @property
    def pixels(self) -> int:
        """How many pixels count."""
        return int(self.mask.sum())


class Seen(NamedTuple):
    """A scene as its lights and the camera see it, before any ray is traced.

    - `keys`: of the lights.
    - `lit`: the scene under each light alone; `from_light`: what the technique drew from each.
    - `covered`: (h, w), for each light, the pixels that the technique can say something of.
    - `image`: (h, w), the reference, where it is read from a file.
    """

    keys: list[tuple[str | int, ...]]
    lit: list[Casting]
    surface: raster.Surface
    from_light: list[techniques.FromLight]
    covered: list[Bool[HostArray, "h w"]]
    image: Float32[HostArray, "h w"] | None


def see(config: Config, casting: Casting, technique: Technique, stages: Stages) -> Seen:
    """Reads the reference's image, if there is one, and draws the scene as camera and lights see it.

    **Raises** `ConfigError` if the image does not suit the camera, or no pixel counts.
    """
    image = _image(config)
    # For its errors: pictures are shaded last.
    build_shading(config)
    lit = [casting._replace(scene=casting.scene.lit_by(i)) for i in range(len(casting.scene.lights))]
    keys: list[tuple[str | int, ...]] = [("scene", *key) for key in config.scene.each_light]
    with stages.stage("drawing"):
        surface = raster.draw_surface(casting.scene.mesh, casting.scene.camera)
        from_light = [techniques.draw_from_light(config, technique, each) for each in lit]
        covered = [techniques.covered(technique, *pair, surface) for pair in zip(from_light, lit, strict=True)]
    blind = blind_camera(config, casting, surface)
    if blind is not None:
        raise _error(config, ("scene", "camera"), blind)
    for key, each, pixels in zip(keys, lit, covered, strict=True):
        if not pixels.any():
            raise _error(config, key, blind_light(config, each, surface))
    return Seen(keys, lit, surface, from_light, covered, image)


def draw(config: Config, casting: Casting, technique: Technique, stages: Stages) -> list[Drawn]:
    """Draws the scene and finds its reference, for each light. What can go wrong goes wrong before rays are traced.

    **Raises** `ConfigError` if no pixel counts, or the reference does not suit the scene.
    """
    seen = see(config, casting, technique, stages)
    with stages.stage("tracing reference"):
        truths = [_reference(config, each.scene, seen.image, stages) for each in seen.lit]
    if not any((pixels & truth.mask).any() for pixels, truth in zip(seen.covered, truths, strict=True)):
        raise _error(config, ("scene", "camera"), "sees a surface at no pixel's centre; expected some; move it nearer")
    return [
        Drawn(".".join(map(str, key)), each, from_light, seen.surface, truth, pixels & truth.mask)
        for key, each, from_light, truth, pixels in zip(
            seen.keys, seen.lit, seen.from_light, truths, seen.covered, strict=True
        )
    ]


def load(config: Config, stages: Stages) -> Casting:
    """The scene of `config`, and what of it casts shadows."""
    with stages.stage("loading"):
        return build_casting(config)


def visibility_of(technique: Technique, drawn: Drawn) -> Float32[HostArray, "h w"]:
    """The technique's visibility, in the host's memory."""
    return techniques.visibility(technique, drawn.from_light, drawn.casting, drawn.surface)


def _image(config: Config) -> Float32[HostArray, "h w"] | None:
    """The visibility that the reference's file has; `None` where rays find it."""
    if not isinstance(config.reference, ImageReferenceConfig):
        return None
    path = ("reference", "path")
    try:
        image = io.read_visibility(config.reference.path)
    except io.FileError as error:
        raise _error(config, path, str(error)) from error
    if image.shape != config.scene.camera.resolution:
        have, need = list(image.shape), list(config.scene.camera.resolution)
        said = f"is an image of {have} pixels, [height, width], and scene.camera.resolution is {need}"
        raise _error(config, path, f"{said}; expected the same; scale the image, or set the resolution")
    return image


def _reference(
    config: Config, scene: geometry.Scene, image: Float32[HostArray, "h w"] | None, stages: Stages
) -> reference.Reference:
    try:
        return _traced(config, scene, stages) if image is None else reference.reference_from_image(image, scene)
    except ValueError as error:
        # Rays may find no surface where drawing finds one at a pixel's edge.
        raise _error(config, ("scene", "camera"), str(error)) from error


def _traced(config: Config, scene: geometry.Scene, stages: Stages) -> reference.Reference:
    traced = config.reference
    assert isinstance(traced, TracedReferenceConfig)
    how = traced.samples, traced.sampler, config.seed

    def trace() -> dict[str, HostArray]:
        show = lambda share: stages.show("tracing reference", f"{traced.samples} rays a pixel", share)
        found = reference.trace_visibility(scene, *how, progress=show, supersampling=traced.supersampling)
        return {field.name: np.asarray(getattr(found, field.name)) for field in dataclasses.fields(found)}

    arrays = io.cached_arrays(reference.cache_key(scene, *how, traced.supersampling), trace)
    return reference.Reference(**{**arrays, "samples": int(arrays["samples"])})  # type: ignore[arg-type]


def _error(config: Config, path: tuple[str | int, ...], what: str) -> ConfigError:
    return ConfigError([Problem(config.origin.place(path), ".".join(map(str, path)), what)])
