"""Rules of thumb for biases: what to type where nothing is fitted."""

import difflib
from collections.abc import Mapping
from types import SimpleNamespace
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from ...geometry import DirectionalLight
from ...settings import filters, rules
from ...settings.engines import ENGINES, POLYGON_OFFSETS, EngineName
from ...settings.quantities import FARTHEST, MAX_TEXELS
from ...settings.rules import Worth
from ...shadow import ENGINE_TECHNIQUES, engine_settings
from ..pages import _table as table
from ..runs._formula_engines import FORMULA_ENGINES, beside, lines_of

_KERNELS: Mapping[str, type[filters.Filter]] = {each.type: each for each in rules.MEASURED}
# The filter of each engine that its rule was measured with, as in `FORMULA_ENGINES`.
_MEASURED: Mapping[EngineName, str] = {
    "three.js": "PCFShadowMap",
    "babylon.js": "FILTER_PCF, QUALITY_HIGH",
    "godot": "Soft Low",
    "bevy": "Gaussian",
    "filament": "PCF",
    "unity": "Soft, Medium",
}
# What the engines do beside the bias, and did where the rules were measured.
_BESIDES: Mapping[EngineName, str] = {
    "three.js": "back faces cast, as by default (material.shadowSide)",
    **{name: f"beside {beside(name)}" for name in POLYGON_OFFSETS},
}


_EXAMPLE = "diffshadow defaults --engine godot --map 2048 --window 40 --depth 100"


class _Usual(NamedTuple):
    """What an engine has where nobody sets anything: a map's side in texels, how wide and deep it is in world units,
    and why."""

    size: int
    window: float
    depth: float
    why: str


# The width and depth of the sphere about what a camera sees that is 16 : 9 and 50 degrees high, per unit of depth.
_VIEW = 1.07
_FIRST = "the first cascade, which follows the view camera: here 16 : 9 and 50 degrees high"
_USUAL: Mapping[EngineName, _Usual] = {
    "three.js": _Usual(512, 10.0, 499.5, "a shadow camera of ±5, from 0.5 to 500"),
    "babylon.js": _Usual(1024, 20.0, 20.0, "its camera follows the casters: here 20 units across"),
    "godot": _Usual(2048, 2 * _VIEW * 10, 2 * _VIEW * 10 + 20, f"a quarter of 4096; {_FIRST}, up to a tenth of 100"),
    "bevy": _Usual(2048, 2 * _VIEW * 10, 2 * _VIEW * 10, f"{_FIRST}, up to 10"),
    "filament": _Usual(1024, 2 * _VIEW * 50, 2 * _VIEW * 50, "one cascade for a view that is 50 units deep"),
    "unity": _Usual(1024, 2 * _VIEW * 6, 2 * _VIEW * 6, f"a quarter of 2048; {_FIRST}, up to an eighth of 50"),
    "playcanvas": _Usual(1024, 2 * _VIEW * 40, 2 * _VIEW * 40, "one map for what the view camera sees up to 40"),
    "godot_compatibility": _Usual(2048, 2 * _VIEW * 10, 2 * _VIEW * 10 + 20, f"a quarter of 4096; {_FIRST}, up to 10"),
}


def print_defaults(
    *,
    console: Console,
    filter: str | None = None,
    radius: float | None = None,
    engine: EngineName | None = None,
    size: int | None = None,
    window: float | None = None,
    depth: float | None = None,
) -> None:
    """Prints the biases that hold over many scenes, and what they are worth.

    **Arguments:**

    - `filter`, `radius`: a filter's type and its radius in texels. Its bias is printed as a part of a configuration.
    - `engine`: whose settings are printed instead, for its default filter under a directional light.
    - `size`, `window`, `depth`: of the engine's map: its side in texels, and how wide and deep the light's camera is,
        in world units; by default the engine's own.

    **Raises** `ValueError` for a filter without a rule, and for options that do not go together.
    """
    of_map = {"map": size, "window": window, "depth": depth}
    if engine is None:
        _refuse("engine", "the map of an engine", of_map)
        if filter is None:
            _refuse("filter", "a filter's", {"radius": radius})
            _print_all(console)
        else:
            _print_filter(filter, radius, console)
        return
    if filter is not None or radius is not None:
        raise ValueError(f"--engine {engine} is given with a filter; expected one of them: its default filter is used")
    usual = _USUAL[engine]
    missing = [f"--{name}" for name, value in of_map.items() if value is None]
    size = usual.size if size is None else size
    window = usual.window if window is None else window
    depth = usual.depth if depth is None else depth
    for name, value, most in (("map", size, MAX_TEXELS), ("window", window, FARTHEST), ("depth", depth, FARTHEST)):
        if not 0 < value <= most:
            raise ValueError(
                f"--{name} is {value:g}; expected more than 0 and at most {most:g}; change it, as in {_EXAMPLE}"
            )
    if missing:
        said = f"{', '.join(missing)}: {ENGINES[engine]}'s own; {usual.why}"
        table.print_lines(console, [f"for a map of {size}², {window:.4g} wide and {depth:.4g} deep ({said})"])
    if engine in rules.ENGINE_RULES:
        _print_engine(engine, size, window, depth, console)
    else:
        _print_shipped(engine, window / size, console)


