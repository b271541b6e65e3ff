"""Which numbers of a scene can be fitted: positions, directions and sizes of lights, and poses of meshes."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic_core import PydanticCustomError

from ...settings import Limits, Setting
from ...settings.quantities import Coordinate, HalfAngle, Turn, WorldUnits
from .._errors import did_you_mean, listing
from ._section import fault, is_index, value_at

_AXES = ("x", "y", "z")
_DEGREES, _WORLD = "degrees", "world units"
_POSITION = {f"position.{axis}": _WORLD for axis in _AXES}
_ANGLES = {"azimuth": _DEGREES, "elevation": _DEGREES}
_OF_LIGHTS = {
    "directional": {**_ANGLES, "angular_radius": _DEGREES},
    "spot": {**_POSITION, **_ANGLES, "radius": _WORLD},
    "point": {**_POSITION, "radius": _WORLD},
    "rectangle": {**_POSITION},
}
"""The keys that can be fitted, with their units, by the light's type."""
_OF_MESHES = {**{f"translate.{a}": _WORLD for a in _AXES}, **{f"turn.{a}": _DEGREES for a in _AXES}}
_SIZES = ("radius", "angular_radius")


class Pose(NamedTuple):
    """A number of the scene that can be fitted.

    - `path`: its dotted path in a `fit.Arrangement`; `unit`: its unit.
    - `vertex`: the indices of mesh and vertex, if the number is a coordinate of a vertex.
    """

    path: str
    unit: str
    vertex: tuple[int, int] | None = None

    @property
    def limits(self) -> Limits:
        """The limits of its bounds, equal to the limits of the keys that set such numbers."""
        kinds = (HalfAngle, Turn) if self.unit == _DEGREES else (WorldUnits, Coordinate)
        return Setting.of(kinds[0] if self.is_size else kinds[1]).limits

    @property
    def axis(self) -> int | None:
        """The axis that it is a coordinate along; none for an angle or a size."""
        last = self.path.rpartition(".")[2]
        return _AXES.index(last) if self.unit == _WORLD and last in _AXES else None

    @property
    def is_size(self) -> bool:
        """Whether it is a light's radius."""
        return self.path.endswith(".radius")


def is_pose(name: str) -> bool:
    """Whether `name` belongs to the scene, rather than to the technique."""
    return name.startswith("scene.")


def poses(data: Any) -> dict[str, Pose]:
    """The numbers of the scene that can be fitted, by name. Vertices are left out: there are too many."""
    found = {}
    for i, (key, light) in enumerate(_lights(data)):
        for name, unit in _OF_LIGHTS.get(str(value_at(light, "type", default="directional")), {}).items():
            found[f"scene.{key}.{name}"] = Pose(f"lights.{i}.{'radius' if name in _SIZES else name}", unit)
    for i in range(_count(data, "meshes")):
        found |= {f"scene.meshes.{i}.{name}": Pose(f"meshes.{i}.{name}", unit) for name, unit in _OF_MESHES.items()}
    return found


def pose_of(data: Any, name: str) -> Pose | None:
    """The number of the scene named `name`, or `None` if there is none."""
    match name.split("."):
        case ["scene", "meshes", mesh, "vertices", vertex, axis] if is_index(mesh) and is_index(vertex):
            if axis in _AXES and int(mesh) < _count(data, "meshes"):
                return Pose(f"meshes.{int(mesh)}.vertices.{int(vertex)}.{axis}", _WORLD, (int(mesh), int(vertex)))
    return poses(data).get(name)


def could_be_pose(name: str) -> bool:
    """Whether some scene, not necessarily this one, has a number `name`."""
    words = name.split(".")
    match words:
        case ["scene", "light", *key]:
            return any(".".join(key) in keys for keys in _OF_LIGHTS.values())
        case ["scene", "lights", index, *key] if is_index(index):
            return any(".".join(key) in keys for keys in _OF_LIGHTS.values())
        case ["scene", "meshes", index, "vertices", vertex, axis] if is_index(index) and is_index(vertex):
            return axis in _AXES
        case ["scene", "meshes", index, *key] if is_index(index):
            return ".".join(key) in _OF_MESHES
    return False


def pose_faults(data: Any, name: str) -> Iterator[PydanticCustomError]:
    """What is wrong with fitting the number of the scene named `name`."""
    pose = pose_of(data, name)
    if pose is None:
        known = [*poses(data), "scene.meshes.0.vertices.0.x"]
        yield fault("cannot be fitted in this scene", listing(known), did_you_mean(name, known, "name one of these"))
        return
    if not pose.is_size:
        return
    if value_at(data, "filter", "type") != "pcss" or value_at(data, "filter", "light_size") is not None:
        message = "cannot be fitted with a filter that does not use the light's size"
        yield fault(message, "filter type pcss without a light_size", "change the filter, or remove the parameter")


def _lights(data: Any) -> list[tuple[str, Any]]:
    several = value_at(data, "scene", "lights")
    if isinstance(several, list | tuple):
        return [(f"lights.{i}", light) for i, light in enumerate(several)]
    return [("light", value_at(data, "scene", "light", default={}))]


def _count(data: Any, key: str) -> int:
    entries = value_at(data, "scene", key)
    return len(entries) if isinstance(entries, list | tuple) else 0
