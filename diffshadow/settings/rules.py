"""Rules of thumb: biases for many scenes.

`experiments/rules_of_thumb.py` searched for them in a collection of scenes, tested them on kinds of scenes that the
search left out, and wrote them to `rules.json`. docs/rules_of_thumb.md describes the search and the worth of the rules.
"""

import json
import math
from collections.abc import Mapping
from importlib import resources
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

from . import filters
from .engines import EngineName


class Worth(NamedTuple):
    """The worth of a bias over some scenes.

    - `price`: its error divided by the error of the best bias for the scene; the mean over scenes.
    - `acne`, `leaks`: the shares of scenes where more than a thousandth of the light is missing, or too much.
    """

    price: float
    acne: float
    leaks: float


class Numbers(NamedTuple):
    """A constant bias, a slope bias and a normal offset, in texels."""

    constant: float
    slope: float
    normal_offset: float


class Rule(NamedTuple):
    """A bias for any scene.

    - `own`: its worth in the scenes of its search; `worth`: the worth of rules in kinds of scenes that their search
      left out; `maps`: their price there, by the map's side in texels.
    """

    bias: Numbers
    worth: Worth
    own: Worth
    maps: Mapping[str, float]


class EngineRule(NamedTuple):
    """A bias for an engine's default filter, and the engine's default bias.

    - `constant`, `normal_offset`: biases in texels; the offset has the engine's own profile. If `is_own`, they are the
      engine's own settings, in scenes whose unit is a metre, because the light's cameras follow the view and texels
      have no fixed width.
    - `shipped`: the worth of the engine's default, in scenes whose unit is a metre.
    """

    constant: float
    normal_offset: float
    is_own: bool
    worth: Worth
    shipped: Worth


_FOUND = json.loads(resources.files(__package__).joinpath("rules.json").read_text(encoding="utf-8"))

SCENES: int = _FOUND["scenes"]
"""The number of scenes in the search for rules."""
KINDS: int = _FOUND["kinds"]
"""The kinds of these scenes. Rules were tested on each kind without it."""
MAX_REACH: float = _FOUND["reach"]
"""The reach of the widest measured kernel, in texels from its centre to its rim."""
PART: float = _FOUND["casters"]["part"]
"""The constant bias of a rule is at most this fraction of a typical caster's width, or of the kernel's if that is
wider. A larger bias removes shadows."""
CONSTANT, CONSTANT_PER_TEXEL, SLOPE, SLOPE_PER_TEXEL = map(float, _FOUND["formula"]["numbers"])
"""The bias for any filter, in texels: for no reach, and for each texel of reach."""
FORMULA_WORTH = Worth(*_FOUND["formula"]["worth"])
"""Means over the measured filters."""
PLANE_CONSTANT: float = _FOUND["plane"]["number"]
"""The constant bias in addition to a bias from the receiver's plane, in texels: for no reach, and for each texel of
reach."""
PLANE_WORTH = Worth(*_FOUND["plane"]["worth"])
"""Means over the filters that were measured with such a bias."""
FILTER_RULES = {
    name: Rule(Numbers(*of["bias"]), Worth(*of["worth"]), Worth(*of["own"]), of["maps"])
    for name, of in _FOUND["filters"].items()
}
"""The rules by filter. Filters with a receiver plane also have a constant bias."""
STARTS = {name: Numbers(*bias) for name, bias in _FOUND["starts"].items()}
"""The rule for a disk with a radius of 2 texels, by the names of the numbers that are not 0."""
ENGINE_RULES: dict[EngineName, EngineRule] = {
    name: EngineRule(of["bias"][0], of["bias"][1], of["own"], Worth(*of["worth"]), Worth(*of["shipped"]))
    for name, of in _FOUND["engines"].items()
}
"""The rules by the engines' names on the command line."""
MEASURED = (
    filters.Nearest,
    filters.Bilinear,
    filters.FourTap,
    filters.PercentageCloser,
    filters.Tent,
    filters.Castano,
    filters.RandomDisk,
)
"""Filters that have their own rule, or the rule of a box. Their taps are compared one by one, up to a known reach."""
RULED = (
    *MEASURED,
    filters.VarianceShadowMap,
    filters.ExponentialShadowMap,
    filters.ExponentialVarianceShadowMap,
    filters.MomentShadowMap,
    filters.PercentageCloserSoft,
)
"""All filters that have a rule. Filters that do not compare taps one by one have the same rule for all radii."""
_NONE, _OTHERS = Numbers(0.0, 0.0, 0.0), Numbers(0.5, 0.5, 0.0)
# In texels. Users do not type more digits.
_DIGITS = 2


