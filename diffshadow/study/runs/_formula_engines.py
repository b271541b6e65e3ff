"""Engines whose shadows are fitted as shadow maps and converted by formulas: Godot, Bevy, Filament and Unity.

Their filters are those of this library with the same kernels, as read from the engines' sources. Nothing here is
verified against the engines.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ...config import LABEL, Config
from ...geometry import AbstractLight, PointLight
from ...settings.engines import ENGINES, POLYGON_OFFSETS, EngineName
from ...settings.rules import ENGINE_RULES
from ...shadow import GODOT_QUALITIES, OFFSET_PROFILES, LightFrame, engine_settings, light_frame
from ._engine import FACES, SIDES, Lit

# Where fits start without a rule, in texels.
_START = 2.0
_MOST = {"constant": 30.0, "normal_offset": 4.0}
# Godot divides its bias by the radius.
_RADII = (0.25, 16.0)
_PARAMETERS = "parameters"


class Filter(NamedTuple):
    """A filter of an engine.

    - `label`: the engine's name of the filter; `section`: the same filter in this library.
    - `softness`: as in `engine_settings`; `None` if it is the fitted radius.
    - `code`: what chooses it.
    """

    label: str
    section: Mapping[str, Any]
    softness: float | None
    code: str

    @property
    def is_sized(self) -> bool:
        """Whether the engine has a setting for its radius."""
        return "radius" in self.section and self.softness is None


class Engine(NamedTuple):
    """An engine.

    - `filters`: the engine's filters; `bias`, `offset`: its names of a constant bias and of a normal offset.
    - `suffix`: suffix of a file in its language; `comment`: how a comment begins there.
    - `write`: makes its code from the values by name, the filter, the radius, the map's size and the light's kind.
    """

    filters: tuple[Filter, ...]
    bias: str
    offset: str
    suffix: str
    comment: str
    write: Callable[[Mapping[str, float], Filter, float, int, str], list[str]]


def _godot(values: Mapping[str, float], chosen: Filter, radius: float, size: int, kind: str) -> list[str]:
    of = "directional" if kind == "directional" else "positional"
    atlas = (
        f"RenderingServer.directional_shadow_atlas_set_size({size}, false)"
        if of == "directional"
        else f"get_viewport().positional_shadow_atlas_size = {2 * size}  # a quadrant for each of four lights"
    )
    quality = GODOT_QUALITIES.get(chosen.code)
    blur = 1.0 if quality is None else radius / quality.radius
    return [
        "light.shadow_enabled = true",
        *(f"light.{name} = {_number(value)}" for name, value in values.items()),
        f"light.shadow_blur = {_number(blur)}",
        f"RenderingServer.{of}_soft_shadow_filter_set_quality(RenderingServer.SHADOW_QUALITY_{chosen.code})",
        atlas,
    ]


def _bevy(values: Mapping[str, float], chosen: Filter, radius: float, size: int, kind: str) -> list[str]:
    # Spot lights share the maps of directional ones.
    resource = "PointLightShadowMap" if kind == "point" else "DirectionalLightShadowMap"
    return [
        *(f"light.{name} = {_number(value)};" for name, value in values.items()),
        f"commands.insert_resource({resource} {{ size: {size} }});",
        f"commands.entity(camera).insert(ShadowFilteringMethod::{chosen.code});",
    ]


def _filament(values: Mapping[str, float], chosen: Filter, radius: float, size: int, kind: str) -> list[str]:
    return [
        "LightManager::ShadowOptions options = lightManager.getShadowOptions(light);",
        f"options.mapSize = {size};",
        *(f"options.{name} = {_number(value)}f;" for name, value in values.items()),
        "lightManager.setShadowOptions(light, options);",
        f"view->setShadowType(View::ShadowType::{chosen.code});",
    ]


def _unity(values: Mapping[str, float], chosen: Filter, radius: float, size: int, kind: str) -> list[str]:
    is_hard = chosen.code == "Hard"
    quality = [] if is_hard else [f"data.softShadowQuality = SoftShadowQuality.{chosen.code};"]
    return [
        "var data = light.GetUniversalAdditionalLightData();",
        "data.usePipelineSettings = false;",
        f"light.shadows = LightShadows.{'Hard' if is_hard else 'Soft'};",
        *(f"light.{name.split(' ')[0]} = {_number(value)}f;" for name, value in values.items()),
        *quality,
        f"// Shadow resolution in the pipeline asset: {size}",
    ]


_BILINEAR = {"type": "bilinear"}
FORMULA_ENGINES: dict[EngineName, Engine] = {
    "godot": Engine(
        (
            Filter("Hard", _BILINEAR, 1.0, "HARD"),
            *(
                Filter(
                    name.replace("_", " ").title(),
                    {
                        "type": "random_disk",
                        "pattern": "vogel",
                        "samples": GODOT_QUALITIES[name].taps,
                        "radius": GODOT_QUALITIES[name].radius,
                    },
                    None,
                    name,
                )
                for name in ("SOFT_LOW", "SOFT_HIGH")
            ),
        ),
        "shadow_bias",
        "shadow_normal_bias",
        "gd",
        "#",
        _godot,
    ),
    "bevy": Engine(
        (
            Filter("Hardware2x2", _BILINEAR, 1.0, "Hardware2x2"),
            Filter("Gaussian", {"type": "castano", "size": 5}, 1.0, "Gaussian"),
        ),
        "shadow_depth_bias",
        "shadow_normal_bias",
        "rs",
        "//",
        _bevy,
    ),
    "filament": Engine(
        (Filter("PCF", {"type": "castano", "size": 3}, 1.0, "PCF"),),
        "constantBias",
        "normalBias",
        "cpp",
        "//",
        _filament,
    ),
    "unity": Engine(
        (
            Filter("Hard", _BILINEAR, 1.0, "Hard"),
            Filter("Soft, Low", {"type": "four_tap", "radius": 0.5}, 1.5, "Low"),
            Filter("Soft, Medium", {"type": "tent", "radius": 2.5}, 2.5, "Medium"),
            Filter("Soft, High", {"type": "tent", "radius": 3.5}, 3.5, "High"),
        ),
        "shadowBias (depth)",
        "shadowNormalBias",
        "cs",
        "//",
        _unity,
    ),
}
"""The engines, by the names that the command takes."""


def offered(name: EngineName, lit: list[Lit], size: tuple[int, int]) -> dict[str, list[dict[str, Any]]]:
    """The lists of the section `advise` for an engine: its filters, and the biases that it has under all lights `lit`.
    Their maps have at least `size` (height, width) texels.

    **Raises** `ValueError` if the engine has no shadows of one of the lights.
    """
    engine, biases = FORMULA_ENGINES[name], []
    has = set.intersection(*(_names(name, each, size) for each in lit))
    if engine.bias not in has:
        raise ValueError(
            f"{ENGINES[name]} has no bias for one of the lights that is known here; expected another light"
        )
    label = lambda setting: setting.split(" ")[0]
    choices = {
        (engine.bias,): ("constant",),
        (engine.offset,): ("normal_offset",),
        (engine.bias, engine.offset): ("constant", "normal_offset"),
    }
    for settings, fitted in choices.items():
        if has.issuperset(settings):
            biases.append(_bias(" + ".join(map(label, settings)), name, *fitted))
    radii = {"filter.radius": {"lower": _RADII[0], "upper": min(_RADII[1], _widest(lit, size))}}
    filters = [
        {
            LABEL: each.label,
            "filter": dict(each.section),
            **({_PARAMETERS: radii} if each.is_sized else {}),
        }
        for each in engine.filters
    ]
    return {"biases": biases, "filters": filters}


def _widest(lit: list[Lit], size: tuple[int, int]) -> float:
    """The greatest radius with which taps stay on the faces of point lights' maps, for any of the offsets."""
    lights = [each.scene.light for each in lit]
    margins = [light.guard_texels(size) for light in lights if isinstance(light, PointLight)]
    # Taps are bilinear.
    return max(min(margins, default=math.inf) - _MOST["normal_offset"] - 0.5, 1.0)


