"""Rules of thumb for biases that are not fitted."""

import difflib
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from ...console import print_table
from ...geometry import AbstractLight, DirectionalLight, PointLight, SpotLight
from ...settings import filters, rules
from ...settings.engines import ENGINES, POLYGON_OFFSETS, EngineName
from ...settings.quantities import FARTHEST, MAX_TEXELS
from ...settings.rules import Worth
from ...settings.scene import LightKind
from ...shadow import ENGINE_TECHNIQUES, BabylonJs, LightFrame, engine_settings, light_frame
from ..pages import _table as table
from ..runs._formula_engines import FORMULA_ENGINES, beside, lines_of

_KERNELS: Mapping[str, type[filters.Filter]] = {each.type: each for each in rules.RULED}
# The filter of each engine for which its rule was measured.
_MEASURED: Mapping[EngineName, str] = {
    "three.js": "PCFShadowMap",
    "babylon.js": "FILTER_PCF, QUALITY_HIGH",
    "godot": "Soft Low",
    "bevy": "Gaussian",
    "filament": "PCF",
    "unity": "Soft, Medium",
    "playcanvas": "SHADOW_PCF3_32F",
    "godot_compatibility": "Soft Low",
}
_IN_METRES = "for scenes whose unit is a metre; under a sun, the width of a texel follows the view camera"
_THERE_ONLY = "at other distances, only settings that grow with the distance, like texels, stay valid"
# Other properties of the engines' biases, in the version for which the rules were measured.
_BESIDES: Mapping[EngineName, str] = {
    "three.js": "back faces cast, as by default (material.shadowSide)",
    "playcanvas": "shadowBias also grows with the slope of the caster",
    **{name: f"beside {beside(name)}" for name in POLYGON_OFFSETS},
}


_EXAMPLES: Mapping[LightKind, str] = {
    "directional": "diffshadow defaults --engine godot --map 2048 --window 40 --depth 100",
    "spot": "diffshadow defaults --engine unity --light spot --map 1024 --angle 30 --near 0.5 --depth 20 --distance 6",
    "point": "diffshadow defaults --engine unity --light point --map 512 --near 0.5 --depth 20 --distance 6",
}


class _Usual(NamedTuple):
    """An engine's default map: its side in texels, its width and depth in world units, and the reason for these
    values."""

    size: int
    window: float
    depth: float
    why: str


# The width and depth of a bounding sphere per unit of depth. It bounds the view of a 16 : 9 camera with a vertical
# angle of 50 degrees.
_VIEW = 1.07
_FIRST = "the first cascade, which follows the view camera: here 16 : 9 and 50 degrees high"
_USUAL: Mapping[EngineName, _Usual] = {
    "three.js": _Usual(512, 10.0, 499.5, "a shadow camera of ±5, from 0.5 to 500"),
    "babylon.js": _Usual(1024, 20.0, 20.0, "its camera follows the casters: here 20 units across"),
    "godot": _Usual(2048, 2 * _VIEW * 10, 2 * _VIEW * 10 + 20, f"a quarter of 4096; {_FIRST}, up to a tenth of 100"),
    "bevy": _Usual(2048, 2 * _VIEW * 10, 2 * _VIEW * 10, f"{_FIRST}, up to 10"),
    "filament": _Usual(1024, 2 * _VIEW * 50, 2 * _VIEW * 50, "one cascade for a view that is 50 units deep"),
    "unity": _Usual(1024, 2 * _VIEW * 6, 2 * _VIEW * 6, f"a quarter of 2048; {_FIRST}, up to an eighth of 50"),
    "playcanvas": _Usual(1024, 2 * _VIEW * 40, 2 * _VIEW * 40, "one map for the view camera's view, up to 40"),
    "godot_compatibility": _Usual(2048, 2 * _VIEW * 10, 2 * _VIEW * 10 + 20, f"a quarter of 4096; {_FIRST}, up to 10"),
}

# The options for the map of each kind of light, and their maximum values.
_NEEDED: Mapping[LightKind, Sequence[str]] = {
    "directional": ("map", "window", "depth"),
    "spot": ("map", "angle", "near", "depth", "distance"),
    "point": ("map", "near", "depth", "distance"),
}
_MOST = {"map": MAX_TEXELS, "angle": 89.0}


