"""A configuration that is built once. Its numbers and its camera can then change without compilation."""

import dataclasses
import difflib
import json
import math
from collections.abc import Mapping
from functools import reduce
from typing import Any

import numpy as np

from .. import fit, shadow
from .._arithmetic import as_float
from ..config import (
    REFERENCES,
    BuiltMeshes,
    Config,
    ConfigError,
    build_camera,
    build_lights,
    build_meshes,
    build_technique,
    changed,
    dump_resolved,
    fit_paths,
    frozen,
    is_key,
    parse_config,
    preferences,
    printable,
    with_number,
)
from ._controls import Picker, Slider, pickers_of, sliders_of
from ._state import Camera, State

FULL_PIXELS = 512 * 512
"""The maximum number of pixels of a picture. Larger images are scaled down at the same aspect."""
# Decimal digits of computed positions and angles.
_DIGITS = 7


class Subject:
    """A configuration as a page shows it.

    Numbers may change within `ranges`, by key. Sliders may end before that.

    - `box`: the minimum and the maximum corner of all meshes, in world units. `middle` and `radius`: the centre and the
      radius of the first mesh, which orbiting lights use.
    - `config`: the configuration, with numbers for its camera and lights that controls can change.
    - `technique`: the technique. Its numbers may have any value that their sliders allow.
    - `laid_out`: the names of the technique's numbers that change its map.
    - `follows_camera`: whether the map is laid out for the camera.
    - `map_key`, `key`: the keys of its maps and of its visibility, which differ between subjects.
    - `how`: the arguments of `reference.trace_visibility`.
    - `full_size`: (height, width) of its largest pictures, in pixels.
    """

    def __init__(self, config: Config, ranges: Mapping[str, tuple[float, float]] | None = None):
        built = build_meshes(config)
        config = _by_numbers(config, built)
        points, origin = built.surroundings.points, np.asarray(built.surroundings.origin, np.float64)
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.box = (points.min(axis=0) + origin).tolist(), (points.max(axis=0) + origin).tolist()
        self.middle = (built.surroundings.middle + origin).tolist()
        self.radius = built.surroundings.radius
        self.sliders: dict[str, Slider] = sliders_of(config, self.size)
        for key, (low, high) in (ranges or {}).items():
            if key in self.sliders:
                self.sliders[key] = self.sliders[key].reaching(low, high)
        self.pickers: list[Picker] = pickers_of(config)
        self.config = config
        self.technique: Any = _for_all(config, self.sliders)
        paths = fit_paths(config) if isinstance(self.technique, shadow.FittableTechnique) else {}
        # Other techniques have no bias and no filter.
        self.sliders = {key: each for key, each in self.sliders.items() if not each.is_fittable or key in paths}
        self._paths = {name: path for name, path in paths.items() if name in self.sliders}
        self.laid_out = [name for name, path in self._paths.items() if self.technique.lays_out(path)]
        layout = getattr(self.technique, "layout", None)
        self.follows_camera = layout is not None and not isinstance(layout, shadow.SingleMap)
        self.map_key = frozen((config.technique, config.shadow_map, getattr(layout, "margin", None)))
        self.key = frozen((config.technique, config.shadow_map, config.bias, config.filter, config.compare))
        # Pages compare with traced rays, even if the configuration names a stored reference.
        section: Any = config.reference if config.reference.type == "traced" else REFERENCES.make()
        self.how: dict[str, Any] = section.how(config.seed)
        self.full_size = at_most(config.scene.camera.resolution, FULL_PIXELS)

    def at(self, state: State) -> Config:
        """The configuration with the numbers and the camera of `state`. The numbers are not checked, and unknown
        numbers are ignored."""
        config = self.config
        for name, value in state.numbers.items():
            slider = self.sliders.get(name)
            if slider is not None:
                config = with_number(config, name, min(max(value, slider.low), slider.high))
        return config if state.camera is None else _seen_from(config, state.camera)

    def numbers_of(self, config: Config) -> dict[str, float]:
        """The technique's numbers in `config`, which `at` returned."""
        return {name: float(value_at(config, name)) for name in self._paths}

    def technique_with(self, numbers: dict[str, float]) -> Any:
        """The technique with these numbers. `numbers` has all of its numbers."""
        values = as_float(list(numbers.values()))
        return fit.with_values(self.technique, list(self._paths.values()), values)

    @property
    def fitted(self) -> list[str]:
        """The names of the numbers that a fit changes by default: the fitted numbers of the configuration, or all
        numbers that can be fitted."""
        named = [name for name in self.config.fit.parameters if name in self._paths or name.startswith("scene.")]
        return named or list(self._paths)

    def misfits(self, state: State) -> list[str]:
        """The errors in the numbers of `state`, one sentence each. `at` ignores unknown numbers and clips the others to
        their sliders. Numbers of another technique, filter or light are not errors, because pages keep them while such
        a choice changes."""
        found = []
        for name in dict.fromkeys([*state.numbers, *(state.fitted or ())]):
            if not self._has(name) and not is_key(name):
                near = difflib.get_close_matches(name, self.sliders, 1, 0) or ["a visible one"]
                found.append(
                    f"{printable(name)} is not a number of this configuration; expected a number with a slider; remove "
                    f"it, or name another, such as {near[0]}"
                )
        for name, value in state.numbers.items():
            slider = self.sliders.get(name)
            if slider is not None and not slider.holds(value):
                unit = f", in {slider.unit}" if slider.unit else ""
                found.append(
                    f"{name} is {value:g}; expected a number from {slider.low:g} to {slider.high:g}{unit}; change it"
                )
        return found

    def saved(self, state: State, *, fitting: bool = False) -> Config:
        """The valid configuration of `state`, and a fit from there if `fitting`. A render of it draws the page's
        picture. If no number is chosen, it cannot be fitted.

        **Raises** `ConfigError` if it is not valid, and `ValueError` if no number is chosen for a fit.
        """
        config, overrides = self.at(state), []
        names = self.fitted if state.fitted is None else [name for name in state.fitted if self._has(name)]
        if fitting and not names and self._paths:
            raise ValueError(
                "nothing is chosen to be fitted; expected at least one number whose box is checked; check the box "
                f"beside a number, such as {next(iter(self._paths))}, and press Fit again"
            )
        parameters = {name: self._bounds(config, name) for name in names}
        if parameters or state.fitted is not None:
            fitted = changed(config.fit, parameters=parameters)
            # Preferences between other numbers have no meaning.
            kept = [each for each in fitted.prefer if {*preferences(changed(fitted, prefer=(each,)))} & {*parameters}]
            overrides = [f"fit.parameters={json.dumps(parameters)}", f"fit.prefer={json.dumps(kept)}"]
        # The margins of its maps match the margins of the page's maps.
        whole = changed(config, technique=_wide(config, self.sliders).technique)
        return parse_config(dump_resolved(whole), overrides, source="the page's settings", fitting=fitting)

    def _has(self, name: str) -> bool:
        of_scene = name.startswith("scene.") and name in self.config.fit.parameters
        return name in self.sliders or of_scene

    def _bounds(self, config: Config, name: str) -> dict[str, float]:
        """The bounds of a fit of the number `name`. A number of the technique starts at its current value."""
        given = config.fit.parameters.get(name)
        if given is not None:
            kept = {"lower", "upper"} if name in self._paths else {"lower", "upper", "initial"}
            return given.model_dump(include=kept, exclude_none=True)
        slider = self.sliders[name]
        return {"lower": slider.low, "upper": slider.high}


