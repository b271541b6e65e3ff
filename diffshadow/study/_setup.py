"""What fits and renders begin with: the scene drawn from both sides, and the truth."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32

from .. import geometry, io, raster, reference
from .._types import HostArray
from ..config import Casting, Config, ConfigError, ImageReferenceConfig, Problem, Technique, build_casting
from . import _techniques as techniques
from ._progress import Stages


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


def draw(config: Config, casting: Casting, technique: Technique, stages: Stages) -> list[Drawn]:
    """Draws the scene and finds its reference, for each light. What can go wrong goes wrong before rays are traced.

    **Raises** `ConfigError` if no pixel counts, or the reference does not suit the scene.
    """
    lit = [casting._replace(scene=casting.scene.lit_by(i)) for i in range(len(casting.scene.lights))]
    paths = [("scene", *key) for key in config.scene.each_light]
    with stages.stage("drawing"):
        surface = raster.draw_surface(casting.scene.mesh, casting.scene.camera)
        from_light = [techniques.draw_from_light(config, technique, each) for each in lit]
        covered = [techniques.covered(technique, *pair, surface) for pair in zip(from_light, lit, strict=True)]
    for path, pixels in zip(paths, covered, strict=True):
        if not pixels.any():
            where = ("scene",) if len(lit) == 1 else path
            raise _error(
                config,
                where,
                "none of the camera's pixels shows a surface within the light's frustum, so there is nothing to "
                "compare; expected both to see the same part of the scene: move or turn the camera or the light",
            )
    with stages.stage("tracing reference"):
        truths = [_reference(config, each.scene, stages) for each in lit]
    if not any((pixels & truth.mask).any() for pixels, truth in zip(covered, truths, strict=True)):
        raise _error(config, ("scene", "camera"), "sees a surface at no pixel's centre; expected some: move it nearer")
    return [
        Drawn(".".join(map(str, path)), each, seen, surface, truth, pixels & truth.mask)
        for path, each, seen, truth, pixels in zip(paths, lit, from_light, truths, covered, strict=True)
    ]


def load(config: Config, stages: Stages) -> Casting:
    """The scene of `config`, and what of it casts shadows."""
    with stages.stage("loading"):
        return build_casting(config)


def visibility_of(technique: Technique, drawn: Drawn) -> Float32[HostArray, "h w"]:
    """The technique's visibility, in the host's memory."""
    return techniques.visibility(technique, drawn.from_light, drawn.casting, drawn.surface)


def _reference(config: Config, scene: geometry.Scene, stages: Stages) -> reference.Reference:
    if isinstance(config.reference, ImageReferenceConfig):
        try:
            return reference.reference_from_image(io.read_visibility(config.reference.path), scene)
        except ValueError as error:
            raise _error(config, ("reference", "path"), str(error)) from error
    traced = config.reference
    how = traced.samples, traced.sampler, config.seed

    def trace() -> dict[str, HostArray]:
        show = lambda share: stages.show("tracing reference", f"{traced.samples} rays a pixel", share)
        found = reference.trace_visibility(scene, *how, progress=show, supersampling=traced.supersampling)
        return {field.name: np.asarray(getattr(found, field.name)) for field in dataclasses.fields(found)}

    arrays = io.cached_arrays(reference.cache_key(scene, *how, traced.supersampling), trace)
    return reference.Reference(**{**arrays, "samples": int(arrays["samples"])})  # type: ignore[arg-type]


def _error(config: Config, path: tuple[str | int, ...], what: str) -> ConfigError:
    return ConfigError([Problem(config.origin.place(path), ".".join(map(str, path)), what)])
