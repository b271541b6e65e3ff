"""What fits and conversions say in an engine's own units."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32
from rich.console import Console

from ..._types import HostArray, VectorMap
from ...config import Config, ConfigError, Mistake, build_shadow_mapping
from ...geometry import AbstractLight, PointLight
from ...raster import draw_surface
from ...shadow import BabylonJs, FittableTechnique, Receiver, ThreeJs, engine_code, engine_settings, receiver
from ..pages import _table as table
from ._progress import Stages
from ._setup import Drawn, load

CODE = "engine.js"
"""The file in a run's folder that holds the code."""


def code_of(technique: FittableTechnique, drawn: Sequence[Drawn]) -> dict[str, str]:
    """The code for each light, by its key; none if the technique is no engine's."""
    if not isinstance(technique, ThreeJs | BabylonJs):
        return {}
    return {each.key: engine_code(technique, each.scene.light, _distances(each)) for each in drawn}


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
        for index, key in enumerate(config.scene.each_light):
            lit = scene.lit_by(index)
            state = technique.prepare(lit)
            counted = np.asarray(technique.covered(state, surface))
            at: Receiver = receiver(state, surface)
            position = ("scene", *key)
            if not counted.any():
                what = "lights no surface that the camera sees; expected some: move one of them"
                raise ConfigError([Mistake(config.origin.place(position), ".".join(map(str, position)), what)])
            middle = lambda values, counted=counted: float(np.median(np.asarray(values)[counted]))
            texel, distance = middle(at.texel_size), middle(_along(lit.light, surface.position))
            unit = texel if config.bias.unit == "texels" else texel / middle(at.depth_per_texel)
            bias = config.bias.constant * unit
            rows = engine_settings(lit.light, config.shadow_map.resolution, bias, config.bias.normal_offset, distance)
            title = (
                f"{'.'.join(map(str, position))}: {bias:.4g} world units towards the light and "
                f"{config.bias.normal_offset:.4g} texels along the normal; a texel is {texel:.4g} wide at the distance "
                f"{distance:.4g}"
            )
            table.print_settings(console, title, rows)
    if config.bias.slope or config.bias.plane.type != "none":
        table.print_lines(console, ["bias.slope and bias.plane are left out: most engines have no such setting"])
