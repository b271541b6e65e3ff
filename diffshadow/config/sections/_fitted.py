"""The numbers of a configuration that can be fitted: the numbers marked as `Fitted` in the sections of its technique,
and the numbers that sections of the scene list as `moving`. Fits to pictures add numbers of the shading and the
reference."""

import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, get_origin

from pydantic_core import PydanticCustomError

from ..._words import counted
from ...settings import Fitted, Limits, Setting
from ...settings.quantities import Coordinate
from .._errors import did_you_mean, dotted, listing
from ._images import EACH_INTENSITY, REFERENCES, SHADINGS, PictureReferenceConfig
from ._scene import AXES, CAMERAS, LIGHTS, MeshConfig, colour_of
from ._section import Conflict, Section, fault, is_index, marked, type_of
from ._technique import FILTERS, PLANES, TECHNIQUES, BiasConfig, PercentageCloserSoftConfig, TermsConfig

if TYPE_CHECKING:
    from ._config import Config

# All sections of a technique with numbers that can be fitted, by key.
_KINDS = {
    "bias": [BiasConfig],
    "bias.terms": [TermsConfig],
    "bias.plane": [*PLANES.sections.values()],
    "filter": [*FILTERS.sections.values()],
    "technique": [*TECHNIQUES.sections.values()],
}
# Sections whose names differ from the module's fields.
_FIELDS = {"bias.terms": "bias.terms.weights", "technique": "layout"}


def is_pose(name: str) -> bool:
    """Whether `name` belongs to the scene or its shading, rather than to the technique."""
    return name.startswith(("scene.", "shading.", "reference."))


def key_of(name: str) -> tuple[str, str, int | None]:
    """The section with the number `name`, its key there, and its index if the key is a list."""
    holder, _, key = name.rpartition(".")
    if not is_index(key):
        return holder, key, None
    return *key_of(holder)[:2], int(key)


class Fittable(NamedTuple):
    """A number that can be fitted.

    - `path`: its dotted path in the technique that the configuration builds. For a number of the scene or its shading,
      its path in a `fit.Arrangement`.
    - `setting`: the limits of its bounds, equal to the limits of the keys that set such numbers, and its description.
    - `unit`: empty for colours and factors.
    - `value`: value of a number of the technique; `None` if it is not set.
    - `is_searched`: whether it is found by a search instead of a gradient.
    - `vertex`: the indices of mesh and vertex, if the number is a coordinate of a vertex.
    """

    path: str
    setting: Setting
    unit: str
    value: float | None = None
    is_searched: bool = False
    vertex: tuple[int, int] | None = None

    @property
    def axis(self) -> int | None:
        """The axis of a number that is a coordinate. `None` for an angle, a size or a colour."""
        last = self.path.rpartition(".")[2]
        return AXES.index(last) if self.unit == _VERTEX.unit and last in AXES else None


def of_technique(config: "Config") -> dict[str, Fittable]:
    """The numbers of the technique of `config` that can be fitted, by the keys that set them."""
    found = {}
    for holder, section in _holders(config).items():
        prefix = "" if config.technique.is_whole else f"{_FIELDS.get(holder, holder)}."
        for key, (mark, setting) in _fitted_keys(type(section)).items():
            value = getattr(section, key)
            name, path = f"{holder}.{key}", f"{prefix}{setting.paths(key)[0]}"
            unit = section.units().get(key, setting.unit)
            if get_origin(setting.kind) is tuple:
                for i, each in enumerate(value if isinstance(value, list | tuple) else ()):
                    entry = replace(setting.entry(i), marks=(*setting.entry(i).marks, setting.meaning))
                    found[f"{name}.{i}"] = Fittable(f"{path}.{i}", entry, unit, each, mark.searched)
            elif value is not None or not mark.needs_value:
                found[name] = Fittable(path, setting, unit, value, mark.searched)
    return found


