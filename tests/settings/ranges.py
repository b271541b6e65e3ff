"""Prints, as JSON, where modules take what their settings do not allow, or refuse what they allow; and what the
expressions of its argument give, a list as JSON, or their errors.

It runs in a process of its own: tests check the types of arguments, and users do not.
"""

import inspect
import json
import sys
from collections.abc import Iterator
from typing import Any, get_args

import numpy as np

from diffshadow import fit, geometry, raster, reference, shading, shadow
from diffshadow.settings import Setting, Settings

PUBLIC = (geometry, raster, shadow, shading, fit, reference)
# What must be given to make a module.
POSE = {"eye": (0.0, 1.0, 3.0), "target": (0.0, 0.0, 0.0)}
PLACE = {"position": (0.0, 3.0, 0.0), "near": 0.5, "far": 9.0}
AIMED = {**PLACE, "direction": (0.0, -1.0, 0.0), "outer_angle": 30.0}
BOX = {"direction": (0.0, -1.0, 0.0), "center": (0.0, 0.0, 0.0), "extent": (2.0, 2.0), "near": 0.0, "far": 3.0}
EXAMPLES: dict[Any, dict[str, Any]] = {
    geometry.PinholeCamera: POSE,
    geometry.OrthographicCamera: POSE,
    geometry.MatrixCamera: {"world_to_eye": np.eye(4), "eye_to_clip": np.diag([1.0, 1.0, -0.1, 1.0])},
    geometry.PointLight: PLACE,
    geometry.SpotLight: AIMED,
    geometry.RectangleLight: {**AIMED, "size": (0.5, 0.5)},
    geometry.DirectionalLight: BOX,
    shadow.ConstantBias: {"value": 1.0},
    shadow.SlopeBias: {"value": 1.0},
    shadow.NormalOffset: {"value": 1.0},
}
# Where another field limits it further.
TOGETHER = {
    "ResolutionMatched": ("page", "finest", "margin"),
    "PercentageCloserSoft": ("min_radius", "max_radius"),
    "SlopeBias": ("least", "most"),
    "Cascades": ("blend", "max_blend"),
    "SpotLight": ("inner_angle",),
    "Anneal": ("start", "end"),
}


def described() -> list[Any]:
    """Every public class with fields that settings describe."""
    found = {each for package in PUBLIC for each in vars(package).values() if inspect.isclass(each)}
    return sorted((each for each in found if fields_of(each)), key=lambda each: each.__name__)


def fields_of(module: Any) -> dict[str, Setting]:
    """The setting of each field of a class of modules."""
    settings, part = getattr(module, "settings", None), getattr(module, "part", "")
    if not (inspect.isclass(settings) and issubclass(settings, Settings)):
        return {}
    paths = {path: each for key, each in settings.each().items() for path in each.paths(key)}
    return {path.rpartition(".")[2]: each for path, each in paths.items() if path.rpartition(".")[0] == part}


def beyond(setting: Setting, rng: np.random.Generator) -> Iterator[Any]:
    """Values that a setting does not allow."""
    if not setting.optional:
        yield None
    if setting.alternatives or setting.choices:
        yield from ("no such word", 17)
    elif setting.kind is bool:
        yield from ("yes", 2)
    elif setting.form is not None:
        yield from ("x", (float("nan"),) * 3)
        # Some lists have no greatest length, such as one for each light.
        if get_args(setting.kind)[-1:] != (Ellipsis,) or setting.lengths.max_length is not None:
            yield (1.0,) * 40
    else:
        limits = setting.limits
        # At least what single precision resolves.
        far = (1 + max(abs(end) for end in (limits.low, limits.high) if end is not None)) * 10.0 ** rng.uniform(-3, 6)
        yield from ("x", float("nan"), float("inf"), -float("inf"), (1.0, 2.0))
        if limits.low is not None:
            yield from (limits.low - far, *([limits.low] if limits.above_low else []))
        if limits.high is not None:
            yield from (limits.high + far, *([limits.high] if limits.below_high else []))
        if setting.kind is int:
            yield from (1.5, True)


def within(setting: Setting, rng: np.random.Generator) -> Iterator[Any]:
    """Values that a setting allows: all choices, and the ends of a range and what lies between."""
    limits = setting.limits
    yield from setting.choices
    if limits.low is None or limits.high is None or setting.form is not None:
        return
    if not limits.above_low:
        yield limits.low
    if not limits.below_high:
        yield limits.high
    between = limits.low + (limits.high - limits.low) * rng.uniform(0.01, 0.99)
    yield int(between) if setting.kind is int else between


def complaints() -> Iterator[str]:
    rng = np.random.default_rng(3)
    for module in described():
        example, names = EXAMPLES.get(module, {}), inspect.signature(module).parameters
        if inspect.isabstract(module):
            continue
        for name, setting in fields_of(module).items():
            for value in beyond(setting, rng) if name in names else ():
                try:
                    module(**{**example, name: value})
                    yield f"{module.__name__} took {name} = {value!r}"
                except (ValueError, TypeError) as error:
                    if name not in str(error):
                        yield f"{module.__name__}: {name} = {value!r} gives {error}"
            for value in within(setting, rng) if name in names else ():
                try:
                    if name not in TOGETHER.get(module.__name__, ()):
                        module(**{**example, name: value})
                except (ValueError, TypeError) as error:
                    yield f"{module.__name__} refused {name} = {value!r}: {error}"


def value_of(expression: str) -> str:
    """What an expression gives, or its error, on one line."""
    try:
        return str(eval(expression))
    except (ValueError, TypeError) as error:
        return str(error).replace("\n", " ")


if __name__ == "__main__":
    print(json.dumps({"complaints": [*complaints()], "values": [*map(value_of, json.loads(sys.argv[1]))]}))