def _bias(label: str, name: EngineName, *fitted: str) -> dict[str, Any]:
    rule = ENGINE_RULES[name]
    starts = {key: (_START if rule.is_own else getattr(rule, key)) if key in fitted else 0.0 for key in _MOST}
    return {
        LABEL: label,
        "bias": {**starts, "slope": 0.0, "normal_offset_profile": OFFSET_PROFILES[ENGINES[name]]},
        "compare": {"type": "hard"},
        "shadow_map.polygon_offset": POLYGON_OFFSETS.get(name),
        "shadow_map.depth_layer": "nearest",
        "shadow_map.silhouettes": None,
        _PARAMETERS: {f"bias.{key}": {"lower": 0.0, "upper": _MOST[key]} for key in fitted},
    }


def _names(name: EngineName, lit: Lit, size: tuple[int, int]) -> set[str]:
    """The settings of the engine that have an effect under a light."""
    found = engine_settings(lit.scene.light, size, 1.0, 1.0, lit.distance)
    return {each.setting for each in found if each.engine == ENGINES[name] and each.value}


def code_of_formula(name: EngineName, config: Config, filter_label: str, lit: Lit) -> str:
    """The code that sets the values of `config` for one light, with comments on where the values are valid."""
    engine, light = FORMULA_ENGINES[name], lit.scene.light
    chosen = next(each for each in engine.filters if each.label == filter_label)
    height, width = config.shadow_map.resolution
    frame = light_frame(light, (height, width), lit.distance)
    radius, shift = float(getattr(config.filter, "radius", 0.0)), config.bias.constant * lit.texel
    lines = lines_of(name, chosen, radius, light, (height, width), shift, config.bias.normal_offset, lit.distance)
    comments = [f"{engine.comment} {line}" for line in _where(name, config, frame, lit)]
    return "\n".join([*comments, *lines, ""])