class LightOptions(NamedTuple):
    """An engine's light and its map.

    - `map`: its side in texels; `window`: the width of a directional light's map, in world units.
    - `depth`: the distance between the map's near and far planes, in world units.
    - `angle`: half the angle of a spot light's cone, in degrees.
    - `near`: the near plane of a spot or point light. `distance`: the distance from the light at which settings are
      valid. Both in world units.
    """

    light: LightKind = "directional"
    map: int | None = None
    window: float | None = None
    depth: float | None = None
    angle: float | None = None
    near: float | None = None
    distance: float | None = None

    @property
    def given(self) -> dict[str, float | None]:
        """All options except the kind of light."""
        return {name: value for name, value in self._asdict().items() if name != "light"}

    def completed(self, engine: EngineName) -> "LightOptions":
        """The options of a directional light, with the engine's values for missing options."""
        if self.light != "directional":
            return self
        usual = _USUAL[engine]
        or_usual = lambda value, usual: usual if value is None else value
        return self._replace(
            map=or_usual(self.map, usual.size),
            window=or_usual(self.window, usual.window),
            depth=or_usual(self.depth, usual.depth),
        )

    def check(self, engine: EngineName) -> None:
        """**Raises** `ValueError` for options that are missing, belong to another light, or are out of range."""
        needed, given, example = _NEEDED[self.light], self.given, _EXAMPLES[self.light]
        missing = [f"--{name}" for name in needed if given[name] is None]
        if missing:
            every = [f"--{name}" for name in needed]
            raise ValueError(
                f"--engine {engine} is given without {' and '.join(missing)}; expected all of "
                f"{', '.join(every[:-1])} and {every[-1]} for a {self.light} light, as in {example}"
            )
        for name, value in given.items():
            if value is None:
                continue
            if name not in needed:
                raise ValueError(
                    f"--{name} is given for a {self.light} light, which does not have this option; leave it out"
                )
            most = _MOST.get(name, FARTHEST)
            if not 0 < value <= most:
                raise ValueError(
                    f"--{name} is {value:g}; expected more than 0 and at most {most:g}; change it, as in {example}"
                )

    def made(self) -> tuple[AbstractLight, float]:
        """The light, and the distance at which settings are valid, in world units."""
        depth, distance = self.depth or 0.0, self.distance or 1.0
        down, origin = (0.0, -1.0, 0.0), (0.0, 0.0, 0.0)
        if self.light == "directional":
            window = self.window or 0.0
            return DirectionalLight(down, origin, (window, window), 0.0, depth), distance
        near = self.near or 0.0
        if self.light == "spot":
            return SpotLight(origin, down, self.angle or 0.0, near, near + depth), distance
        return PointLight(origin, near, near + depth), distance


def print_defaults(
    *,
    console: Console,
    filter: str | None = None,
    radius: float | None = None,
    engine: EngineName | None = None,
    of_map: LightOptions | None = None,
) -> None:
    """Prints biases that work in many scenes, and their error compared with a fit.

    **Arguments:**

    - `filter`, `radius`: a filter's type and its radius in texels. The filter's bias is printed as a part of a
      configuration.
    - `engine`: an engine. Its settings are printed instead, for its default filter.
    - `of_map`: the engine's light and map; by default the engine's directional light.

    **Raises** `ValueError` for a filter without a rule, and for incompatible options.
    """
    of_map = LightOptions() if of_map is None else of_map
    if engine is None:
        _refuse("engine", "the map of an engine", of_map.given)
        if filter is None:
            _refuse("filter", "a filter's", {"radius": radius})
            _print_all(console)
        else:
            _print_filter(filter, radius, console)
        return
    if filter is not None or radius is not None:
        raise ValueError(f"--engine {engine} is given with a filter; expected one of them: its default filter is used")
    whole = of_map.completed(engine)
    whole.check(engine)
    missing = [f"--{name}" for name, value in whole.given.items() if value != of_map.given[name]]
    if missing:
        said = f"{', '.join(missing)}: {ENGINES[engine]}'s own; {_USUAL[engine].why}"
        sizes = f"a map of {whole.map}², {whole.window:.4g} wide and {whole.depth:.4g} deep"
        table.print_lines(console, [f"for {sizes} ({said})"])
    _print_engine(engine, whole, console)


