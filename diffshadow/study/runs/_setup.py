"""The first steps of fits and renders: drawing the scene from camera and lights, and finding the reference."""

import contextlib
import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32

from ... import fit, geometry, io, raster, reference, shadow
from ..._types import HostArray
from ...config import (
    BuiltMeshes,
    Config,
    ConfigError,
    FitPlan,
    Mistake,
    build_fit,
    build_meshes,
    build_scene,
    build_shading,
)
from ...settings.reference import ImageReference, PictureReference, TracedReference
from .._drawn import Drawn
from ..remarks._scene import dark_scene
from ..remarks._sight import blind_camera, blind_light
from ._progress import Progress


class SeenScene(NamedTuple):
    """A scene as its lights and the camera see it, before any ray is traced.

    - `keys`: keys of the lights.
    - `lit`: the scene with each light alone; `states`: the technique's state for each.
    - `covered`: (h, w), for each light, the pixels that the technique covers.
    - `image`: (h, w), the reference, if it is read from a file.
    - `remarks`: on that file.
    """

    keys: list[tuple[str | int, ...]]
    lit: list[geometry.Scene]
    surface: raster.Surface
    states: list[Any]
    covered: list[Bool[HostArray, "h w"]]
    image: Float32[HostArray, "h w"] | None
    remarks: tuple[str, ...] = ()


class Loaded(NamedTuple):
    """The scene of a configuration, and a sentence for each mesh file that was not read completely.

    - `built`: its meshes; none for a scene that was made in another way.
    """

    scene: geometry.Scene
    remarks: tuple[str, ...] = ()
    built: BuiltMeshes | None = None


def see(
    config: Config,
    scene: geometry.Scene,
    technique: shadow.AbstractTechnique,
    progress: Progress,
    surface: raster.Surface | None = None,
) -> SeenScene:
    """Reads the reference's image, if there is one, and draws the scene as camera and lights see it.

    **Arguments:** `surface`: what the camera sees, if it has been drawn.

    **Raises** `ConfigError` if the image does not match the camera, or no pixel counts.
    """
    remarks: list[str] = []
    with _warnings_to(remarks):
        image = _image(config)
    # Only to raise its errors early; images are shaded last.
    build_shading(config)
    lit = [scene.lit_by(i) for i in range(len(scene.lights))]
    keys: list[tuple[str | int, ...]] = [("scene", *key) for key in config.scene.each_light]
    with progress.stage("drawing"):
        if surface is None:
            has_maps = isinstance(technique, shadow.ShadowMapping)
            buffer = technique.layers.buffer(scene.camera.resolution) if has_maps else None
            surface = raster.draw_surface(scene.mesh, scene.camera, buffer=buffer)
        states = [_prepared(config, technique, each, surface) for each in lit]
        covered = [np.asarray(technique.covered(state, surface)) for state in states]
    blind = blind_camera(config, scene, surface)
    if blind is not None:
        raise _error(config, ("scene", "camera"), blind)
    for key, each, pixels in zip(keys, lit, covered, strict=True):
        if not pixels.any():
            raise _error(config, key, blind_light(config, each, surface))
    return SeenScene(keys, lit, surface, states, covered, image, tuple(remarks))


def check_comparable(config: Config, seen: SeenScene, progress: Progress) -> None:
    """**Raises** `ConfigError` if the reference would be dark in all pixels that count, so that there is nothing to fit
    to. It traces only as many rays as it takes to find one that is not blocked."""
    if seen.image is not None:
        if not any(seen.image[counted].any() for counted in seen.covered):
            what = (
                "is dark in all pixels that count, so that there is nothing to compare; expected light and shadow; "
                "check the image, or whether it is inverted"
            )
            raise _error(config, ("reference", "path"), what)
        return
    with progress.stage("looking for light"):
        dark = dark_scene(config, seen.lit, seen.surface, seen.covered)
    if dark is not None:
        raise _error(config, ("scene",), dark)


def draw(
    config: Config,
    loaded: Loaded,
    technique: shadow.AbstractTechnique,
    progress: Progress,
    *,
    surface: raster.Surface | None = None,
    comparing: bool = False,
) -> list[Drawn]:
    """Draws the scene and finds its reference, for each light. Most errors are raised before rays are traced.

    **Arguments:**

    - `surface`: what the camera sees, if it has been drawn.
    - `comparing`: whether a scene without light is a mistake.

    **Raises** `ConfigError` if no pixel counts, or the reference does not match the scene.
    """
    seen = see(config, loaded.scene, technique, progress, surface)
    if comparing:
        check_comparable(config, seen, progress)
    with progress.stage("tracing reference"):
        truths = [_reference(config, each, seen.image, progress) for each in seen.lit]
    if not any((pixels & truth.mask).any() for pixels, truth in zip(seen.covered, truths, strict=True)):
        raise _error(config, ("scene", "camera"), "sees a surface at no pixel's centre; expected some; move it nearer")
    remarks = (*loaded.remarks, *seen.remarks)
    return [
        Drawn(".".join(map(str, key)), each, state, seen.surface, truth, pixels & truth.mask, remarks)
        for key, each, state, truth, pixels in zip(seen.keys, seen.lit, seen.states, truths, seen.covered, strict=True)
    ]