def fittable_of(config: "Config", name: str) -> Fittable | None:
    """The number named `name`. `None` if it cannot be fitted."""
    if not is_pose(name):
        return of_technique(config).get(name)
    match name.split("."):
        case ["scene", "meshes", mesh, "vertices", vertex, axis] if is_index(mesh) and is_index(vertex):
            if axis in AXES and int(mesh) < len(config.scene.meshes):
                path = f"meshes.{int(mesh)}.vertices.{int(vertex)}.{axis}"
                return Fittable(path, _VERTEX, _VERTEX.unit, vertex=(int(mesh), int(vertex)))
    return poses(config).get(name)


def fit_paths(config: "Config") -> dict[str, str]:
    """The numbers of the technique of `config` that can be fitted.

    **Returns:** the dotted path of each number in the technique that the configuration builds, by the key that sets it;
    for example, `"bias.slope"` maps to `"bias.slope.value"`.
    """
    return {name: number.path for name, number in of_technique(config).items()}


def fit_units(config: "Config") -> dict[str, str]:
    """The unit of every number of the technique that can be fitted, and of every number of the scene that is fitted."""
    found = {name: fittable_of(config, name) for name in config.fit.parameters if is_pose(name)}
    return {name: number.unit for name, number in (of_technique(config) | found).items() if number is not None}


def _holders(config: "Config") -> dict[str, Any]:
    """The sections with numbers of the technique that can be fitted, by their keys."""
    if config.technique.is_whole:
        return {"technique": config.technique}
    bias = config.bias
    return {
        "bias": bias,
        "bias.terms": bias.terms,
        "bias.plane": bias.plane,
        "filter": config.filter,
        "technique": config.technique,
    }


@functools.cache
def _fitted_keys(section: type[Section]) -> dict[str, tuple[Fitted, Setting]]:
    """The keys of `section` that can be fitted, each with its mark and its setting."""
    settings = {key: Setting(*marked(field)) for key, field in section.model_fields.items()}
    return {key: (mark, each) for key, each in settings.items() for mark in each.marks if isinstance(mark, Fitted)}


def is_limit(config: "Config", name: str, bound: float) -> bool:
    """Whether the number `name` cannot exceed `bound`, or makes no sense beyond it.

    Such a bound is a limit of its key, or 0 for a number of the technique: no bias, no radius.
    """
    number = fittable_of(config, name)
    limits = Limits() if number is None else number.setting.limits
    return bound in (limits.low, limits.high) or (bound == 0 and not is_pose(name))


_VERTEX = Setting.of(Coordinate)


def poses(config: "Config") -> dict[str, Fittable]:
    """The numbers of the scene that can be fitted, by name. For a fit to a picture, also the numbers of its shading.
    Vertices are left out because there are too many."""
    scene, shading, found = config.scene, config.shading, {}

    def add(name: str, path: str, settings: Mapping[str, Setting]) -> None:
        for key, each in settings.items():
            found[f"{name}.{key}"] = Fittable(f"{path}.{each.paths(key)[0]}", each, each.unit)

    for i, (at, light) in enumerate(scene.each_light.items()):
        add(f"scene.{dotted(at)}", f"lights.{i}", light.moving)
    for i, mesh in enumerate(scene.meshes):
        add(f"scene.meshes.{i}", f"meshes.{i}", mesh.moving)
    if isinstance(config.reference, PictureReferenceConfig):
        add("scene.camera", "camera", scene.camera.moving)
        for i, mesh in enumerate(scene.meshes):
            add(f"scene.meshes.{i}", f"meshes.{i}", mesh.coloured)
        for key, setting in shading.moving_in(config).items():
            found[f"shading.{key}"] = Fittable(f"shading.{shading.path_of(key)}", setting, setting.unit)
        exposure = config.reference.moving["exposure"]
        found["reference.exposure"] = Fittable("exposure", exposure, exposure.unit)
    return found