def lines_of(
    name: EngineName,
    chosen: Filter,
    radius: float,
    light: AbstractLight,
    resolution: tuple[int, int],
    shift: float,
    offset: float,
    distance: float,
) -> list[str]:
    """The lines of code that set a bias.

    **Arguments:**

    - `chosen`, `radius`: the engine's filter, and its radius in texels; 0 if it has none.
    - `resolution`, `shift`, `offset`, `distance`: as for `engine_settings`, where `shift` is the bias.
    """
    kind = light_frame(light, resolution, distance).kind
    # Godot divides the bias of its suns only.
    softness = radius if chosen.softness is None else chosen.softness
    softness = 1.0 if name == "godot" and kind != "directional" else softness
    found = engine_settings(light, resolution, shift, offset, distance, power=1, softness=softness)
    values = {each.setting: each.value for each in found if each.engine == ENGINES[name] and each.value is not None}
    return FORMULA_ENGINES[name].write(values, chosen, radius, max(resolution), kind)


def _where(name: EngineName, config: Config, frame: LightFrame, lit: Lit) -> list[str]:
    """Where the values are valid."""
    at = "" if frame.kind == "directional" else f" at the distance {lit.distance:.4g}"
    lines = [
        f"{ENGINES[name]}. Read from its sources, and not verified against the engine.",
        f"Valid where {FACES[SIDES[config.shadow_map.cull]]}.",
        f"Valid where a texel of the map is {frame.texel:.4g} world units wide{at}: a bias in texels grows with it.",
    ]
    if name in POLYGON_OFFSETS:
        lines += [f"Valid beside {beside(name)}."]
    if name == "godot" and frame.kind == "directional":
        depth = frame.far - frame.near
        lines += [f"Valid for a depth range of {depth:.4g}: for another, multiply shadow_bias by {depth:.4g} / range."]
    if frame.kind != "directional":
        lines += ["At other distances, only settings that grow with the distance, as texels do, stay valid."]
    return lines


def beside(name: EngineName) -> str:
    """The polygon offset that an engine draws its maps with, in words."""
    slope, constant = POLYGON_OFFSETS[name]
    return f"the polygon offset that {ENGINES[name]} draws its maps with: constant {constant:g}, slope {slope:g}"


def _number(value: float) -> str:
    text = f"{value + 0.0:.5g}"
    return text if any(each in text for each in ".e") else f"{text}.0"