def _refuse(needed: str, of: str, given: Mapping[str, float | None]) -> None:
    names = [f"--{name}" for name, value in given.items() if value is not None]
    if names:
        raise ValueError(f"{names[0]} is given without --{needed}; expected both, because it belongs to {of}")


# --- Filters ---


def _print_all(console: Console) -> None:
    made = Table("filter", "constant", "slope", "normal offset", "price", "acne", "leaks", "own price")
    by_map = Table("price by map", *(f"{side}²" for side in next(iter(rules.FILTER_RULES.values())).maps))
    for name, rule in rules.FILTER_RULES.items():
        numbers = (f"{value:.3g}" for value in rule.bias)
        made.add_row(name, *numbers, *_cells(rule.worth), f"{rule.own.price:.2f}")
        by_map.add_row(name, *(f"{price:.2f}" for price in rule.maps.values()))
    print_table(console, made)
    print_table(console, by_map)
    table.print_lines(
        console,
        [
            "a configuration without a bias uses the rule for its filter; between two radii, rules are interpolated; "
            f"the constant is at most {rules.PART:.0%} of a typical caster's width or of the kernel's width",
            f"for any filter that reaches r texels: constant {rules.CONSTANT:g} + {rules.CONSTANT_PER_TEXEL:g} r, "
            f"slope {rules.SLOPE:g} + {rules.SLOPE_PER_TEXEL:g} r; {_sentence(rules.FORMULA_WORTH)}",
            f"with a bias from the receiver's plane: constant {rules.PLANE_CONSTANT:g} (1 + r); "
            f"{_sentence(rules.PLANE_WORTH)}",
            f"price: the error divided by the error of the best bias for the scene, the mean over {rules.SCENES} "
            "scenes; each rule was tested on kinds of scenes that its search left out; own price: the price in the "
            "scenes of the search; acne, leaks: the share of scenes where more than a thousandth of the light is "
            "missing, or too much",
            "for a filter: diffshadow defaults --filter random_disk --radius 3",
            f"for an engine: {_EXAMPLES['directional']}",
        ],
    )


def _print_filter(name: str, radius: float | None, console: Console) -> None:
    if name not in _KERNELS:
        near = difflib.get_close_matches(name, _KERNELS, n=1)
        mend = f"did you mean {near[0]}?" if near else "fit the others with diffshadow fit"
        raise ValueError(f"--filter is {name}, which has no rule; expected {', '.join(_KERNELS)}; {mend}")
    kind = _KERNELS[name]
    if radius is not None and "radius" not in kind.each():
        raise ValueError(
            f"--radius is given with {name}, which has no radius; expected a filter with a radius; leave it out"
        )
    if radius is not None and not 0 <= radius <= rules.MAX_REACH:
        raise ValueError(
            f"--radius is {radius:g}; expected 0 to {rules.MAX_REACH:g} texels, where the rule was measured; change it"
        )
    reach = kind.reach_of(kind if radius is None else SimpleNamespace(radius=radius))
    bias = rules.bias_of(kind, reach)
    size = f", radius: {radius:g}" if radius is not None else ""
    numbers = ", ".join(f"{key}: {value:.3g}" for key, value in bias._asdict().items() if value or key == "constant")
    lines = [f"filter: {{type: {name}{size}}}", f"bias: {{{numbers}}}  # texels"]
    table.print_code(console, f"for a filter that reaches {reach:g} texels:", "\n".join(lines))
    near = min(rules.measured_of(kind), key=lambda each: abs(each.reach - reach))
    table.print_lines(console, [f"{near.name}: {_sentence(near.rule.worth)}"])
    if reach >= 1 and kind in rules.MEASURED:
        with_plane = f"bias: {{plane: {{type: receiver_plane}}, constant: {rules.plane_constant_for(reach):.3g}}}"
        table.print_code(console, "or, with less error and more work:", with_plane)


# --- Engines ---


