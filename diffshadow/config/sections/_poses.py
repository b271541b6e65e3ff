"""Numbers of the scene that can be fitted: poses of lights and meshes; in fits to pictures, also camera and colours."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic_core import PydanticCustomError

from ..._words import counted
from ...settings import Limits, Setting, shading
from ...settings.quantities import Coordinate, Distance, Factor, Fraction, HalfAngle, Turn, WorldUnits
from ...settings.reference import PictureReference
from ...settings.scene import PinholeCamera
from .._errors import did_you_mean, listing
from ._section import fault, is_index, value_at

_AXES, _CHANNELS = ("x", "y", "z"), ("red", "green", "blue")
_vector = lambda key, kind: {f"{key}.{axis}": Setting.of(kind) for axis in _AXES}
_colour = lambda key, kind: {f"{key}.{channel}": Setting.of(kind) for channel in _CHANNELS}
_POSITION, _ANGLES = _vector("position", Coordinate), {key: Setting.of(Turn) for key in ("azimuth", "elevation")}
# The settings of what can be fitted, by keys. Of lights, by their type.
_OF_LIGHTS = {
    "directional": {**_ANGLES, "angular_radius": Setting.of(HalfAngle)},
    "spot": {**_POSITION, **_ANGLES, "radius": Setting.of(WorldUnits)},
    "point": {**_POSITION, "radius": Setting.of(WorldUnits)},
    "rectangle": {**_POSITION},
}
_OF_MESHES = {**_vector("translate", Coordinate), **_vector("turn", Turn)}
# Only to a picture.
_OF_CAMERAS = {
    "pinhole": {**_vector("eye", Coordinate), **_vector("turn", Turn), "fov_y": PinholeCamera.each()["fov_y"]},
    "orthographic": {**_vector("eye", Coordinate), **_vector("turn", Turn), "height": Setting.of(Distance)},
}
_ALBEDO = _colour("albedo", Fraction)
_EACH_INTENSITY = "shading.intensities."
_LIT = {
    **{key: kind for name in ("ambient", "intensity", "background") for key, kind in _colour(name, Factor).items()},
    **{key: shading.Lit.each()[key] for key in ("specular", "shininess")},
    **{f"attenuation.{key}": kind for key, kind in shading.Attenuation.each().items()},
}
_OF_SHADINGS = {"phong": _LIT, "modulated": {**_LIT, "factor": Setting.of(Fraction)}}
_EXPOSURE = "reference.exposure"
_SIZES = ("radius", "angular_radius")


class Pose(NamedTuple):
    """A number that can be fitted, and is not the technique's.

    - `path`: its dotted path in a `fit.Arrangement`; `setting`: its unit and limits.
    - `vertex`: the indices of mesh and vertex, if the number is a coordinate of a vertex.
    """

    path: str
    setting: Setting
    vertex: tuple[int, int] | None = None

    @property
    def unit(self) -> str:
        """Its unit; empty for colours."""
        return self.setting.unit

    @property
    def limits(self) -> Limits:
        """The limits of its bounds, equal to the limits of the keys that set such numbers."""
        return self.setting.limits

    @property
    def axis(self) -> int | None:
        """The axis that it is a coordinate along; none for an angle, a size or a colour."""
        last = self.path.rpartition(".")[2]
        return _AXES.index(last) if self.unit == _POSITION["position.x"].unit and last in _AXES else None

    @property
    def is_size(self) -> bool:
        """Whether it is a light's radius."""
        return self.path.endswith(".radius")


def is_pose(name: str) -> bool:
    """Whether `name` belongs to the scene or its shading, rather than to the technique."""
    return name.startswith(("scene.", "shading.", "reference."))


def poses(data: Any) -> dict[str, Pose]:
    """The numbers of the scene, and to a picture of its shading, that can be fitted, by name. Vertices are left out:
    there are too many."""
    found = {}
    for i, (key, light) in enumerate(_lights(data)):
        for name, setting in _OF_LIGHTS.get(str(value_at(light, "type", default="directional")), {}).items():
            found[f"scene.{key}.{name}"] = Pose(f"lights.{i}.{'radius' if name in _SIZES else name}", setting)
    for i in range(_count(data, "meshes")):
        found |= {f"scene.meshes.{i}.{name}": Pose(f"meshes.{i}.{name}", kind) for name, kind in _OF_MESHES.items()}
    return found | _of_pictures(data) if value_at(data, "reference", "type") == "picture" else found


