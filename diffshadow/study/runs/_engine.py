"""What fits and conversions say in an engine's own units."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32
from rich.console import Console

from ..._types import HostArray, VectorMap
from ...config import Config, ConfigError, Mistake, build_shadow_mapping
from ...geometry import AbstractLight, PointLight, Scene
from ...raster import Surface, draw_surface
from ...shadow import (
    BabylonJs,
    EngineSetting,
    FittableTechnique,
    ShadowMapping,
    ThreeJs,
    engine_code,
    engine_settings,
    receiver,
)
from ..pages import _table as table
from ._progress import Stages
from ._setup import Drawn, load

CODE = "engine.js"
"""The file in a run's folder that holds the code."""


def code_of(technique: FittableTechnique, drawn: Sequence[Drawn]) -> dict[str, str]:
    """The code for each light, by its key; none if the technique is no engine's."""
    if not isinstance(technique, ThreeJs | BabylonJs):
        return {}
    return {each.key: engine_code(technique, each.scene.light, _distances(each), each.scene.origin) for each in drawn}


def _distances(drawn: Drawn) -> tuple[float, float]:
    """The least and greatest distance of what counts along the light's axis, or that of a point light's faces."""
    along = _along(drawn.scene.light, drawn.surface.position)[drawn.mask]
    return float(along.min()), float(along.max())


def _along(light: AbstractLight, points: VectorMap) -> Float32[HostArray, "h w"]:
    """The distance of `points` (h, w, 3) along the light's axis, or that of the face of a point light's map."""
    if isinstance(light, PointLight):
        return np.asarray(abs(points - light.position).max(axis=-1))
    return np.asarray(light.view().distance(points))


def convert(config: Config, *, console: Console) -> None:
    """Prints the constant bias and the normal offset of `config` in the units of engines, for each of its lights.

    **Raises** `ConfigError` for a technique or a light that has none of these.
    """
    if config.technique.type != "shadow_map":
        what = f"is {config.technique.type}; expected shadow_map, whose bias is converted: change it"
        raise ConfigError([Mistake(config.origin.place(("technique", "type")), "technique.type", what)])
    with Stages(console) as stages:
        scene = load(config, stages).scene
        surface, technique = draw_surface(scene.mesh, scene.camera), build_shadow_mapping(config, fitting=False)
        for index, path in enumerate(config.scene.each_light):
            key = ("scene", *path)
            try:
                title, settings = _converted(config, technique, scene.lit_by(index), surface)
            except ValueError as error:
                raise ConfigError([Mistake(config.origin.place(key), ".".join(map(str, key)), str(error))]) from error
            table.print_settings(console, f"{'.'.join(map(str, key))}: {title}", settings)
    if config.bias.slope or config.bias.terms.given or config.bias.plane.type != "none":
        what = "bias.slope, bias.terms and bias.plane are left out: most engines have no such setting"
        table.print_lines(console, [what])


def _converted(
    config: Config, technique: ShadowMapping, scene: Scene, surface: Surface
) -> tuple[str, list[EngineSetting]]:
    """What the bias amounts to at the median receiver, and the settings of engines.

    **Raises** `ValueError` if the light lights nothing that the camera sees, or no engine has it.
    """
    shadow_map = technique.prepare(scene)
    counted = np.asarray(technique.covered(shadow_map, surface))
    if not counted.any():
        raise ValueError("lights no surface that the camera sees; expected some: move one of them")
    at = receiver(shadow_map, surface)
    median = lambda values: float(np.median(np.asarray(values)[counted]))
    texel, distance = median(at.texel_size), median(_along(scene.light, surface.position))
    offset = config.bias.normal_offset
    bias = config.bias.constant * (texel if config.bias.unit == "texels" else texel / median(at.depth_per_texel))
    where = "" if scene.light.is_directional else f" at the distance {distance:.4g}"
    title = (
        f"{bias:.4g} world units towards the light, and {offset:.4g} texels along the normal; a texel is {texel:.4g} "
        f"world units wide{where}"
    )
    return title, engine_settings(scene.light, technique.map.resolution, bias, offset, distance)
