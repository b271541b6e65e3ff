"""What fits say in an engine's own units."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from ..._types import HostArray, VectorMap
from ...config import Config, DirectionalLightConfig
from ...geometry import WORLD, AbstractLight, DirectionalLight, PointLight
from ...settings import scene
from ...shadow import BabylonJs, EngineLight, FittableTechnique, ThreeJs, engine_code
from .._drawn import Drawn


def code_of(technique: FittableTechnique, config: Config, drawn: Sequence[Drawn]) -> dict[str, str]:
    """The code for each light of `config`, by its key; none if the technique is no engine's."""
    if not isinstance(technique, ThreeJs | BabylonJs):
        return {}
    sections = config.scene.each_light.values()
    return {each.key: _code(technique, section, each) for section, each in zip(sections, drawn, strict=True)}


def _code(technique: ThreeJs | BabylonJs, section: scene.Light, drawn: Drawn) -> str:
    light = _as_given(section, drawn.scene.light)
    # What the section gives is in world coordinates.
    origin = WORLD if isinstance(light, EngineLight) else drawn.scene.origin
    return engine_code(technique, light, _distances(drawn), origin)


def _as_given(section: scene.Light, light: AbstractLight) -> AbstractLight | EngineLight:
    """`light`, or the engine's own camera if the section has one: a light's map keeps its middle and its size only."""
    if not isinstance(section, DirectionalLightConfig) or section.shadow_camera is None:
        return light
    assert isinstance(light, DirectionalLight)
    camera, direction = section.shadow_camera, section.direction or np.asarray(light.direction).tolist()
    target = [at + towards for at, towards in zip(camera.position, direction, strict=True)]
    window = {name: getattr(camera, name) for name in ("left", "right", "top", "bottom")}
    return EngineLight("directional", list(camera.position), camera.near, camera.far, target, window)


def _distances(drawn: Drawn) -> tuple[float, float]:
    """The least and greatest distance of what counts along the light's axis, or a point light's faces' axes."""
    distances = along(drawn.scene.light, drawn.surface.position)[drawn.mask]
    return float(distances.min()), float(distances.max())


def along(light: AbstractLight, points: VectorMap) -> Float32[HostArray, "h w"]:
    """The distance of `points` (h, w, 3) along the axis of the light, or of its face of a point light's map."""
    if isinstance(light, PointLight):
        return np.asarray(abs(points - light.position).max(axis=-1))
    return np.asarray(light.view().distance(points))
