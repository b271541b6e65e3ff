"""Conversions of a bias and a radius to the settings of engines."""

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from ...config import (
    Config,
    ConfigError,
    Mistake,
    build_technique,
    dump_resolved,
    parse_config,
)
from ...settings.engines import ENGINES, POLYGON_OFFSETS, Engine, EngineName
from ...settings.filters import Castano
from ...settings.techniques import SingleMap
from ...shadow import (
    ENGINE_TECHNIQUES,
    OFFSET_PROFILES,
    AbstractEngineShadows,
    AbstractTechnique,
    EngineSetting,
    OffsetProfile,
    PlainBias,
    castano_radius,
    engine_code,
    engine_settings,
    radius_settings,
)
from ..pages import _table as table
from ._engine import FACES, SIDES, Lit, engine_fit, lit_by, preset
from ._fit import fit_technique
from ._formula_engines import FORMULA_ENGINES, lines_of
from ._measure import combined, measured
from ._progress import Progress
from ._setup import load, visibility_of
from ._views import draw_views
from ._visibility import FittedRun

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


def convert(
    config: Config,
    *,
    console: Console,
    origin: str = "",
    source: Path | str = "",
    overrides: Sequence[str] = (),
    fits: bool = True,
    engine: EngineName | None = None,
) -> None:
    """Prints the bias and the filter's radius of `config` in the units of engines, for each of its lights.

    The technique is a shadow map, or an engine's own. A constant bias and a normal offset are converted by formulas. If
    an engine lacks the bias, the shadows of three.js and Babylon.js are fitted instead, over the same views, and their
    code and errors are printed. For other engines, the command for such a fit is printed.

    **Arguments:**

    - `origin`: where the values of `config` come from, as a part of a sentence.
    - `source`, `overrides`: the user's arguments: a file or a folder, and values that replace the file's values.
    - `fits`: whether engines that lack the bias are fitted.
    - `engine`: the only engine to convert to. Its finished code is printed instead of a table.

    **Raises** `ConfigError` for a technique or a light without a bias or radius to convert.
    """
    if not isinstance(config.technique, SingleMap | Engine):
        *names, last = ENGINE_TECHNIQUES
        expected = f"expected shadow_map, {', '.join(names)} or {last}, whose biases can be converted: change it"
        what = f"is {config.technique.type}; {expected}"
        raise ConfigError([Mistake(config.origin.place(("technique", "type")), "technique.type", what)])
    technique = build_technique(config, fitting=False)
    with Progress(console) as progress:
        lit = lit_by(config, progress)
    plain = [_plain(config, technique, each) for each in lit]
    if origin:
        table.print_lines(console, [f"the values come from {origin}"])
    lacking = list(_lacking(config))
    if engine is not None:
        _convert_to(engine, config, technique, lit, plain, lacking, console, source, overrides, fits)
        return
    excluded = _print_conversions(config, lit, plain, lacking, console)
    if not lacking:
        table.print_lines(console, [f"valid where {_casting(technique, config)}", _VALID, _BESIDE])
    if excluded:
        of_engine = isinstance(config.technique, Engine)
        key = "technique.normal_bias" if of_engine else "bias.normal_offset_profile"
        keys = lacking or [f"{key} ({plain[0].profile})"]
        table.print_lines(console, [f"{', '.join(excluded)} have no {' and no '.join(keys)}"])
        # Each more takes as long as a fit.
        drawn = [title for title in excluded if title in _FITTED]
        others = [title for title in excluded if title not in _FITTED]
        left = (_convert_by_fits(config, technique, lit, drawn, console) if fits else drawn) + others
        alone = "technique.bias alone, with technique.normal_bias=0" if of_engine else _ALONE
        table.print_lines(console, _instead(left, source, overrides, alone))


