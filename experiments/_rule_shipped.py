"""Errors of the shadows that engines draw by default, and of other biases for the same shadows, in one scene."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import _common as common
import _rule_errors as errors
import numpy as np

from diffshadow import shadow
from diffshadow.settings.engines import POLYGON_OFFSETS


class Exact(NamedTuple):
    """An engine that is reproduced to the pixel.

    - `technique`: the engine at its defaults; `reach`: of its filter, as in `Filtered`.
    - `has_offset`: whether the normal offset is tried; one that moves casters needs a map for each value.
    - `most`: the greatest value of both biases.
    """

    technique: shadow.AbstractEngineShadows
    reach: float
    has_offset: bool = True
    most: float = np.inf

    @property
    def shipped(self) -> tuple[float, float]:
        """What the engine sets its two biases to."""
        return self.values_of(self.technique)

    def values_of(self, technique: shadow.AbstractEngineShadows) -> tuple[float, float]:
        """The two biases of a technique of this engine."""
        constant, offset = technique.settings.biases
        return float(getattr(technique, constant)), float(getattr(technique, offset))


class Formula(NamedTuple):
    """An engine whose biases are known as formulas, and whose shadow map is ours.

    - `filter`, `reach`: as in `Filtered`.
    - `engine`: its name in `engine_settings`; `constant`, `offset`: its settings of the two biases, and `shipped` what
      the engine sets them to.
    - `softness`: as for `engine_settings`.
    """

    filter: shadow.AbstractFilter
    reach: float
    engine: str
    constant: str
    offset: str
    shipped: tuple[float, float]
    softness: float = 1.0


_LOW = shadow.GODOT_QUALITIES["SOFT_LOW"]
EXACT: dict[str, Exact] = {
    "three.js": Exact(shadow.ThreeJs(), 2.5),
    "babylon.js": Exact(shadow.BabylonJs(filter="PCF"), 2.5, has_offset=False),
    "playcanvas": Exact(shadow.PlayCanvas(), 1.5, most=1.0),
    "bevy": Exact(shadow.Bevy(), 2.5),
    "godot_compatibility": Exact(shadow.GodotCompatibility(), 1.5, most=16.0),
}
FORMULAS: dict[str, Formula] = {
    "godot": Formula(
        shadow.RandomDisk(_LOW.radius, shadow.vogel(_LOW.taps)),
        _LOW.radius + 0.5,
        "Godot 4",
        "shadow_bias",
        "shadow_normal_bias",
        (0.1, 2.0),
        _LOW.radius,
    ),
    "filament": Formula(shadow.Castano(3), 1.5, "Filament", "constantBias", "normalBias", (0.001, 1.0)),
    "unity": Formula(
        shadow.Tent(2.5), 2.5, "Unity URP", "shadowBias (depth)", "shadowNormalBias", (1.0, 1.0), softness=2.5
    ),
}
# Depth biases that are no shift, in the engine's own unit.
_PARTS = (0.0, 0.025, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0)
ENGINES: dict[str, Exact | Formula] = {**EXACT, **FORMULAS}
"""Engines, by the names that the command takes."""


def measure(settings: Any) -> dict[str, np.ndarray]:
    """Errors of all biases of each engine in one scene, as `_rule_errors.measure` finds them for filters.

    Biases are in the order of `grid_of`. `shipped NAME` is (3,), the errors of what an engine draws by default; `units
    NAME` is (2,), its two settings for biases of one texel each. An engine that lacks the light is left out.
    """
    case = common.draw(settings)
    plain, shadow_map, covered = errors.plain_map(case)
    pixels = errors.pixels_per_texel(plain, shadow_map, case)
    at = shadow.receiver(shadow_map, case.surface)
    found: dict[str, np.ndarray] = {"scene": errors.described(case, at, covered, pixels)}
    for name, engine in ENGINES.items():
        if isinstance(engine, Exact):
            found |= _of_exact(name, engine, case, at, pixels)
        else:
            found |= _of_formula(name, engine, case, shadow_map, at, covered, pixels)
    return {name: np.asarray(values, np.float32) for name, values in found.items()}


def grid_of(name: str) -> np.ndarray:
    """The biases that are tried, (n, 3): constant, slope and normal offset."""
    engine = ENGINES[name]
    constants: Sequence[float] = errors.CONSTANT
    offsets: Sequence[float] = errors.OFFSET
    if isinstance(engine, Exact):
        constants = _PARTS if isinstance(engine.technique, shadow.PlayCanvas) else constants
        offsets = offsets if engine.has_offset else (0.0,)
    return np.array([(c, 0.0, n) for c in constants for n in offsets], np.float32)


def follows_view(name: str) -> bool:
    """Whether the cameras of the engine's directional lights follow the view, so that no width of a texel holds."""
    engine = ENGINES[name]
    return isinstance(engine, Exact) and engine.technique.settings.follows_view


# --- Engines that are reproduced ---


class Drawable(NamedTuple):
    """An engine in one scene.

    - `technique`: at the engine's defaults, with the scene's map; `units`: its two settings for one texel each.
    - `state`: what the defaults have drawn; `seen`: the pixels that count.
    """

    technique: shadow.AbstractEngineShadows
    units: tuple[float, float]
    state: Any
    seen: errors.Seen


