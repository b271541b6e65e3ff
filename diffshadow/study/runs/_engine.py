"""Fits of engines' shadows: parameters and bounds for three.js and Babylon.js that suit a scene, and results in an
engine's own units."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float32

from ... import shadow
from ..._types import HostArray, VectorMap
from ...config import Config, ConfigError, DirectionalLightConfig, Mistake, build_technique
from ...geometry import WORLD, AbstractLight, DirectionalLight, PointLight, Scene
from ...raster import Surface, draw_surface
from ...settings import scene
from ...settings.engines import BabylonFilter, BabylonJs, EngineName, Side, ThreeJs
from ...settings.scene import LightKind
from .._drawn import Drawn
from ._progress import Progress
from ._setup import load

# Bounds and start of an engine's bias in texels, and of its normal bias and radius.
_MAX_BIAS, _MAX_OFFSET, MAX_RADIUS = 32.0, 4.0, 16.0
_START = 2.0
SIDES: dict[str, Side] = {"none": "double", "back": "front", "front": "back"}
"""The faces that cast, for each value of `shadow_map.cull`."""
FACES: dict[str, str] = {"double": "both sides of faces cast", "front": "front faces cast", "back": "back faces cast"}
"""The same in words."""


class Lit(NamedTuple):
    """One light's key, and values for the median receiver: a texel's width in world units and in window depth, and the
    distance along the light's axis."""

    key: tuple[str | int, ...]
    scene: Scene
    texel: float
    depth_per_texel: float
    distance: float

    @property
    def kind(self) -> LightKind:
        """Of the light."""
        if self.is_point:
            return "point"
        return "directional" if self.scene.light.is_directional else "spot"

    @property
    def is_point(self) -> bool:
        """Whether its map has six faces."""
        return isinstance(self.scene.light, PointLight)


def lit_by(config: Config, progress: Progress) -> list[Lit]:
    """Each light of `config`, with values for its median receiver.

    **Raises** `ConfigError` if a light reaches nothing that the camera sees, or no engine has such a light.
    """
    whole = load(config, progress).scene
    # The light's own map: neither bias nor filter changes the size of its texels.
    plain = shadow.ShadowMapping(shadow.Nearest(), shadow.Bias(), map=shadow.MapSettings(config.shadow_map.resolution))
    with progress.stage("drawing"):
        surface = draw_surface(whole.mesh, whole.camera)
        return [_lit(config, plain, whole, surface, i) for i in range(len(whole.lights))]


def _lit(config: Config, plain: shadow.ShadowMapping, scene: Scene, surface: Surface, index: int) -> Lit:
    key, one = ("scene", *list(config.scene.each_light)[index]), scene.lit_by(index)
    try:
        shadow_map = plain.prepare(one)
        counted = np.asarray(plain.covered(shadow_map, surface))
        if not counted.any():
            raise ValueError("lights no surface that the camera sees; expected some: move one of them")
        at = shadow.receiver(shadow_map, surface)
        median = lambda values: float(np.median(np.asarray(values)[counted]))
        found = Lit(
            key, one, median(at.texel_size), median(at.depth_per_texel), median(along(one.light, surface.position))
        )
        shadow.engine_settings(one.light, plain.map.resolution, 0.0, 0.0, found.distance)
    except ValueError as error:
        raise ConfigError([Mistake(config.origin.place(key), ".".join(map(str, key)), str(error))]) from error
    return found


class EngineFit(NamedTuple):
    """An engine's shadows, as a fit begins with them.

    - `technique`: its section; `parameters`: the bounds of what can be fitted, by the names of its keys.
    """

    technique: Mapping[str, Any]
    parameters: Mapping[str, Mapping[str, float]]


def bias_of_a_texel(engine: Any, lit: Sequence[Lit]) -> float:
    """The bias of three.js or Babylon.js that moves receivers by one texel towards the light, for the light that needs
    the largest."""
    if isinstance(engine, ThreeJs):
        return -max(each.depth_per_texel for each in lit)
    if any(each.is_point for each in lit):
        views = [each.scene.light.view() for each in lit]
        return max(each.texel / float(view.near + view.far) for each, view in zip(lit, views, strict=True))
    # Depth from -1 to 1.
    return 2 * max(each.depth_per_texel for each in lit)


def three_js(config: Config, lit: Sequence[Lit]) -> EngineFit:
    """The fit of three.js with its filter `PCFShadowMap`. The same faces cast as in `config`."""
    given, one = config.technique, bias_of_a_texel(ThreeJs(), lit)
    sides = (
        {"side": given.side, "shadow_side": given.shadow_side}
        if isinstance(given, ThreeJs)
        else {"shadow_side": SIDES[config.shadow_map.cull]}
    )
    radius = min(getattr(given if isinstance(given, ThreeJs) else config.filter, "radius", 1.0), MAX_RADIUS)
    return EngineFit(
        {"type": "three.js", "shadow_type": "PCFShadowMap", **sides},
        {
            "bias": _bounds(max(_START * one, -1), max(_MAX_BIAS * one, -1), 0),
            "normal_bias": _bounds(0, 0, _MAX_OFFSET * max(each.texel for each in lit)),
            "radius": _bounds(radius, 0, MAX_RADIUS),
        },
    )