def _convert_to(
    engine: EngineName,
    config: Config,
    technique: AbstractTechnique,
    lit: list[Lit],
    plain: list[PlainBias],
    lacking: list[str],
    console: Console,
    source: Path | str,
    overrides: Sequence[str],
    fits: bool,
) -> None:
    """Prints finished code for one engine: with the same shift and offset, or fitted if it has no such bias."""
    title = ENGINES[engine]
    has = [_profile_of(engine, config, each) for each in lit]
    others = [each for each, profile in zip(plain, has, strict=True) if each.offset and each.profile != profile]
    reasons = lacking or [f"a normal offset with the profile {each.profile}" for each in others[:1]]
    if not reasons:
        try:
            codes = {
                each.key: _code_for(engine, config, technique, each, bias)
                for each, bias in zip(lit, plain, strict=True)
            }
        except ValueError as error:
            reasons = [str(error)]
        else:
            for key, code in codes.items():
                table.print_code(console, f"{title}, for {'.'.join(map(str, key))}:", code)
            table.print_lines(console, [f"valid where {_casting(technique, config)}", _VALID])
            return
    table.print_lines(console, [f"{title} does not have what this configuration has: {', '.join(reasons)}"])
    left = _convert_by_fits(config, technique, lit, [title], console) if fits else [title]
    table.print_lines(console, _instead(left, source, overrides, _ALONE))


def _profile_of(engine: EngineName, config: Config, lit: Lit) -> OffsetProfile:
    """How the engine's normal offset grows with the angle to the light."""
    if not _is_drawn(engine, lit):
        return OFFSET_PROFILES[ENGINES[engine]]
    there = preset(engine, config)
    return there.plain(there.frame(lit.scene, lit.distance), lit.distance).profile


def _is_drawn(engine: EngineName, lit: Lit) -> bool:
    """Whether the engine's shadows of this light are drawn here."""
    return engine in ENGINE_TECHNIQUES and lit.kind in ENGINE_TECHNIQUES[engine].settings.kinds


def _code_for(engine: EngineName, config: Config, technique: AbstractTechnique, lit: Lit, plain: PlainBias) -> str:
    """Code that gives an engine the shift, the offset and the filter's width of `plain`.

    **Raises** `ValueError` if it has no such bias.
    """
    size, radius = config.shadow_map.resolution, plain.radius or 0.0
    own = lit.texel
    if isinstance(technique, AbstractEngineShadows):
        own = technique.frame(lit.scene, lit.distance).texel
    if not _is_drawn(engine, lit):
        return _formula_code(engine, lit, size, plain, radius)
    there = preset(engine, config)
    frame = there.frame(lit.scene, lit.distance)
    there = there.as_wide(radius * own / frame.texel, frame)
    made = there.biased(frame, plain.shift, plain.offset * own, lit.distance)
    return engine_code(made, lit.scene.light, (lit.distance, lit.distance), lit.scene.origin)


def _formula_code(engine: EngineName, lit: Lit, size: tuple[int, int], plain: PlainBias, radius: float) -> str:
    """The code of an engine that is not drawn here, with that of its filters which is nearly as wide."""
    every = FORMULA_ENGINES[engine].filters
    sized = [each for each in every if each.is_sized]
    nearest = min(every, key=lambda each: abs(_width(each.section) - radius))
    chosen = sized[0] if sized and radius else nearest
    width = radius if chosen.is_sized else float(chosen.section.get("radius", 0.0))
    lines = lines_of(engine, chosen, width, lit.scene.light, size, plain.shift, plain.offset, lit.distance)
    comment = FORMULA_ENGINES[engine].comment
    said = f"{comment} {ENGINES[engine]}, {chosen.label}. Read from its sources, and not verified against the engine."
    return "\n".join([said, *lines, ""])


def _width(section: Mapping[str, Any]) -> float:
    """The radius of a disk that is as wide as a filter of this library, texels."""
    if section["type"] == "castano":
        return castano_radius(section["size"])
    return _DISKS[section["type"]] * section.get("radius", 0.0)