def _print_shipped(engine: EngineName, texel: float, console: Console) -> None:
    """What an engine without a rule has where nobody sets anything."""
    settings = ENGINE_TECHNIQUES[engine].settings
    given = [
        f"{name} = {getattr(settings, key):g}" for key, name in zip(settings.biases, settings.bias_names, strict=True)
    ]
    table.print_lines(
        console,
        [
            f"{ENGINES[engine]} ships {', '.join(given)}; a texel is {texel:.4g} world units wide",
            "no rule has been measured for it",
            f"for a scene of yours: diffshadow advise CONFIG --engine {engine}",
        ],
    )


def _refuse(needed: str, of: str, given: Mapping[str, float | None]) -> None:
    names = [f"--{name}" for name, value in given.items() if value is not None]
    if names:
        raise ValueError(f"{names[0]} is given without --{needed}; expected both, since it is of {of}")


# --- Filters ---


def _print_all(console: Console) -> None:
    made = Table("filter", "constant", "slope", "normal offset", "price", "acne", "leaks")
    for name, rule in rules.FILTER_RULES.items():
        numbers = (f"{value:.3g}" for value in rule.bias)
        made.add_row(name, *numbers, *_cells(rule.worth))
    console.print(made)
    table.print_lines(
        console,
        [
            "without a bias, a configuration has its filter's rule; between two radii, it is interpolated",
            f"for other filters, which reach r texels: constant {rules.CONSTANT:g}, slope {rules.SLOPE_PER_TEXEL:g} r; "
            f"{_sentence(rules.FORMULA_WORTH)}",
            f"with a bias from the receiver's plane: constant {rules.PLANE_CONSTANT:g} (1 + r); "
            f"{_sentence(rules.PLANE_WORTH)}",
            f"price: the mean error over that of the best bias for each of {rules.SCENES} scenes; acne, leaks: the "
            "share of scenes where more than a thousandth of the light is wrongly missing, or there",
            "for a filter: diffshadow defaults --filter random_disk --radius 3",
            f"for an engine: {_EXAMPLE}",
        ],
    )


def _print_filter(name: str, radius: float | None, console: Console) -> None:
    if name not in _KERNELS:
        near = difflib.get_close_matches(name, _KERNELS, n=1)
        mend = f"did you mean {near[0]}?" if near else "fit the others with diffshadow fit"
        raise ValueError(f"--filter is {name}, which has no rule; expected {', '.join(_KERNELS)}; {mend}")
    kind = _KERNELS[name]
    if radius is not None and "radius" not in kind.each():
        raise ValueError(f"--radius is given with {name}, which has none; expected a filter that has one; leave it out")
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
    own = rules.measured_of(kind)
    if own:
        near = min(own, key=lambda each: abs(each.reach - reach))
        worth = f"{near.name}: {_sentence(near.rule.worth)}"
    else:
        worth = f"the formula for any filter: {_sentence(rules.FORMULA_WORTH)}"
    table.print_lines(console, [worth])
    if reach >= 1:
        with_plane = f"bias: {{plane: {{type: receiver_plane}}, constant: {rules.plane_constant_for(reach):.3g}}}"
        table.print_code(console, "or, with less error and more work:", with_plane)


# --- Engines ---


def _print_engine(engine: EngineName, size: int, window: float, depth: float, console: Console) -> None:
    rule, texel = rules.ENGINE_RULES[engine], window / size
    light = DirectionalLight((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), (window, window), 0.0, depth)
    known, offset = FORMULA_ENGINES.get(engine), rule.normal_offset
    if known is None:
        lines = _exact_lines(engine, light, size, rule.constant * texel, offset)
    else:
        chosen = next(each for each in known.filters if each.label == _MEASURED[engine])
        radius = float(chosen.section.get("radius", 0.0))
        lines = lines_of(engine, chosen, radius, light, (size, size), rule.constant * texel, offset, 1.0)
    title = f"{ENGINES[engine]}, {_MEASURED[engine]}: {rule.constant:.3g} texels towards the light"
    if offset:
        title += f", and {offset:.3g} along the normal"
    table.print_code(console, f"{title}; a texel is {texel:.4g} world units wide", "\n".join(lines))
    table.print_lines(
        console,
        [
            *([_BESIDES[engine]] if engine in _BESIDES else []),
            _sentence(rule.worth),
            f"what {ENGINES[engine]} ships: {_sentence(rule.shipped)}",
            *(
                []
                if known is None or engine in ENGINE_TECHNIQUES
                else [f"read from {ENGINES[engine]}'s sources, and not verified against the engine"]
            ),
            f"for a scene of yours: diffshadow advise CONFIG --engine {engine}",
        ],
    )


def _exact_lines(engine: EngineName, light: DirectionalLight, size: int, shift: float, offset: float) -> list[str]:
    found = engine_settings(light, (size, size), shift, offset, 1.0)
    values = {each.setting: each.value for each in found if each.engine == ENGINES[engine] and each.value is not None}
    if engine == "three.js":
        return [
            f"light.shadow.mapSize.set({size}, {size});",
            *(f"{name} = {value + 0.0:.4g};" for name, value in values.items()),
        ]
    return [
        f"const generator = new BABYLON.ShadowGenerator({size}, light);",
        "generator.usePercentageCloserFiltering = true;",
        f"generator.bias = {values['generator.bias (PCF)']:.4g};",
        f"generator.normalBias = {values['generator.normalBias']:.4g};",
    ]


def _cells(worth: Worth) -> list[str]:
    return [f"{worth.price:.2f}", f"{worth.acne:.0%}", f"{worth.leaks:.0%}"]


def _sentence(worth: Worth) -> str:
    price, acne, leaks = _cells(worth)
    return f"price {price}, acne in {acne} of the scenes, leaks in {leaks}"
