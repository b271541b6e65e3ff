"""Every key of a configuration arrives in the field of the same meaning, and in no other."""

import dataclasses
import functools
import json
from collections.abc import Callable, Iterator
from typing import Any, get_args, get_origin

import numpy as np
import pytest

from diffshadow.config import build_fit, build_scene, build_shading, build_technique, parse_config
from diffshadow.config.reading._keys import Slot, slot_of
from diffshadow.config.sections._fit import AnnealConfig, FitConfig, LossConfig, SolverConfig
from diffshadow.config.sections._images import SHADINGS, AttenuationConfig
from diffshadow.config.sections._scene import CAMERAS, LIGHTS, MeshConfig
from diffshadow.config.sections._section import Section
from diffshadow.config.sections._technique import (
    COMPARES,
    FILTERS,
    PLANES,
    TECHNIQUES,
    BiasConfig,
    ShadowMapConfig,
    TermsConfig,
)
from diffshadow.settings.engines import Engine
from diffshadow.settings.techniques import FittedLayout, Mapped
from diffshadow.shading import Colour

# What makes a section without its other keys valid, and cheap to build.
BASE: dict[str, Any] = {
    "scene": {
        "meshes": [{"path": "builtin:box"}, {"path": "builtin:plane"}, {"path": "builtin:sphere", "casts": False}],
        "camera": {"resolution": [8, 8]},
    },
    "filter": {"type": "random_disk", "samples": 4, "pattern_size": 1},
}
WITH: dict[str, dict[str, Any]] = {
    "random_disk": BASE["filter"],
    "pcss": {"samples": 4, "search_samples": 4, "pattern_size": 1},
    "pinhole": {"eye": [0, 1, 4], "target": [0, 0, 0], "near": 1.0, "far": 9.0},
    "orthographic": {"eye": [0, 1, 4], "target": [0, 0, 0], "near": 1.0, "far": 9.0, "height": 3.0},
    "spot": {"position": [0, 4, 1], "outer_angle": 40.0, "near": 1.0, "far": 9.0},
    "rectangle": {"position": [0, 4, 1], "outer_angle": 40.0, "near": 1.0, "far": 9.0},
    "point": {"position": [0, 4, 1], "near": 1.0, "far": 9.0},
    "directional": {"direction": [0, -1, 0]},
    "cascades": {"margin": 2.0, "max_blend": 1.0},
    "perspective_warp": {"margin": 2.0},
    "resolution_matched": {"margin": 2.0},
    "bias.terms": {"one": 0.25},
    "bias": {"constant": 0.5, "slope": 0.25},
}
# Keys that place or choose things, and numbers that several fields follow from; other tests are about these.
OF_SEVERAL = {
    *("antialias", "orbit", "azimuth", "elevation", "direction", "frame", "shadow_camera", "target", "position"),
    *("pattern", "samples", "pattern_size", "rotated", "search_samples"),
    *(
        "path",
        "receives",
        "options",
        "size",
        "drop_to_ground",
        "translate",
        "rotate",
        "scale",
        "crease_angle",
        "normals",
        "texture",
        "alpha_cutoff",
        "texture_wrap",
        "texture_filter",
    ),
    *("factors", "terms", "network", "plane", "attenuation", "distances", "shares"),
    *(
        "parameters",
        "solver",
        "anneal",
        "shape",
        "views",
        "validation",
        "loss",
        "prefer",
        "blurs",
        "points",
        "multistart",
    ),
}
# Values that their neighbours allow.
FITTING: dict[str, Any] = {
    "page": 32,
    "finest": 1024,
    "resolution": [24, 24],
    "inner_angle": 12.5,
    "outer_angle": 41.0,
    "slope_least": 0.125,
    "slope_most": 3.25,
    "margin": 4.5,
    "near": 1.125,
    "far": 9.5,
    "start": 1.75,
    "end": 0.0625,
    "front": 5,
    "up": [0.0, 0.5, 1.0],
    "casts": False,
    "eye": [0.5, 1.0, 4.0],
    "intensities": [[0.5, 0.25, 0.125]],
}
# What is derived from other fields.
FOLLOWS = ("max_radius", "max_blur", "max_share", "count", "view", "target")


def sections() -> Iterator[tuple[str, type[Section]]]:
    """Each section from which a module is built, by the dotted key of where it stands."""
    for where, variants in (
        *(("filter", FILTERS), ("bias.plane", PLANES), ("compare", COMPARES), ("technique", TECHNIQUES)),
        *(("scene.camera", CAMERAS), ("scene.light", LIGHTS), ("shading", SHADINGS)),
    ):
        yield from ((where, section) for section in variants.sections.values())
    yield from (("bias", BiasConfig), ("bias.terms", TermsConfig), ("shadow_map", ShadowMapConfig))
    yield from (("shading.attenuation", AttenuationConfig), ("scene.meshes.0", MeshConfig))
    yield from (("fit", FitConfig), ("fit.solver", SolverConfig), ("fit.anneal", AnnealConfig))
    yield "fit.loss", LossConfig


def cases() -> Iterator[Any]:
    for where, section in sections():
        for key, field in section.model_fields.items():
            if key not in OF_SEVERAL and (key != "type" or section is SolverConfig):
                kind = section.model_fields["type"].default if "type" in section.model_fields else ""
                yield pytest.param(where, section, slot_of(field), key, id=f"{where}-{kind}-{key}")


