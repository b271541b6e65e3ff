"""The numbers and choices of a configuration that an interface can offer, from the schema."""

from typing import Any, NamedTuple, get_origin

from ...settings import Limits
from ..sections._config import Config
from ..sections._fitted import of_technique
from ..sections._scene import LIGHTS
from ..sections._section import Section
from ._keys import Slot, keys_of, slot_of

# The numbers of a mesh that do not change its faces.
_PLACEMENT = ("translate", "rotate", "scale")
# Sides of maps, in texels.
_SIDES = (256, 512, 1024, 2048, 4096)


class Number(NamedTuple):
    """A number of a configuration.

    - `value`, `unit`, `limits`: value, unit and limits of its key.
    - `meaning`: its description; may be empty.
    - `is_fittable`: whether a fit of the technique can find its value.
    """

    value: float
    unit: str
    limits: Limits
    meaning: str
    is_fittable: bool = False


class Choice(NamedTuple):
    """A setting with a fixed set of values, or a whole number.

    - `value`, `options`: value and options of its key. A whole number has `limits` instead of options.
    - `sets`: the key to set; for the key `type` of a section, the whole section.
    - `meaning`: its description; may be empty.
    """

    value: Any
    options: tuple[Any, ...]
    sets: str
    meaning: str
    limits: Limits = Limits()


def numbers_of(config: Config) -> dict[str, Number]:
    """The numbers of technique, lights, meshes, camera and shading that can change without building anything again, by
    dotted key. Entries of lists have an index, as in `scene.meshes.0.translate.1`."""
    found = {}
    for key, light in config.scene.each_light.items():
        found |= _within(light, ".".join(map(str, ("scene", *key))))
    for name, each in of_technique(config).items():
        if each.value is not None:
            found[name] = Number(each.value, each.unit, each.setting.limits, each.setting.meaning, is_fittable=True)
    for i, mesh in enumerate(config.scene.meshes):
        placed = _within(mesh, f"scene.meshes.{i}")
        found |= {name: number for name, number in placed.items() if name.split(".")[3] in _PLACEMENT}
    camera = _within(config.scene.camera, "scene.camera")
    # Its position and direction belong together.
    found |= {name: number for name, number in camera.items() if name.count(".") == 2}
    return found | _within(config.shading, "shading")


def choices_of(config: Config) -> dict[str, Choice]:
    """The choices, switches and whole numbers of technique, map, bias, filter, compare and lights, by dotted key."""
    found = {}
    for key in ("technique", "shadow_map", "filter", "bias", "compare"):
        found |= _choices_within(getattr(config, key), slot_of(Config.model_fields[key]), key)
    for key, light in config.scene.each_light.items():
        found |= _choices_within(light, Slot(type(light), (LIGHTS,)), ".".join(map(str, ("scene", *key))))
    height, width = config.shadow_map.resolution
    sizes = sorted({*((side, side) for side in _SIDES), (height, width)})
    size = "shadow_map.resolution"
    return found | {size: Choice((height, width), tuple(sizes), size, "[height, width] in texels")}


def with_number(config: Config, name: str, value: float) -> Config:
    """`config` with another `value` for one of `numbers_of`. The value is not checked."""
    return config.with_value(name.split("."), value)


def _within(section: Any, path: str) -> dict[str, Number]:
    """The fractional numbers in `section` and in its inner sections."""
    found, units = {}, section.units()
    for key in keys_of(type(section)):
        value, slot, name = getattr(section, key), slot_of(type(section).model_fields[key]), f"{path}.{key}"
        unit = units.get(key, slot.unit)
        if isinstance(value, Section):
            found |= _within(value, name)
        elif slot.kind is float and value is not None:
            found[name] = Number(value, unit, slot.limits, slot.meaning)
        elif get_origin(slot.kind) is tuple:
            for i, each in enumerate(value or ()):
                entry = slot.entry(i)
                if entry.kind is float:
                    found[f"{name}.{i}"] = Number(each, unit, entry.limits, slot.meaning)
    return found


def _choices_within(section: Any, slot: Slot, path: str) -> dict[str, Choice]:
    """The choices in `section`, whose slot is `slot`, and in its inner sections."""
    found = {}
    for key in keys_of(type(section)):
        value, inner = getattr(section, key), slot_of(type(section).model_fields[key])
        name = f"{path}.{key}"
        if isinstance(value, Section):
            found |= _choices_within(value, inner, name)
        elif key == "type":
            found |= {name: Choice(value, slot.choices, path, "")} if len(slot.choices) > 1 else {}
        elif inner.kind is bool or len(inner.choices) > 1:
            found[name] = Choice(value, inner.choices or (False, True), name, inner.meaning)
        elif inner.kind is int and value is not None:
            found[name] = Choice(value, (), name, inner.meaning, inner.limits)
    return found