class Measured(NamedTuple):
    """A measured filter: its name in `FILTER_RULES`, its reach in texels, and its rule."""

    name: str
    reach: float
    rule: Rule


def _measured() -> dict[type[filters.Filter], list[Measured]]:
    """The measurements without a receiver plane, by kind of filter and ascending reach."""
    kinds, found = {each.type: each for each in RULED}, {}
    for name, rule in FILTER_RULES.items():
        label, *sizes = name.split(", ")
        if sizes[1:]:
            continue
        kind = kinds[label]
        radius = {"radius": float(sizes[0].removeprefix("radius "))} if sizes else {}
        reach = kind.reach_of(SimpleNamespace(**radius)) if kind in MEASURED else 0.0
        found.setdefault(kind, []).append(Measured(name, reach, rule))
    # Narrow boxes and disks are a bilinear compare.
    for kind in (filters.PercentageCloser, filters.RandomDisk):
        found[kind] = found[filters.Bilinear] + found[kind]
    return found


_BY_KIND = _measured()


def measured_of(kind: type[Any]) -> list[Measured]:
    """The measurements of a kind of filter, by ascending reach. Empty if there are none. A filter whose taps are
    compared one by one uses the measurements of boxes."""
    others = _BY_KIND[filters.PercentageCloser] if issubclass(kind, MEASURED) else []
    return next((found for each, found in _BY_KIND.items() if issubclass(kind, each)), others)


def bias_of(kind: type[Any], reach: float, *, plane: bool = False, across: float = math.inf) -> Numbers:
    """The bias for a kind of filter that reads the map up to `reach` texels from the receiver. With a `plane`, it is
    the additional bias to a bias from the receiver's plane. With a plane, filters that do not compare taps one by one
    have no other bias.

    It is the filter's own rule if one was measured, and otherwise the rule of a box with the same reach. Between two
    measured reaches, it is interpolated. Beyond the widest, the slope bias grows as in the formula for any filter.

    **Arguments:** `across`: the width of a typical caster in texels, if known. The constant is at most `PART` of this
    width, or of the kernel's width.
    """
    bias = _bias_of(kind, reach, plane=plane)
    return bias._replace(constant=min(bias.constant, round(PART * max(across, 2 * reach), _DIGITS)))


def _bias_of(kind: type[Any], reach: float, *, plane: bool) -> Numbers:
    """`bias_of` for casters of any width."""
    is_measured, own = issubclass(kind, MEASURED), measured_of(kind)
    if plane:
        return Numbers(plane_constant_for(reach), 0.0, 0.0) if is_measured else _NONE
    if not is_measured:
        return own[0].rule.bias if own else _OTHERS
    constant, slope, offset = _interpolated(own, reach)
    slope += SLOPE_PER_TEXEL * max(reach - own[-1].reach, 0.0)
    return Numbers(round(constant, _DIGITS), round(slope, _DIGITS), round(offset, _DIGITS))


def _interpolated(own: list[Measured], reach: float) -> Numbers:
    """The bias at a reach. It is linear between the measured reaches, and constant beyond them."""
    if reach <= own[0].reach:
        return own[0].rule.bias
    for low, high in pairwise(own):
        if reach <= high.reach:
            part = (reach - low.reach) / (high.reach - low.reach)
            return Numbers(*(a + part * (b - a) for a, b in zip(low.rule.bias, high.rule.bias, strict=True)))
    return own[-1].rule.bias


def plane_constant_for(reach: float) -> float:
    """The constant bias in texels, in addition to a bias from the receiver's plane."""
    return round(PLANE_CONSTANT * (1 + reach), _DIGITS)