def another(slot: Slot, key: str, number: int) -> Any:
    """A value of a key that is not its default, and that no other key has."""
    if FITTING.get(key) is not None:
        return FITTING[key]
    if slot.choices:
        return next(choice for choice in slot.choices[::-1] if choice != slot.default)
    if slot.kind is bool:
        return not slot.default
    if get_origin(slot.kind) is tuple:
        entries = get_args(slot.kind)
        return [0.1 + 0.01 * i for i in range(2 if entries[-1] is Ellipsis else len(entries))]
    if slot.alternatives:
        return "back" if key.endswith("side") else False
    limits = slot.limits
    if slot.kind is int:
        return min(limits.low + 2 + number % 5, limits.high) if slot.default != limits.low + 2 + number % 5 else 3
    return min(max(limits.low, 0) + 0.0101 * (number + 1), limits.high)


def data_with(where: str, section: type[Section], **values: Any) -> dict[str, Any]:
    data = json.loads(json.dumps(BASE))
    holder: Any = data
    *outer, last = where.split(".")
    for step in outer:
        holder = holder[int(step)] if step.isdigit() else holder.setdefault(step, {})
    kind = section.model_fields["type"].default if "type" in section.model_fields else None
    typed = {} if kind is None or section is SolverConfig else {"type": kind}
    own = {**typed, **WITH.get(str(kind) if kind in WITH else where, {}), **values}
    if last.isdigit():
        holder[int(last)] |= own
    else:
        holder[last] = holder.get(last, {}) | own if last not in ("filter", "light", "camera") else own
        if last == "camera":
            holder[last] = {"resolution": [8, 8], **own}
    if where == "technique" and issubclass(section, FittedLayout):
        data["filter"] = {"type": "nearest"}
    return data


def built(where: str, section: type[Section], data: dict[str, Any]) -> Any:
    """The module that `section` describes."""
    config = parse_config(json.dumps(data), fitting=where.startswith("fit"))
    of: dict[str, Callable[[], Any]] = {
        "filter": lambda: build_technique(config).filter,
        "bias": lambda: build_technique(config).bias,
        "bias.plane": lambda: build_technique(config).bias.plane,
        "bias.terms": lambda: build_technique(config).bias.terms.weights,
        "compare": lambda: build_technique(config).compare,
        "shadow_map": lambda: build_technique(config).map,
        "scene.camera": lambda: build_scene(config).camera,
        "scene.light": lambda: build_scene(config).light,
        "shading": lambda: build_shading(config),
        "shading.attenuation": lambda: build_shading(config).attenuation,
        "fit": lambda: vars(build_fit(config).search) | vars(build_fit(config).sureness),
        "fit.solver": lambda: build_fit(config).solver,
        "fit.anneal": lambda: build_fit(config).anneal,
        "fit.loss": lambda: build_fit(config).loss,
    }
    if where == "technique":
        technique = build_technique(config)
        return technique if issubclass(section, Engine) or not issubclass(section, Mapped) else technique.layout
    if where == "scene.meshes.0":
        scene = build_scene(config)
        return {"albedo": scene.meshes[0].albedo[0], "casts": scene.casts[0], "receives": scene.receives[0]}
    return of[where]()


def numbers_of(module: Any, path: str = "") -> dict[str, Any]:
    """Each number and choice in a module, by its dotted path."""
    if isinstance(module, Colour):
        return {path: np.asarray(module)}
    if dataclasses.is_dataclass(module):
        inner = {field.name: getattr(module, field.name) for field in dataclasses.fields(module)}
    elif isinstance(module, dict) or hasattr(module, "_asdict"):
        inner = module if isinstance(module, dict) else module._asdict()
    elif isinstance(module, list):
        inner = dict(enumerate(module))
    else:
        return {path: module}
    return {name: value for key, each in inner.items() for name, value in numbers_of(each, f"{path}.{key}").items()}


def is_same(a: Any, b: Any) -> bool:
    if a is None or b is None or isinstance(a, str | bool):
        return a is b or a == b
    return np.shape(a) == np.shape(b) and bool(np.allclose(np.asarray(a, float), np.asarray(b, float), rtol=1e-6))


@functools.cache
def numbers_before(where: str, section: type) -> dict[str, Any]:
    return numbers_of(built(where, section, data_with(where, section)))


@pytest.mark.parametrize(("where", "section", "slot", "key"), [*cases()])
def test_a_key_arrives_in_its_field_and_in_no_other(where, section, slot, key):
    value = another(slot, key, list(section.model_fields).index(key))
    before = numbers_before(where, section)
    after = numbers_of(built(where, section, data_with(where, section, **{key: value})))
    paths = slot.paths(key) or (key,)
    # A shadow that multiplies the image keeps its shading without shadow as `lit`.
    expected = {f".{path}" for path in paths} | {f".lit.{path}" for path in paths}
    changed = {path for path in after if path not in before or not is_same(after[path], before[path])}
    assert {path for path in changed if path.rpartition(".")[2] not in FOLLOWS or path in expected} <= expected
    arrived = [after[path] for path in changed & expected]
    assert arrived
    given = tuple(value) if isinstance(value, list) else value
    assert all(is_same(each, given) for each in arrived), (arrived, given)


def test_every_key_that_stands_for_one_field_is_tested():
    keys = {key for _, section in sections() for key in section.model_fields} - {"type"}
    assert keys > OF_SEVERAL
    assert len(keys - OF_SEVERAL) > 75
