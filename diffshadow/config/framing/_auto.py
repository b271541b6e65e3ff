"""The parts of a scene that a configuration leaves to the program."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ..sections._section import given, value_at

AUTO = "auto"
"""The word for a part that the program finds."""
_PLACE = ("eye", "orbit", "target")
_SUN = ("azimuth", "elevation", "direction")


class Asked(NamedTuple):
    """The parts that the program has to find: a camera without a position, a light of the type auto, and a ground.

    - `sun`: whether the light must be a sun, because some of its angles are given.
    """

    camera: bool
    light: bool
    ground: bool
    sun: bool


def spell_out(data: dict[str, Any]) -> None:
    """Writes the parts of `data` that are `auto` as sections, so that overrides can set other keys in them.

    If views set a camera's orbit, the camera starts from the default orbit.
    """
    scene = data.get("scene")
    if isinstance(scene, dict):
        if scene.get("camera") == AUTO:
            scene["camera"] = {}
        if scene.get("light") == AUTO:
            scene["light"] = {"type": AUTO}
        camera = scene.get("camera", {})
        if isinstance(camera, dict) and not given(camera, *_PLACE) and _views_place(data, ("orbit",)):
            scene["camera"] = {**camera, "orbit": {}}


def asked_in(data: dict[str, Any]) -> tuple[Asked, dict[str, Any]]:
    """The parts that `data` leaves to the program. Also the data with a sun instead of a light that has to be found, so
    that all other values can be checked. Values of `data` may have any type."""
    spell_out(data)
    scene = data.get("scene")
    if not isinstance(scene, dict):
        return Asked(False, False, False, False), data
    camera, light = scene.get("camera", {}), scene.get("light")
    # The key of the found position would conflict with the key of the views.
    placeless = isinstance(camera, Mapping) and not given(camera, *_PLACE) and not _views_place(data, _PLACE)
    ground = scene.get("ground") == AUTO
    if not isinstance(light, Mapping) or light.get("type") != AUTO:
        return Asked(placeless, False, ground, False), data
    checked = {**data, "scene": {**scene, "light": {**light, "type": "directional"}}}
    return Asked(placeless, True, ground, bool(given(light, *_SUN))), checked


def _views_place(data: Any, keys: tuple[str, ...]) -> bool:
    """Whether views of the fit set one of these `keys` of the camera."""
    return any(_sets_camera(value_at(data, "fit", kind), keys) for kind in ("views", "validation"))


def _sets_camera(value: Any, keys: tuple[str, ...]) -> bool:
    """Whether one of these `keys` of the camera occurs anywhere in `value`, a section of views."""
    if isinstance(value, Mapping):
        words = (str(key).split(".") for key in value)
        if any(key[:2] == ["scene", "camera"] and len(key) > 2 and key[2] in keys for key in words):
            return True
        value = [*value.values()]
    return isinstance(value, list | tuple) and any(_sets_camera(each, keys) for each in value)