def _prepared(
    config: Config, technique: shadow.AbstractTechnique, scene: geometry.Scene, surface: raster.Surface
) -> Any:
    """What the technique draws for the scene's only light.

    **Raises** `ConfigError` if the technique does not suit the light or the camera.
    """
    try:
        return technique.prepare(scene, surface)
    except ValueError as error:
        raise _error(config, ("technique",), str(error)) from error


def load(config: Config, progress: Progress, like: Loaded | None = None) -> Loaded:
    """The scene of `config`. Each `io.FileWarning` becomes a remark.

    **Arguments:** `like`: what was loaded for a configuration with the same meshes.
    """
    remarks = [] if like is None else list(like.remarks)
    with progress.stage("loading"), _warnings_to(remarks):
        built = None if like is None else like.built
        built = build_meshes(config) if built is None else built
        scene = build_scene(config, built)
    return Loaded(scene, tuple(remarks), built)


def plan_fit(config: Config, scene: geometry.Scene) -> FitPlan:
    """The fit of `config`, whose scene is `scene`.

    **Raises** `ConfigError` as `build_fit` does, and if there are fewer devices than configured, or the fit cannot use
    as many.
    """
    plan = build_fit(config, scene)
    try:
        fit.devices_of(plan.search.devices, moves=config.moves)
    except ValueError as error:
        raise _error(config, ("fit", "devices"), str(error)) from error
    return plan


@contextlib.contextmanager
def _warnings_to(remarks: list[str]) -> Iterator[None]:
    """Adds each `io.FileWarning` to `remarks`. Other warnings are passed on."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", io.FileWarning)
        yield
    for each in caught:
        if issubclass(each.category, io.FileWarning):
            remarks.append(str(each.message))
        else:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)


def visibility_of(
    technique: shadow.AbstractTechnique | shadow.FittableTechnique, drawn: Drawn
) -> Float32[HostArray, "h w"]:
    """The technique's visibility, as a NumPy array."""
    return np.asarray(technique.visibility(drawn.state, drawn.surface), dtype=np.float32)


def _image(config: Config) -> Float32[HostArray, "h w"] | None:
    """The visibility in the reference's file; `None` if the reference is traced."""
    if not isinstance(config.reference, ImageReference):
        return None
    path = ("reference", "path")
    try:
        image = io.read_visibility(config.reference.path)
    except io.FileError as error:
        raise _error(config, path, str(error)) from error
    if image.shape != config.scene.camera.resolution:
        have, need = list(image.shape), list(config.scene.camera.resolution)
        given = f"is an image of {have} pixels, [height, width], and scene.camera.resolution is {need}"
        raise _error(config, path, f"{given}; expected the same; scale the image, or set the resolution")
    return image


def _reference(
    config: Config, scene: geometry.Scene, image: Float32[HostArray, "h w"] | None, progress: Progress
) -> reference.Reference:
    try:
        return _traced(config, scene, progress) if image is None else reference.reference_from_image(image, scene)
    except ValueError as error:
        # Rays may miss a surface that the rasterizer finds at a pixel's edge.
        raise _error(config, ("scene", "camera"), str(error)) from error


def _traced(config: Config, scene: geometry.Scene, progress: Progress) -> reference.Reference:
    traced = config.reference
    assert isinstance(traced, TracedReference | PictureReference)
    show = lambda done: progress.show("tracing reference", f"{traced.samples} rays per pixel", done)
    return trace(scene, traced.how(config.seed), show)


def trace(
    scene: geometry.Scene, how: Mapping[str, Any], progress: Callable[[float], None] | None = None
) -> reference.Reference:
    """The reference that `reference.trace_visibility` traces with the arguments in `how`; read from disk if it was
    traced before."""

    def find() -> dict[str, HostArray]:
        found = reference.trace_visibility(scene, **how, progress=progress)
        return {field.name: np.asarray(getattr(found, field.name)) for field in dataclasses.fields(found)}

    arrays = io.cached_arrays(reference.key_parts(scene, **how), find)
    return reference.Reference(**{**arrays, "samples": int(arrays["samples"])})  # type: ignore[arg-type]


def keyed_scenes(config: Config, progress: Progress) -> list[reference.KeyedScene]:
    """The scene of `config` under each of its lights alone; none if it cannot be built."""
    try:
        scene = load(config, progress).scene
        return [reference.KeyedScene.of(scene.lit_by(i)) for i in range(len(scene.lights))]
    except (ConfigError, ValueError, OSError):
        # The run reports it.
        return []


def keys_of_references(config: Config, scenes: Sequence[reference.KeyedScene]) -> list[str]:
    """The cache keys of the references that are traced for `config`, one for each of its `keyed_scenes`; none if
    references are read from a file."""
    if not isinstance(config.reference, TracedReference | PictureReference):
        return []
    how = config.reference.how(config.seed)
    return [io.cache_key(reference.key_parts(each, **how)) for each in scenes]


def _error(config: Config, path: tuple[str | int, ...], what: str) -> ConfigError:
    return ConfigError([Mistake(config.origin.place(path), ".".join(map(str, path)), what)])