@functools.cache
def _names() -> tuple[frozenset[str], frozenset[str]]:
    """The names of numbers that some configuration can fit, and the names of numbers that only a fit to a picture can
    fit. Indices are replaced by 0."""

    def below(holder: str, kinds: Iterable[Any], key: str = "moving") -> Iterator[str]:
        yield from (f"{holder}.{name}" for kind in kinds for name in getattr(kind, key, ()))

    pictured = frozenset(
        [
            *below("scene.camera", CAMERAS.sections.values()),
            *below("scene.meshes.0", [MeshConfig], "coloured"),
            *below("shading", SHADINGS.sections.values()),
            *(f"shading.{key}" for key in colour_of(f"{EACH_INTENSITY}0", None)),
            *below("reference", REFERENCES.sections.values()),
        ]
    )
    found = frozenset(
        [
            *pictured,
            *below("scene.light", LIGHTS.sections.values()),
            *below("scene.lights.0", LIGHTS.sections.values()),
            *below("scene.meshes.0", [MeshConfig]),
            *(f"scene.meshes.0.vertices.0.{axis}" for axis in AXES),
            *(f"{holder}.{key}" for holder, kinds in _KINDS.items() for kind in kinds for key in _fitted_keys(kind)),
        ]
    )
    return found, pictured


def _with_zeros(name: str) -> str:
    return ".".join("0" if is_index(word) else word for word in name.split("."))


def could_be_fitted(name: str) -> bool:
    """Whether some configuration without users' classes can fit a number `name`."""
    return (_with_zeros(name) if is_pose(name) else ".".join(key_of(name)[:2])) in _names()[0]


def misnamed(config: "Config", names: Iterable[str]) -> Iterator[Conflict]:
    """Faults for `names` in `fit.parameters` that do not exist in `config`, nor in any other configuration. Values of
    `config` need not be valid."""
    for name in names:
        holder, key, _ = key_of(name)
        section = _holders(config).get(holder)
        if not could_be_fitted(name) and (section is None or key not in _fitted_keys(type(section))):
            yield from ((("fit", "parameters", name), what) for what in name_faults(config, name))


def name_faults(config: "Config", name: str) -> Iterator[PydanticCustomError]:
    """The fault of fitting the number named `name`."""
    if is_pose(name):
        yield from _pose_faults(config, name)
    elif name not in (known := of_technique(config)):
        mend = "name one of these"
        if not any(name == f"filter.{field}" for kind in FILTERS.sections.values() for field in kind.model_fields):
            # A parameter of another filter is not a misspelling.
            mend = did_you_mean(name, known, mend)
        kind = "technique" if config.technique.is_whole else "filter"
        section = type(_holders(config)[kind])
        yield fault(f"cannot be fitted with {kind} type {type_of(section)!r}", listing(known), mend)


def _pose_faults(config: "Config", name: str) -> Iterator[PydanticCustomError]:
    pose, words, lights = fittable_of(config, name), name.split("."), len(config.scene.each_light)
    if pose is not None:
        section = config.filter
        uses_light = isinstance(section, PercentageCloserSoftConfig) and section.light_size is None
        if pose.path.endswith(".radius") and not uses_light:
            message = "cannot be fitted with a filter that does not use the light's size"
            mend = "change the filter, or remove the parameter"
            yield fault(message, "filter type pcss without a light_size", mend)
        return
    needs_picture = _with_zeros(name) in _names()[1]
    if needs_picture and not isinstance(config.reference, PictureReferenceConfig):
        mend = "set reference.type to picture, or remove the parameter"
        yield fault("cannot be fitted to visibility, which does not show it", "a fit to a picture", mend)
    elif words[:2] in (["scene", "lights"], ["shading", "intensities"]) and _is_beyond(words[2:], lights):
        message = f"is of light {int(words[2])}, and the scene has {counted(lights, 'light')}"
        yield fault(message, "light 0" if lights == 1 else f"a light from 0 to {lights - 1}", "change its number")
    elif needs_picture and name.startswith("shading.intensity."):
        mend = "name one of these, or remove all shading.intensities"
        expected = f"shading.{EACH_INTENSITY}0.{words[-1]}, and so on"
        yield fault("has no effect, because shading.intensities replace it", expected, mend)
    else:
        known = [*poses(config), "scene.meshes.0.vertices.0.x"]
        yield fault("cannot be fitted in this scene", listing(known), did_you_mean(name, known, "name one of these"))


def _is_beyond(words: list[str], count: int) -> bool:
    return bool(words) and is_index(words[0]) and int(words[0]) >= count
