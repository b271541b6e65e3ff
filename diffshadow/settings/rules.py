"""Rules of thumb: biases that hold over many scenes.

`experiments/rules_of_thumb.py` searched for them in one half of a collection of scenes, and tested them on the other.
docs/rules_of_thumb.md says how, and what they are worth.
"""

from typing import NamedTuple

from .engines import EngineName


class Worth(NamedTuple):
    """What a bias is worth over the scenes that rules were tested on.

    - `price`: the mean of its error over that of the best bias for each scene.
    - `acne`, `leaks`: the shares of scenes where more than a thousandth of the light is wrongly missing, or there.
    """

    price: float
    acne: float
    leaks: float


class Rule(NamedTuple):
    """A bias for any scene: `constant`, `slope` and `normal_offset` in texels."""

    constant: float
    slope: float
    normal_offset: float
    worth: Worth


class EngineRule(NamedTuple):
    """A bias for an engine's default filter, and what the engine ships.

    - `constant`, `normal_offset`: in texels, the offset with the engine's own profile.
    - `shipped`: what the engine's own default is worth.
    """

    constant: float
    normal_offset: float
    worth: Worth
    shipped: Worth


SCENES = 48
"""The scenes that rules were tested on, other ones than rules were searched for in."""
MAX_REACH = 8.5
"""The widest kernel that was measured: texels from its middle to its rim."""
CONSTANT, SLOPE_PER_TEXEL, NORMAL_OFFSET = 6.5, 0.6, 0.5
"""Of a bias for any filter, in texels. The slope bias grows with the filter's reach."""
FORMULA_WORTH = Worth(1.12, 0.054, 0.074)
"""Means over the filters that were measured."""
PLANE_CONSTANT = 1.3
"""The constant bias beside one from the receiver's plane, in texels: for no reach, and for each texel of it."""


def bias_for(reach: float) -> tuple[float, float, float]:
    """The constant bias, the slope bias and the normal offset in texels, for a filter that reads the map as far as
    `reach` texels from the receiver."""
    return CONSTANT, SLOPE_PER_TEXEL * reach, NORMAL_OFFSET


def plane_constant_for(reach: float) -> float:
    """The constant bias in texels beside a bias from the receiver's plane."""
    return PLANE_CONSTANT * (1 + reach)


FILTER_RULES: dict[str, Rule] = {
    "nearest": Rule(2.0, 0.5, 0.0, Worth(1.06, 0.021, 0.083)),
    "bilinear": Rule(3.0, 0.5, 0.0, Worth(1.1, 0.083, 0.062)),
    "pcf, radius 1.5": Rule(4.5, 1.0, 0.0, Worth(1.12, 0.1, 0.083)),
    "pcf, radius 2.5": Rule(7.0, 1.0, 0.5, Worth(1.1, 0.1, 0.083)),
    "random_disk, radius 2": Rule(3.0, 1.0, 0.5, Worth(1.1, 0.1, 0.042)),
    "random_disk, radius 4": Rule(10.0, 1.0, 1.0, Worth(1.09, 0.083, 0.021)),
    "random_disk, radius 8": Rule(15.0, 1.4, 2.0, Worth(1.08, 0.12, 0.042)),
    "pcf, radius 2.5, with a receiver plane": Rule(4.5, 0.0, 0.0, Worth(1.02, 0.1, 0.021)),
    "random_disk, radius 4, with a receiver plane": Rule(7.0, 0.0, 0.0, Worth(1.02, 0.083, 0)),
    "random_disk, radius 8, with a receiver plane": Rule(12.1, 0.0, 0.0, Worth(1.02, 0.12, 0.042)),
}
"""By filter. Those with a receiver plane have a constant bias beside it."""
ENGINE_RULES: dict[EngineName, EngineRule] = {
    "three.js": EngineRule(0.0, 0.0, Worth(1.02, 0.083, 0.17), Worth(1.02, 0.083, 0.17)),
    "babylon.js": EngineRule(14.7, 0.0, Worth(1.08, 0.31, 0.1), Worth(8.66, 1, 0.042)),
    "godot": EngineRule(9.0, 1.0, Worth(1.08, 0.083, 0.021), Worth(1.63, 0.35, 0.062)),
    "bevy": EngineRule(15.0, 0.5, Worth(1.17, 0.083, 0.062), Worth(1.4, 0.15, 0.021)),
    "filament": EngineRule(1.0, 0.5, Worth(1.04, 0.044, 0), Worth(1.05, 0.067, 0)),
    "unity": EngineRule(1.5, 0.5, Worth(1.03, 0.042, 0), Worth(1.26, 0.021, 0.042)),
}
"""By the names that the command takes. Bevy's and Filament's shipped biases are lengths: their worth is in scenes whose
unit is a metre."""
