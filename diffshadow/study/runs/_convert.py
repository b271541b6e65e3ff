"""Conversions of a bias and a radius to the settings of engines."""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ...config import Config, ConfigError, Mistake, build_shadow_mapping, dump_resolved, parse_config
from ...geometry import PointLight, Scene
from ...raster import Surface, draw_surface
from ...settings.engines import Engine
from ...shadow import EngineSetting, ShadowMapping, engine_settings, radius_settings, receiver
from ..pages import _table as table
from . import _record as record
from ._engine import along
from ._fit import fit_technique
from ._fitted import FittedRun
from ._progress import Stages
from ._setup import load, visibility_of
from ._views import draw_views

# Bounds and start of an engine's bias in texels, and of its normal bias and radius.
_MAX_BIAS, _MAX_OFFSET, _MAX_RADIUS = 32.0, 4.0, 16.0
_START = 2.0
# The radius of a uniform disk with the same standard deviation, which is half its radius along each axis, as a multiple
# of the filter's own radius: of corners (±r, ±r), a disk, a box and a tent. Other filters have no such radius.
_DISKS = {
    "nearest": 0.0,
    "bilinear": 0.0,
    "four_tap": 2.0,
    "random_disk": 1.0,
    "pcf": 2 / math.sqrt(3),
    "tent": 2 / math.sqrt(6),
}
_SIDES = {"none": "double", "back": "front", "front": "back"}
_CASTING = {"none": "both sides of faces cast", "back": "front faces cast", "front": "back faces cast"}


class _Lit(NamedTuple):
    """One light's key, and what a receiver in the middle of its receivers is: a texel's width in world units and in
    window depth, and the distance along the light's axis."""

    key: tuple[str | int, ...]
    scene: Scene
    texel: float
    depth_per_texel: float
    distance: float


def convert(config: Config, *, console: Console, origin: str = "") -> None:
    """Prints the bias and the filter's radius of `config` in the units of engines, for each of its lights.

    A constant bias and a normal offset are converted by formulas. To a bias that an engine lacks, the shadows of
    three.js and Babylon.js are fitted, over the same views, and their code and errors are printed.

    **Arguments:**

    - `origin`: where the values of `config` come from, as a part of a sentence.

    **Raises** `ConfigError` for a technique or a light that has none of these.
    """
    kind = config.technique.type
    if kind != "shadow_map":
        mend = "a fit prints its code" if isinstance(config.technique, Engine) else "change it"
        what = f"is {kind}; expected shadow_map, whose bias is converted: {mend}"
        raise ConfigError([Mistake(config.origin.place(("technique", "type")), "technique.type", what)])
    with Stages(console) as stages:
        scene = load(config, stages).scene
        technique = build_shadow_mapping(config, fitting=False)
        with stages.stage("drawing"):
            surface = draw_surface(scene.mesh, scene.camera)
            lit = [_lit(config, technique, scene, surface, i) for i in range(len(scene.lights))]
    if origin:
        table.print_lines(console, [f"the values come from {origin}"])
    lacking, excluded = list(_lacking(config)), {}
    for each in lit:
        settings = [] if lacking else _settings(config, each)
        names = {setting.engine for setting in settings}
        excluded |= dict.fromkeys(one.engine for one in _settings(config, each, every=True) if one.engine not in names)
        if settings:
            table.print_settings(console, _title(config, each), settings)
            _print_radius(config, each, console)
    if not lacking:
        table.print_lines(console, [f"valid where {_CASTING[config.shadow_map.cull]} (shadow_map.cull)"])
    if excluded:
        keys = lacking or [f"bias.normal_offset_profile ({config.bias.normal_offset_profile})"]
        table.print_lines(console, [f"{', '.join(excluded)} have no {' and no '.join(keys)}"])
        _convert_by_fits(config, technique, lit, list(excluded), console)


