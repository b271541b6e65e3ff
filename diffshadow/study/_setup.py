"""What fits and renders begin with: the scene drawn from both sides, and the truth."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float32

from .. import geometry, io, raster, reference, shadow
from .._types import HostArray
from ..config import Config, ConfigError, ImageReferenceConfig, Problem, build_scene
from ._progress import Stages


class Drawn(NamedTuple):
    """A scene as light and camera see it, and its truth.

    - `mask`: (h, w), the pixels that count: where raster and reference see a surface, and the map covers it.
    """

    scene: geometry.Scene
    shadow_map: shadow.ShadowMap
    surface: raster.Surface
    reference: reference.Reference
    mask: Bool[HostArray, "h w"]

    @property
    def noise_floor(self) -> float | None:
        """Of the reference, in visibility; `None` if that is not known, since it was not traced here."""
        return self.reference.noise_floor if self.reference.samples else None


def draw(config: Config, scene: geometry.Scene, technique: shadow.ShadowMapping, stages: Stages) -> Drawn:
    """Draws `scene` and finds its reference. What can go wrong goes wrong before rays are traced.

    **Raises** `ConfigError` if no pixel counts, or the reference does not suit the scene.
    """
    with stages.stage("drawing"):
        shadow_map = shadow.draw_shadow_map(
            scene.mesh, scene.light, config.shadow_map.resolution, cull=config.shadow_map.cull
        )
        surface = raster.draw_surface(scene.mesh, scene.camera)
        covered = np.asarray(_covered(technique, shadow_map, surface))
    if not covered.any():
        raise _error(
            config,
            ("scene",),
            "none of the camera's pixels shows a surface within the light's frustum, so there is nothing to compare; "
            "expected both to see the same part of the scene: move or turn the camera or the light",
        )
    with stages.stage("tracing reference"):
        truth = _reference(config, scene, stages)
    mask = covered & truth.mask
    if not mask.any():
        raise _error(config, ("scene", "camera"), "sees a surface at no pixel's centre; expected some: move it nearer")
    return Drawn(scene, shadow_map, surface, truth, mask)


def load(config: Config, stages: Stages) -> geometry.Scene:
    """The scene of `config`."""
    with stages.stage("loading"):
        return build_scene(config)


def visibility_of(technique: shadow.ShadowMapping, drawn: Drawn) -> Float32[HostArray, "h w"]:
    """The technique's visibility, in the host's memory."""
    return np.asarray(_visibility(technique, drawn.shadow_map, drawn.surface), dtype=np.float32)


_covered = eqx.filter_jit(lambda technique, shadow_map, surface: technique.covered(shadow_map, surface))
_visibility = eqx.filter_jit(lambda technique, shadow_map, surface: technique.visibility(shadow_map, surface))


def _reference(config: Config, scene: geometry.Scene, stages: Stages) -> reference.Reference:
    if isinstance(config.reference, ImageReferenceConfig):
        try:
            return reference.reference_from_image(io.read_visibility(config.reference.path), scene)
        except ValueError as error:
            raise _error(config, ("reference", "path"), str(error)) from error
    samples, sampler = config.reference.samples, config.reference.sampler

    def trace() -> dict[str, HostArray]:
        show = lambda share: stages.show("tracing reference", f"{samples} rays a pixel", share)
        traced = reference.trace_visibility(scene, samples, sampler, config.seed, progress=show)
        return {field.name: np.asarray(getattr(traced, field.name)) for field in dataclasses.fields(traced)}

    arrays = io.cached_arrays(reference.cache_key(scene, samples, sampler, config.seed), trace)
    return reference.Reference(**{**arrays, "samples": int(arrays["samples"])})  # type: ignore[arg-type]


def _error(config: Config, path: tuple[str | int, ...], what: str) -> ConfigError:
    return ConfigError([Problem(config.origin.place(path), ".".join(map(str, path)), what)])