def babylon_js(config: Config, lit: Sequence[Lit], kind: BabylonFilter | None = None) -> EngineFit:
    """The fit of Babylon.js with the filter `kind`, by default its `PCF`. The same faces cast as in `config`."""
    is_point = any(each.is_point for each in lit)
    # The engine draws PCF under a point light with the taps of POISSONSAMPLING.
    kind = kind or ("POISSONSAMPLING" if is_point else "PCF")
    metric = bias_of_a_texel(BabylonJs(), lit)
    given = config.technique
    sides = (
        {"back_face_culling": given.back_face_culling, "force_back_faces_only": given.force_back_faces_only}
        if isinstance(given, BabylonJs)
        else {
            "back_face_culling": config.shadow_map.cull != "none",
            "force_back_faces_only": config.shadow_map.cull == "front",
        }
    )
    parameters = {
        "bias": _bounds(min(_START * metric, 1), 0, min(_MAX_BIAS * metric, 1)),
        "normal_bias": _bounds(0, 0, _MAX_OFFSET * max(each.texel for each in lit)),
    }
    if kind == "POISSONSAMPLING":
        parameters["blur_scale"] = _bounds(_START, 0.1, MAX_RADIUS)
    if kind == "PCSS":
        parameters["contact_hardening_light_size_uv_ratio"] = _bounds(0.02, 0, 0.2)
    return EngineFit({"type": "babylon.js", "filter": kind, "float_maps": True, **sides}, parameters)


def engine_fit(name: EngineName, config: Config, lit: Sequence[Lit], kind: str | None = None) -> EngineFit:
    """The fit of any engine that is drawn here, with the filter `kind`, by default the engine's default. The same faces
    cast as in `config`."""
    if name == "three.js":
        return three_js(config, lit)
    if name == "babylon.js":
        return babylon_js(config, lit, cast(BabylonFilter | None, kind))
    own, settings = preset(name, config), shadow.ENGINE_TECHNIQUES[name].settings
    fixed = [key for key, each in settings.each().items() if key != "type" and not each.is_fitted]
    given = {each: _as_written(getattr(own, each)) for each in fixed}
    if kind is not None:
        given[settings.filter_key] = kind
    lights = [(own.frame(each.scene, each.distance), each.distance) for each in lit]
    bounds = {key: _bounds(*each) for key, each in own.bounds(lights).items()}
    return EngineFit({"type": name, **given}, bounds)


def _as_written(value: Any) -> Any:
    """A setting as a configuration has it."""
    return float(value) if hasattr(value, "dtype") else value


def preset(name: EngineName, config: Config) -> shadow.AbstractEngineShadows:
    """An engine's shadows: as in `config` if its technique is this engine's, otherwise with the engine's defaults.

    The map's size and the faces that cast are as in `config`.
    """
    technique = shadow.ENGINE_TECHNIQUES[name]
    if config.technique.type == name:
        return cast(shadow.AbstractEngineShadows, build_technique(config, fitting=False))
    settings, size = technique.settings, config.shadow_map.resolution
    fields: dict[str, Any] = {"resolution": size}
    side = SIDES[config.shadow_map.cull]
    if name == "three.js":
        fields["shadow_side"] = side
    elif name == "babylon.js":
        fields["back_face_culling"] = side != "double"
    elif "side" in settings.each():
        fields["side"] = side
    return technique(**fields)


def _bounds(initial: float, lower: float, upper: float) -> dict[str, float]:
    return {"initial": initial, "lower": lower, "upper": upper}


def code_file(suffix: str) -> str:
    """The file in a run's folder that holds an engine's code, in a language whose files end like this."""
    return f"engine.{suffix}"


def code_of(technique: shadow.FittableTechnique, config: Config, drawn: Sequence[Drawn]) -> dict[str, str]:
    """The code for each light of `config`, by its key; none if the technique is no engine's."""
    if not isinstance(technique, shadow.AbstractEngineShadows):
        return {}
    sections = config.scene.each_light.values()
    return {each.key: _code(technique, section, each) for section, each in zip(sections, drawn, strict=True)}


def _code(technique: shadow.AbstractEngineShadows, section: scene.Light, drawn: Drawn) -> str:
    light = _as_given(section, drawn.scene.light)
    # What the section gives is in world coordinates.
    origin = WORLD if isinstance(light, shadow.EngineLight) else drawn.scene.origin
    return shadow.engine_code(technique, light, _distances(drawn), origin)


def _as_given(section: scene.Light, light: AbstractLight) -> AbstractLight | shadow.EngineLight:
    """`light`, or the engine's own camera if the section has one: a light's map keeps its middle and its size only."""
    if not isinstance(section, DirectionalLightConfig) or section.shadow_camera is None:
        return light
    assert isinstance(light, DirectionalLight)
    camera, direction = section.shadow_camera, section.direction or np.asarray(light.direction).tolist()
    target = [at + towards for at, towards in zip(camera.position, direction, strict=True)]
    window = {name: getattr(camera, name) for name in ("left", "right", "top", "bottom")}
    return shadow.EngineLight("directional", list(camera.position), camera.near, camera.far, target, window)


def _distances(drawn: Drawn) -> tuple[float, float]:
    """The least and greatest distance of what counts along the light's axis, or a point light's faces' axes."""
    distances = along(drawn.scene.light, drawn.surface.position)[drawn.mask]
    return float(distances.min()), float(distances.max())


def along(light: AbstractLight, points: VectorMap) -> Float32[HostArray, "h w"]:
    """The distance of `points` (h, w, 3) along the light's axis; for a point light, along the axis of the face of its
    map."""
    if isinstance(light, PointLight):
        return np.asarray(abs(points - light.position).max(axis=-1))
    return np.asarray(light.view().distance(points))