def _lit(config: Config, technique: ShadowMapping, scene: Scene, surface: Surface, index: int) -> _Lit:
    """The light at `index`, and the median over its receivers.

    **Raises** `ConfigError` if it lights nothing that the camera sees, or no engine has it.
    """
    key, one = ("scene", *list(config.scene.each_light)[index]), scene.lit_by(index)
    try:
        shadow_map = technique.prepare(one)
        counted = np.asarray(technique.covered(shadow_map, surface))
        if not counted.any():
            raise ValueError("lights no surface that the camera sees; expected some: move one of them")
        at = receiver(shadow_map, surface)
        median = lambda values: float(np.median(np.asarray(values)[counted]))
        found = _Lit(
            key, one, median(at.texel_size), median(at.depth_per_texel), median(along(one.light, surface.position))
        )
        engine_settings(one.light, technique.map.resolution, 0.0, 0.0, found.distance)
    except ValueError as error:
        raise ConfigError([Mistake(config.origin.place(key), ".".join(map(str, key)), str(error))]) from error
    return found


def _lacking(config: Config) -> Iterator[str]:
    """What the bias of `config` has that no engine has, by the keys that set it."""
    bias, stored = config.bias, config.shadow_map
    if bias.slope or bias.slope_least:
        yield "bias.slope"
    if bias.terms.given:
        yield "bias.terms"
    if bias.plane.type != "none":
        yield f"bias.plane ({bias.plane.type})"
    if any(factor != 1 for factor in bias.factors or ()):
        yield "bias.factors"
    if any(stored.polygon_offset or ()):
        yield "shadow_map.polygon_offset"
    if stored.depth_layer != "nearest":
        yield f"shadow_map.depth_layer ({stored.depth_layer})"


def _shift(config: Config, lit: _Lit) -> float:
    """The constant bias in world units, at the median receiver."""
    texels = config.bias.constant if config.bias.unit == "texels" else config.bias.constant / lit.depth_per_texel
    return texels * lit.texel


def _settings(config: Config, lit: _Lit, *, every: bool = False) -> list[EngineSetting]:
    """The settings of the engines that have such a normal offset, or of `every` engine."""
    profile = None if every else config.bias.normal_offset_profile
    power = 1 if config.bias.unit == "texels" else 2
    shift, offset, size = _shift(config, lit), config.bias.normal_offset, config.shadow_map.resolution
    return engine_settings(lit.scene.light, size, shift, offset, lit.distance, profile=profile, power=power)


def _title(config: Config, lit: _Lit) -> str:
    """What the bias amounts to."""
    where = "" if lit.scene.light.is_directional else f" at the distance {lit.distance:.4g}"
    return (
        f"{'.'.join(map(str, lit.key))}: {_shift(config, lit):.4g} world units towards the light, and "
        f"{config.bias.normal_offset:.4g} texels along the normal; a texel is {lit.texel:.4g} world units wide{where}"
    )


def _print_radius(config: Config, lit: _Lit, console: Console) -> None:
    """Prints the radius of the filter in the units of engines, or why it has none."""
    kind, key = config.filter.type, ".".join(map(str, lit.key))
    if kind not in _DISKS:
        table.print_lines(console, [f"the filter {kind} has no radius that engines have; random_disk, for one, has"])
        return
    radius = _DISKS[kind] * getattr(config.filter, "radius", 0.0)
    title = f"{key}: the filter {kind}, as wide as a disk with a radius of {radius:.4g} texels"
    table.print_settings(console, title, radius_settings(lit.scene.light, radius))


# --- What an engine lacks ---