# The engines that are fitted without being asked for.
_FITTED = ("three.js", "Babylon.js")
_VALID = "valid for this light's map; with another window, size, near or far, convert again"
_BESIDE = (
    f"{' and '.join(ENGINES[name] for name in POLYGON_OFFSETS)} also draw their maps with a polygon offset, so a "
    "smaller bias may do there: fit it with diffshadow advise --engine"
)
_ALONE = "bias.constant alone, without slope, plane, terms and normal offset"


def _print_conversions(
    config: Config, lit: Sequence[Lit], plain: Sequence[PlainBias], lacking: Sequence[str], console: Console
) -> list[str]:
    """Prints the settings of the engines that have such a bias, none if one is `lacking`. **Returns** the others."""
    excluded: dict[str, None] = {}
    for each, bias in zip(lit, plain, strict=True):
        settings = [] if lacking else _settings(config, each, bias)
        names = {setting.engine for setting in settings}
        every = _settings(config, each, bias, every=True)
        excluded |= dict.fromkeys(one.engine for one in every if one.engine not in names)
        if settings:
            table.print_settings(console, _title(each, bias), settings)
            _print_radius(config, each, bias, console)
    return list(excluded)


def _plain(config: Config, technique: AbstractTechnique, lit: Lit) -> PlainBias:
    """The bias and the filter's width at the median receiver."""
    if isinstance(technique, AbstractEngineShadows):
        return technique.plain(technique.frame(lit.scene, lit.distance), lit.distance)
    bias, is_texels = config.bias, config.bias.unit == "texels"
    shift = (bias.constant if is_texels else bias.constant / lit.depth_per_texel) * lit.texel
    return PlainBias(
        shift, 1 if is_texels else 2, bias.normal_offset, 1, bias.normal_offset_profile, _radius_of(config)
    )


def _radius_of(config: Config) -> float | None:
    """The radius of a disk that is as wide as the filter."""
    kind = config.filter.type
    if isinstance(config.filter, Castano):
        return castano_radius(config.filter.size)
    return _DISKS[kind] * getattr(config.filter, "radius", 0.0) if kind in _DISKS else None


def _lacking(config: Config) -> Iterator[str]:
    """What the bias of `config` has that no engine has, by the keys that set it."""
    if isinstance(config.technique, Engine):
        return
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


def _settings(config: Config, lit: Lit, plain: PlainBias, *, every: bool = False) -> list[EngineSetting]:
    """The settings of the engines that have such a normal offset, or of `every` engine."""
    return engine_settings(
        lit.scene.light,
        config.shadow_map.resolution,
        plain.shift,
        plain.offset,
        lit.distance,
        profile=None if every else plain.profile,
        power=plain.power,
        offset_power=plain.offset_power,
    )


def _title(lit: Lit, plain: PlainBias) -> str:
    """What the bias amounts to."""
    where = "" if lit.scene.light.is_directional else f" at the distance {lit.distance:.4g}"
    return (
        f"{'.'.join(map(str, lit.key))}: {plain.shift:.4g} world units towards the light, and "
        f"{plain.offset:.4g} texels along the normal; a texel is {lit.texel:.4g} world units wide{where}"
    )


def _print_radius(config: Config, lit: Lit, plain: PlainBias, console: Console) -> None:
    """Prints the radius of the filter in the units of engines, or why it has none."""
    technique, key = config.technique, ".".join(map(str, lit.key))
    of_engine = getattr(technique, "shadow_type", getattr(technique, "filter", ""))
    kind = of_engine if isinstance(technique, Engine) else config.filter.type
    if plain.radius is None:
        table.print_lines(console, [f"the filter {kind} has no radius that engines have; random_disk, for one, has"])
        return
    title = f"{key}: the filter {kind}, as wide as a disk with a radius of {plain.radius:.4g} texels"
    table.print_settings(console, title, radius_settings(lit.scene.light, plain.radius))


