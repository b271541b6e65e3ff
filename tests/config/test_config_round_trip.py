"""Configurations written out whole and read again: the shipped ones, and random ones made from the schema."""

import json
import math
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
import pytest

from diffshadow.config import Config, ConfigError, describe, dump_resolved, fit_paths, load_config, parse_config
from diffshadow.config.reading._keys import ROOT, Slot, _inside, slot_of
from diffshadow.config.sections._section import Section, unchecked
from diffshadow.settings import Limits
from diffshadow.settings.scene import PIECES

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
# Sections and keys that name files, or are made below by hand.
BY_HAND = {"name", "output", "sweep", "fit", "meshes", "lights", "reference"}
WANTED = 10


def suits_a_fit(text: str) -> bool:
    try:
        parse_config(text, fitting=True)
    except ConfigError:
        return False
    return True


def assert_survives(config: Config) -> None:
    text = dump_resolved(config)
    again = parse_config(text)
    assert again == config
    assert dump_resolved(again) == text
    assert describe(again) == describe(config)
    assert suits_a_fit(text) == (not list(config.fit_faults()))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_config_survives(path):
    assert_survives(load_config(path, ["sweep=null"], fitting=True))


def test_value_beyond_the_default_bounds_of_a_fit_survives():
    config = parse_config("scene: {meshes: [{path: builtin:box}]}\nbias: {constant: 50}\n")
    assert_survives(config)
    assert suits_a_fit(dump_resolved(config))
    bounds = config.fit.parameters["bias.constant"]
    assert bounds.lower <= 50 <= bounds.upper


def test_render_of_a_fit_s_configuration_with_values_beyond_its_bounds_survives():
    text = "scene: {meshes: [{path: builtin:box}]}\nfit: {parameters: {filter.radius: {lower: 0, upper: 3}}}\n"
    for override in ("filter={type: nearest}", "filter.radius=9"):
        config = parse_config(text, [override])
        assert_survives(config)
        assert not suits_a_fit(dump_resolved(config))


def number(rng: np.random.Generator, limits: Limits, whole: bool) -> Any:
    low, high = limits.low or 0, 1e6 if limits.high is None else limits.high
    spread = [low, high, *(x for x in (0, 1, 0.25, -2, 3, 40) if low < x < high)]
    value = spread[rng.integers(len(spread))] if rng.random() < 0.7 else low + (high - low) * rng.random() ** 9
    inside = min(max(value, math.nextafter(low, high)), math.nextafter(high, low))
    return int(inside) if whole else float(inside if limits.above_low or limits.below_high else value)


def value_of(rng: np.random.Generator, slot: Slot) -> Any:
    """Something that may stand in `slot`; `None` where this does not know."""
    if slot.choices and not slot.variants:
        choices = get_args(slot.kind)
        return choices[rng.integers(len(choices))]
    if slot.kind is bool:
        return bool(rng.random() < 0.5)
    if slot.kind in (int, float):
        return number(rng, Limits.of(slot.marks), slot.kind is int)
    if get_origin(slot.kind) is tuple and Ellipsis not in get_args(slot.kind):
        entries = [_inside(slot, i) for i in range(len(get_args(slot.kind)))]
        return [value_of(rng, entry) for entry in entries if entry is not None]
    return section_of(rng, slot.variants[rng.integers(len(slot.variants))]) if slot.variants else None


def section_of(rng: np.random.Generator, section: type[Section]) -> dict[str, Any]:
    made = {}
    for key, field in section.model_fields.items():
        slot = slot_of(field)
        if key == "type" or (key not in BY_HAND and rng.random() < (0.6 if slot.variants else 0.3)):
            value = value_of(rng, slot)
            made |= {} if value is None else {key: value}
    return made


def random_data(rng: np.random.Generator) -> dict[str, Any]:
    (root,) = ROOT.variants
    data = section_of(rng, root)
    names = rng.choice(PIECES, rng.integers(1, 3), replace=False).tolist()
    scene = data.get("scene", {}) | {"meshes": [{"path": f"builtin:{name}", "scale": 2.5} for name in names]}
    data["scene"] = scene
    if rng.random() < 0.4:
        known = [*fit_paths(unchecked(root, data)), "scene.light.position.x", "scene.meshes.0.translate.y"]
        chosen = rng.choice(known, rng.integers(1, 4), replace=False).tolist()
        bounds = {"lower": 0.1, "upper": 0.9} | ({"initial": 0.5} if rng.random() < 0.7 else {})
        data["fit"] = {"parameters": dict.fromkeys(chosen, bounds)}
    return data


def test_random_configurations_survive():
    valid = 0
    for seed in range(20 * WANTED):
        data = random_data(np.random.default_rng(seed))
        try:
            config = parse_config(json.dumps(data))
        except ConfigError:
            continue
        assert_survives(config)
        valid += 1
        if valid == WANTED:
            return
    pytest.fail(f"only {valid} of the configurations were valid")


def numbers(slot: Slot = ROOT, path: str = "") -> list[tuple[str, Slot]]:
    """Every number of the schema, by its key."""
    if slot.kind in (int, float):
        return [(path, slot)]
    if slot.variants:
        fields = [(key, field) for variant in slot.variants for key, field in variant.model_fields.items()]
        return [found for key, field in fields for found in numbers(slot_of(field), f"{path}.{key}".strip("."))]
    inside = _inside(slot, 0 if get_origin(slot.kind) is tuple else "*") if get_origin(slot.kind) else None
    return [] if inside is None else numbers(inside, f"{path}.*")


# Those that have the limits of the key that they are for.
AS_ANOTHER = {
    *(f"fit.parameters.*.{key}" for key in ("initial", "lower", "upper")),
    *(f"{at}.qmc.axes.*.{key}" for at in ("sweep", "fit.views", "fit.validation") for key in ("lower", "upper")),
    "sweep.seeds.*",
}


def test_every_number_has_one_lower_and_one_upper_limit():
    from annotated_types import Ge, Gt, Le, Lt

    found = dict(numbers())
    assert len(found) > 80
    assert found.keys() >= AS_ANOTHER
    for path, slot in found.items():
        marks = [single for mark in slot.marks for single in (mark if isinstance(mark, Limits) else (mark,))]
        counts = [sum(isinstance(mark, kinds) for mark in marks) for kinds in ((Ge, Gt), (Le, Lt))]
        assert counts == ([0, 0] if path in AS_ANOTHER else [1, 1]), path