def drawable(engine: Exact, case: common.Case, at: shadow.Receiver, pixels: float) -> Drawable | None:
    """None if the engine lacks the light. For the arguments see `_of_exact`."""
    technique = dataclasses.replace(engine.technique, resolution=case.settings.shadow_map.resolution)
    kind = case.settings.scene.light.type
    if kind not in technique.settings.kinds:
        return None
    distance = median_distance(case)
    frame = technique.frame(case.scene, distance)
    # The polygon offset of PlayCanvas is no length.
    has_shift = not isinstance(technique, shadow.PlayCanvas)
    shift = frame.texel if has_shift else 0.0
    constant, offset = engine.values_of(technique.biased(frame, shift, frame.texel, distance))
    state = technique.prepare(case.scene, case.surface)
    covered = np.asarray(technique.covered(state, case.surface)) & case.truth.mask
    # How much wider the texels of the engine's first camera are than the texels of the scene's light.
    wider = frame.texel / max(float(np.median(np.asarray(at.texel_size)[case.surface.mask])), 1e-30)
    seen = errors.seen_by(case.truth, covered, engine.reach * pixels * wider)
    return Drawable(technique, (constant if has_shift else 1.0, offset), state, seen)


def with_biases(technique: shadow.AbstractEngineShadows, values: Sequence[float]) -> shadow.AbstractEngineShadows:
    """A technique with values of its two biases."""
    numbers = dict(zip(technique.settings.biases, map(np.float32, values), strict=True))
    return dataclasses.replace(technique, **numbers)


def _of_exact(name: str, engine: Exact, case: common.Case, at: shadow.Receiver, pixels: float) -> dict[str, np.ndarray]:
    """What an engine draws by default, and with each bias.

    **Arguments:**

    - `at`: the receivers in the plain map of the scene; `pixels`: how long its texels are on the screen.
    """
    made = drawable(engine, case, at, pixels)
    if made is None:
        return {}
    paths, units = made.technique.settings.biases, np.array(made.units)
    tried = np.minimum(grid_of(name)[:, [0, 2]] * units, engine.most)
    values = np.concatenate([tried, [engine.shipped]])
    if made.technique.lays_out(paths[0]):
        # Biases that draw other maps come one by one.
        found = np.empty((len(values), 3))
        for constant in np.unique(values[:, 0]):
            rows = values[:, 0] == constant
            technique = with_biases(made.technique, (constant, 0.0))
            state = technique.prepare(case.scene, case.surface)
            found[rows] = errors.grid_errors(technique, values[rows, 1:], state, case.surface, made.seen, paths[1:])
    else:
        count = 2 if engine.has_offset else 1
        found = errors.grid_errors(
            made.technique, values[:, :count], made.state, case.surface, made.seen, paths[:count]
        )
    return {name: found[:-1], f"shipped {name}": found[-1], f"units {name}": units}


def median_distance(case: common.Case) -> float:
    """How far the median receiver is from the light along its axis, in world units."""
    mask, light = np.asarray(case.surface.mask), case.scene.light
    away = np.asarray(case.surface.position)[mask] - np.asarray(getattr(light, "position", np.zeros(3)))
    direction = getattr(light, "direction", None)
    along = np.abs(away).max(axis=1) if direction is None else away @ np.asarray(direction)
    return max(float(np.median(along)), 1e-9)


# --- Engines that are known as formulas ---


def _of_formula(
    name: str,
    engine: Formula,
    case: common.Case,
    shadow_map: shadow.ShadowMap,
    at: shadow.Receiver,
    covered: np.ndarray,
    pixels: float,
) -> dict[str, np.ndarray]:
    units = _units(engine, case, at)
    if units is None:
        return {}
    own = [value / unit if unit else 0.0 for value, unit in zip(engine.shipped, units, strict=True)]
    technique = errors.technique(engine.filter, profile=shadow.OFFSET_PROFILES[engine.engine])
    if name in POLYGON_OFFSETS:
        settings = shadow.MapSettings(case.settings.shadow_map.resolution, polygon_offset=POLYGON_OFFSETS[name])
        shadow_map = dataclasses.replace(technique, map=settings).prepare(case.scene, case.surface)
    both = np.concatenate([grid_of(name), [[own[0], 0.0, own[1]]]])
    seen = errors.seen_by(case.truth, covered, engine.reach * pixels)
    found = errors.grid_errors(technique, both, shadow_map, case.surface, seen)
    return {name: found[:-1], f"shipped {name}": found[-1], f"units {name}": np.array(units)}


def _units(engine: Formula, case: common.Case, at: shadow.Receiver) -> tuple[float, float] | None:
    """An engine's two settings for a bias and a normal offset of one texel at the median receiver."""
    light, resolution = case.scene.light, case.settings.shadow_map.resolution
    texel = float(np.median(np.asarray(at.texel_size)[np.asarray(case.surface.mask)]))
    softness = engine.softness if light.is_directional or engine.engine != "Godot 4" else 1.0
    try:
        settings = shadow.engine_settings(
            light, resolution, texel, 1.0, median_distance(case), power=1, softness=softness
        )
    except ValueError:
        return None
    values = {each.setting: each.value for each in settings if each.engine == engine.engine}
    if values.get(engine.constant) is None:
        return None
    return float(values[engine.constant] or 0.0), float(values.get(engine.offset) or 0.0)