def _casting(technique: AbstractTechnique, config: Config) -> str:
    """Which faces have to cast in the other engine, too."""
    if isinstance(config.technique, Engine):
        scene = load(config, Progress.quiet()).scene
        sides = {side for side in technique.casting_sides(scene) if side is not None}
        if len(sides) == 1:
            return f"{FACES[sides.pop()]}, as in {config.technique.type}"
        return f"the faces of each mesh cast that do so in {config.technique.type}"
    return f"{FACES[SIDES[config.shadow_map.cull]]} (shadow_map.cull)"


# --- What an engine lacks ---


def _convert_by_fits(
    config: Config, technique: AbstractTechnique, lit: list[Lit], engines: list[str], console: Console
) -> list[str]:
    """Fits the shadows of all `engines` that can be drawn, and prints their errors and their code. **Returns** the
    engines that are left."""
    fits = _fits(config, lit, engines)
    runs: dict[str, FittedRun] = {}
    with Progress(console) as progress:
        for name, overrides in fits.items():
            settings = parse_config(dump_resolved(config), overrides, source=f"the fit of {name}", fitting=True)
            runs[name] = fit_technique(settings, progress)
        errors = {"this configuration": _errors_of(config, technique, progress)} if runs else {}
    if runs:
        are, their = ("is", "its") if len(runs) == 1 else ("are", "their")
        said = f"so {' and '.join(runs)} {are} fitted to the same reference, with {their} own bias:"
        table.print_lines(console, [said])
        table.print_rows(console, errors | {name: run.errors["after"] for name, run in runs.items()})
    for name, run in runs.items():
        for key, code in run.code.items():
            table.print_code(console, f"{name}, for {key}:", code)
        table.print_lines(console, [f"{name}: {remark}" for remark in run.remarks], warn=True)
    left = [name for name in engines if name not in runs]
    if "Babylon.js" in left:
        table.print_lines(console, ["Babylon.js is left out, since its maps are square (shadow_map.resolution)"])
        left.remove("Babylon.js")
    return left


def _instead(left: Sequence[str], source: Path | str, overrides: Sequence[str], alone: str) -> list[str]:
    """What to do for the engines that are `left`; `alone` is what all engines have."""
    if not left:
        return []
    names = {title: name for name, title in ENGINES.items()}
    commands = [
        f"  {shlex.join(['diffshadow', 'advise', str(source or 'CONFIG'), *overrides, '--engine', names[title]])}"
        for title in left
    ]
    return [
        f"{', '.join(left)} are left out, since they cannot be drawn here; to fit a bias that one of them has:",
        *commands,
        f"or fit {alone}, and convert that",
    ]


def _errors_of(config: Config, technique: AbstractTechnique, progress: Progress) -> Mapping[str, float]:
    """The errors of `config` over the views of its fit."""
    views = draw_views(config, load(config, progress), technique, progress)
    drawn = views.drawn[: views.seen]
    return combined([measured(visibility_of(technique, each), each) for each in drawn], drawn)


def _fits(config: Config, lit: list[Lit], titles: Sequence[str]) -> dict[str, list[str]]:
    """The overrides that fit the shadows of those engines with a map of the same size."""
    common = ["fit.prefer=[]", "fit.intervals=[]", "fit.front=0", "fit.multistart=1"]
    height, width = config.shadow_map.resolution
    kinds = {each.kind for each in lit}
    made = {
        ENGINES[name]: engine_fit(name, config, lit)
        for name, each in ENGINE_TECHNIQUES.items()
        if ENGINES[name] in titles
        and (height == width or not each.settings.has_square_maps)
        and kinds.issubset(each.settings.kinds)
    }
    return {
        name: [
            f"technique={json.dumps(each.technique)}",
            f"fit.parameters={json.dumps(_named(each.parameters))}",
            *common,
        ]
        for name, each in made.items()
    }


def _named(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {f"technique.{name}": bounds for name, bounds in parameters.items()}