def _print_engine(engine: EngineName, of_map: LightOptions, console: Console) -> None:
    rule, size = rules.ENGINE_RULES[engine], of_map.map or 0
    light, distance = of_map.made()
    frame = light_frame(light, (size, size), distance)
    is_exact = engine in ENGINE_TECHNIQUES and of_map.light in ENGINE_TECHNIQUES[engine].settings.kinds
    if is_exact or rule.is_own:
        lines = _exact_lines(engine, frame, size, distance)
    else:
        lines = _formula_lines(engine, light, frame, size, distance)
    title = f"{ENGINES[engine]}, {_MEASURED[engine]}"
    if not rule.is_own:
        title += f": {rule.constant:.3g} texels towards the light"
        title += f", and {rule.normal_offset:.3g} texels along the normal" if rule.normal_offset else ""
    at = "" if light.is_directional else f" at the distance {distance:g}"
    table.print_code(console, f"{title}; a texel is {frame.texel:.4g} world units wide{at}", "\n".join(lines))
    table.print_lines(
        console,
        [
            *([_BESIDES[engine]] if engine in _BESIDES else []),
            *([_IN_METRES] if rule.is_own else []),
            _sentence(rule.worth),
            f"the default of {ENGINES[engine]}: {_sentence(rule.shipped)}",
            *([] if light.is_directional or rule.is_own else [_THERE_ONLY]),
            *([] if is_exact else [f"read from {ENGINES[engine]}'s sources, and not verified against the engine"]),
        ],
    )


# The lines that set an engine's map and filter, for a map with {size} texels per side.
_SET_UP: Mapping[EngineName, Sequence[str]] = {
    "three.js": ("light.shadow.mapSize.set({size}, {size});",),
    "babylon.js": (
        "const generator = new BABYLON.ShadowGenerator({size}, light);",
        "generator.usePercentageCloserFiltering = true;",
    ),
    "bevy": ("commands.entity(camera).insert(ShadowFilteringMethod::Gaussian);",),
    "playcanvas": ("light.shadowResolution = {size};", "light.shadowType = pc.SHADOW_PCF3_32F;"),
    "godot_compatibility": (
        "RenderingServer.directional_soft_shadow_filter_set_quality(RenderingServer.SHADOW_QUALITY_SOFT_LOW)",
    ),
}
_OWNERS: Mapping[EngineName, str] = {"three.js": "light.shadow", "babylon.js": "generator"}


def _exact_lines(engine: EngineName, frame: LightFrame, size: int, distance: float) -> list[str]:
    rule, kind = rules.ENGINE_RULES[engine], ENGINE_TECHNIQUES[engine]
    values = [rule.constant, rule.normal_offset]
    if not rule.is_own:
        technique = BabylonJs(filter="PCF") if engine == "babylon.js" else kind()  # pyright: ignore[reportCallIssue]
        technique = technique.biased(frame, rule.constant * frame.texel, rule.normal_offset * frame.texel, distance)
        values = [float(getattr(technique, key)) + 0.0 for key in kind.settings.biases]
    end = "" if kind.settings.suffix == "gd" else ";"
    named = zip(kind.settings.bias_names, values, strict=True)
    settings = [f"{_OWNERS.get(engine, 'light')}.{name} = {value:.4g}{end}" for name, value in named]
    return [*(line.format(size=size) for line in _SET_UP[engine]), *settings]


def _formula_lines(
    engine: EngineName, light: AbstractLight, frame: LightFrame, size: int, distance: float
) -> list[str]:
    """**Raises** `ValueError` if the engine has no bias for the light."""
    rule, known, resolution = rules.ENGINE_RULES[engine], FORMULA_ENGINES[engine], (size, size)
    found = engine_settings(light, resolution, 1.0, 1.0, distance)
    has = {each.setting for each in found if each.engine == ENGINES[engine] and each.value}
    if known.bias not in has:
        raise ValueError(
            f"{ENGINES[engine]} has no bias for a {frame.kind} light that is known here; expected another light"
        )
    shift = rule.constant * frame.texel
    offset = rule.normal_offset if known.offset in has else 0.0
    chosen = next(each for each in known.filters if each.label == _MEASURED[engine])
    radius = float(chosen.section.get("radius", 0.0))
    return lines_of(engine, chosen, radius, light, resolution, shift, offset, distance)


def _cells(worth: Worth) -> list[str]:
    return [f"{worth.price:.2f}", f"{worth.acne:.0%}", f"{worth.leaks:.0%}"]


def _sentence(worth: Worth) -> str:
    price, acne, leaks = _cells(worth)
    return f"price {price}, acne in {acne} of the scenes, leaks in {leaks}"