def at_most(size: tuple[int, int], pixels: int) -> tuple[int, int]:
    """`size`, reduced to at most `most` pixels at about the same aspect."""
    height, width = size
    factor = min(1.0, math.sqrt(pixels / (height * width)))
    return max(1, int(height * factor)), max(1, int(width * factor))


def _by_numbers(config: Config, built: BuiltMeshes) -> Config:
    """`config` with the camera as a point, and directional lights as angles."""
    camera = build_camera(config, built)
    eye, target = (
        tuple((np.asarray(point, np.float64) + built.surroundings.origin).round(_DIGITS).tolist())
        for point in (camera.eye, camera.target)
    )
    height = getattr(camera, "height", None)
    config = _seen_from(config, Camera(eye=eye, target=target, height=None if height is None else float(height)))
    for key, light in zip(config.scene.each_light, build_lights(config, built), strict=True):
        section = config.scene.each_light[key]
        if getattr(section, "direction", None) is not None:
            pose: Any = light.pose()
            angles = {name: round(float(getattr(pose, name)), _DIGITS) for name in ("azimuth", "elevation")}
            config = _with_light(config, key, changed(section, **angles, direction=None))
    return config


def _with_light(config: Config, key: Any, section: Any) -> Config:
    lights = config.scene.each_light | {key: section}
    several = config.scene.lights is not None
    scene = changed(config.scene, **({"lights": tuple(lights.values())} if several else {"light": section}))
    return changed(config, scene=scene)


def _seen_from(config: Config, camera: Camera) -> Config:
    section = config.scene.camera
    values: dict[str, Any] = {"orbit": None, "eye": camera.eye, "target": camera.target}
    if hasattr(section, "height"):
        values["height"] = camera.height
    return changed(config, scene=changed(config.scene, camera=changed(section, **values)))


def _for_all(config: Config, sliders: dict[str, Slider]) -> Any:
    """The technique of `config`. Its numbers may have any value that their sliders allow."""
    try:
        return build_technique(_wide(config, sliders), fitting=True)
    except ConfigError:
        # The configuration's own margin is too narrow for the range of the sliders.
        return build_technique(config, fitting=True)


def _wide(config: Config, sliders: dict[str, Slider]) -> Config:
    """`config` with a fit of all numbers of its technique, and maps with room for their ranges."""
    # The bounds are not checked, because a fit may allow less.
    bounds = {
        name: _Bounds(slider.low, slider.high, slider.value) for name, slider in sliders.items() if slider.is_fittable
    }
    return changed(config, fit=changed(config.fit, parameters=bounds)).with_layout_of_fit()


@dataclasses.dataclass(frozen=True)
class _Bounds:
    lower: float
    upper: float
    initial: float


def value_at(config: Config, key: str) -> Any:
    """The value of an existing dotted key."""
    step = lambda holder, word: holder[int(word)] if isinstance(holder, tuple) else getattr(holder, word)
    return reduce(step, key.split("."), config)