def _of_pictures(data: Any) -> dict[str, Pose]:
    camera = str(value_at(data, "scene", "camera", "type", default="pinhole"))
    found = {f"scene.camera.{name}": Pose(f"camera.{name}", kind) for name, kind in _OF_CAMERAS.get(camera, {}).items()}
    for i in range(_count(data, "meshes")):
        found |= {f"scene.meshes.{i}.{name}": Pose(f"meshes.{i}.{name}", kind) for name, kind in _ALBEDO.items()}
    shaded = str(value_at(data, "shading", "type", default="phong"))
    kinds = {**_OF_SHADINGS.get(shaded, {})}
    one_by_one = value_at(data, "shading", "intensities") is not None
    if one_by_one or fits_each_intensity(data):
        kinds = {name: kind for name, kind in kinds.items() if not name.startswith("intensity.")}
    if one_by_one or len(_lights(data)) > 1:
        for i in range(len(_lights(data))):
            kinds |= _colour(f"intensities.{i}", Factor)
    for name, kind in kinds.items():
        holder = "shading.lit" if shaded == "modulated" and name != "factor" else "shading"
        found[f"shading.{name}"] = Pose(f"{holder}.{name}", kind)
    return {**found, _EXPOSURE: Pose("exposure", PictureReference.each()["exposure"])}


def fits_each_intensity(data: Any) -> bool:
    """Whether intensities of lights are fitted one by one."""
    return any(str(name).startswith(_EACH_INTENSITY) for name in value_at(data, "fit", "parameters", default={}))


def pose_of(data: Any, name: str) -> Pose | None:
    """The number of the scene or its shading named `name`, or `None` if there is none."""
    match name.split("."):
        case ["scene", "meshes", mesh, "vertices", vertex, axis] if is_index(mesh) and is_index(vertex):
            if axis in _AXES and int(mesh) < _count(data, "meshes"):
                path = f"meshes.{int(mesh)}.vertices.{int(vertex)}.{axis}"
                return Pose(path, Setting.of(Coordinate), (int(mesh), int(vertex)))
    return poses(data).get(name)


def could_be_pose(name: str) -> bool:
    """Whether some scene, not necessarily this one, has a number `name`."""
    match name.split("."):
        case ["scene", "light", *key]:
            return any(".".join(key) in keys for keys in _OF_LIGHTS.values())
        case ["scene", "lights", index, *key] if is_index(index):
            return any(".".join(key) in keys for keys in _OF_LIGHTS.values())
        case ["scene", "meshes", index, "vertices", vertex, axis] if is_index(index) and is_index(vertex):
            return axis in _AXES
        case ["scene", "meshes", index, *key] if is_index(index):
            return ".".join(key) in {**_OF_MESHES, **_ALBEDO}
    return _needs_picture(name)


def _needs_picture(name: str) -> bool:
    """Whether it can be fitted to a picture only."""
    match name.split("."):
        case ["scene", "meshes", index, *key] if is_index(index):
            return ".".join(key) in _ALBEDO
        case ["scene", "camera", *key]:
            return any(".".join(key) in keys for keys in _OF_CAMERAS.values())
        case ["shading", "intensities", index, channel] if is_index(index):
            return channel in _CHANNELS
        case ["shading", *key]:
            return any(".".join(key) in keys for keys in _OF_SHADINGS.values())
    return name == _EXPOSURE


def pose_faults(data: Any, name: str) -> Iterator[PydanticCustomError]:
    """What is wrong with fitting the number of the scene named `name`."""
    pose = pose_of(data, name)
    if pose is None:
        if _needs_picture(name) and value_at(data, "reference", "type") != "picture":
            mend = "set reference.type to picture, or remove the parameter"
            yield fault("cannot be fitted to visibility, which does not show it", "a fit to a picture", mend)
            return
        if (missing := _missing_light(data, name)) is not None:
            yield missing
            return
        if name.startswith("shading.intensity.") and _needs_picture(name):
            mend = "name one of these, or remove all shading.intensities"
            expected = f"{_EACH_INTENSITY}0.{name.rpartition('.')[2]}, and so on"
            yield fault("has no effect, since shading.intensities take its place", expected, mend)
            return
        known = [*poses(data), "scene.meshes.0.vertices.0.x"]
        yield fault("cannot be fitted in this scene", listing(known), did_you_mean(name, known, "name one of these"))
        return
    if not pose.is_size:
        return
    if value_at(data, "filter", "type") != "pcss" or value_at(data, "filter", "light_size") is not None:
        message = "cannot be fitted with a filter that does not use the light's size"
        yield fault(message, "filter type pcss without a light_size", "change the filter, or remove the parameter")


def _missing_light(data: Any, name: str) -> PydanticCustomError | None:
    """A fault if `name` is of a light that the scene does not have."""
    match name.split("."):
        case ["scene", "lights", index, *_] | ["shading", "intensities", index, *_] if is_index(index):
            count = len(_lights(data))
            if int(index) >= count:
                has = f"is of light {int(index)}, and the scene has {counted(count, 'light')}"
                expected = "light 0" if count == 1 else f"a light from 0 to {count - 1}"
                return fault(has, expected, "change its number")
    return None


def _lights(data: Any) -> list[tuple[str, Any]]:
    several = value_at(data, "scene", "lights")
    if isinstance(several, list | tuple):
        return [(f"lights.{i}", light) for i, light in enumerate(several)]
    return [("light", value_at(data, "scene", "light", default={}))]


def _count(data: Any, key: str) -> int:
    entries = value_at(data, "scene", key)
    return len(entries) if isinstance(entries, list | tuple) else 0