def _convert_by_fits(
    config: Config, technique: ShadowMapping, lit: list[_Lit], engines: list[str], console: Console
) -> None:
    """Fits the shadows of all `engines` that can be drawn, and prints their errors and their code."""
    fits = {name: overrides for name, overrides in _fits(config, lit).items() if name in engines}
    runs: dict[str, FittedRun] = {}
    with Stages(console) as stages:
        for name, overrides in fits.items():
            settings = parse_config(dump_resolved(config), overrides, source=f"the fit of {name}", fitting=True)
            runs[name] = fit_technique(settings, stages)
        errors = {"this configuration": _errors_of(config, technique, stages)} if runs else {}
    if runs:
        table.print_lines(console, [f"so {' and '.join(runs)} are fitted to the same reference, with their own bias:"])
        table.print_rows(console, errors | {name: run.errors["after"] for name, run in runs.items()})
    for name, run in runs.items():
        for key, code in run.code.items():
            table.print_code(console, f"{name}, for {key}:", code)
        table.print_lines(console, [f"{name}: {remark}" for remark in run.remarks], warn=True)
    left = [name for name in engines if name not in runs]
    if "Babylon.js" in left:
        table.print_lines(console, ["Babylon.js is left out, since its maps are square (shadow_map.resolution)"])
        left.remove("Babylon.js")
    if left:
        mend = "to convert to them, fit bias.constant alone (bias.slope=0 and no plane, terms or normal offset)"
        table.print_lines(console, [f"{', '.join(left)} are left out, since they cannot be drawn here; {mend}"])


def _errors_of(config: Config, technique: ShadowMapping, stages: Stages) -> Mapping[str, float]:
    """The errors of `config` over the views of its fit."""
    views = draw_views(config, load(config, stages), technique, stages)
    drawn = views.drawn[: views.seen]
    return record.combined([record.measured(visibility_of(technique, each), each) for each in drawn], drawn)


def _fits(config: Config, lit: list[_Lit]) -> dict[str, list[str]]:
    """The overrides that fit the shadows of each engine with a map of the same size."""
    common = ["fit.prefer=[]", "fit.intervals=[]", "fit.front=0", "fit.multistart=1"]
    height, width = config.shadow_map.resolution
    made = {"three.js": _three_js(config, lit), **({"Babylon.js": _babylon_js(config, lit)} if height == width else {})}
    return {
        name: [f"technique={json.dumps(technique)}", f"fit.parameters={json.dumps(parameters)}", *common]
        for name, (technique, parameters) in made.items()
    }


def _three_js(config: Config, lit: list[_Lit]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The technique's section, and the parameters of its fit."""
    depth = max(each.depth_per_texel for each in lit)
    radius = min(getattr(config.filter, "radius", 1.0), _MAX_RADIUS)
    technique = {"type": "three.js", "shadow_type": "PCFShadowMap", "shadow_side": _SIDES[config.shadow_map.cull]}
    return technique, {
        "technique.bias": _bounds(-min(_START * depth, 1), -min(_MAX_BIAS * depth, 1), 0),
        "technique.normal_bias": _bounds(0, 0, _MAX_OFFSET * max(each.texel for each in lit)),
        "technique.radius": _bounds(radius, 0, _MAX_RADIUS),
    }


def _babylon_js(config: Config, lit: list[_Lit]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The technique's section, and the parameters of its fit."""
    lights = [each.scene.light for each in lit]
    # The engine draws PCF under a point light with the taps of POISSONSAMPLING.
    is_point = any(isinstance(light, PointLight) for light in lights)
    if is_point:
        views = [light.view() for light in lights]
        ranges = [float(view.near + view.far) for view in views]
        metric = max(each.texel / span for each, span in zip(lit, ranges, strict=True))
    else:
        # Depth from -1 to 1.
        metric = 2 * max(each.depth_per_texel for each in lit)
    technique = {
        "type": "babylon.js",
        "filter": "POISSONSAMPLING" if is_point else "PCF",
        "float_maps": True,
        "back_face_culling": config.shadow_map.cull != "none",
        "force_back_faces_only": config.shadow_map.cull == "front",
    }
    parameters = {
        "technique.bias": _bounds(min(_START * metric, 1), 0, min(_MAX_BIAS * metric, 1)),
        "technique.normal_bias": _bounds(0, 0, _MAX_OFFSET * max(each.texel for each in lit)),
    }
    if is_point:
        parameters["technique.blur_scale"] = _bounds(_START, 0.1, _MAX_RADIUS)
    return technique, parameters


def _bounds(initial: float, lower: float, upper: float) -> dict[str, float]:
    return {"initial": initial, "lower": lower, "upper": upper}
