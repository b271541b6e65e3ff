"""Remarks on what an image does not determine of lights and meshes."""

from collections.abc import Iterator

from ... import fit
from ...config import Config
from ...settings.scene import SpotLight
from ._course import what_is_fitted

_IN_PICTURES = "since no pixel of the picture changes with it near its start: try another initial value"


def pose_remarks(config: Config | None, result: fit.FitResult, *, is_known: bool = True) -> Iterator[str]:
    """A sentence for each parameter that the image, or the picture, does not determine, with the cause.

    **Arguments:**

    - `is_known`: whether the fit converged and explains the image. If not, nothing is said of how well it determines
        the values.
    """
    what = what_is_fitted(result)
    for name in result.flat:
        # A picture also shows what has no shadow.
        cause = _IN_PICTURES if what == "picture" else _cause(config, name)
        yield f"{name} was not fitted: its gradient is zero throughout, {cause}"
    for group in () if result.precision is None or not is_known else result.precision.undetermined:
        if len(group) == 1:
            yield f"the {what} hardly determines {group[0]}: other values of it fit as well"
        else:
            listed = f"{', '.join(group[:-1])} and {group[-1]}"
            yield f"the {what} hardly determines {listed}: they can change together and fit as well"
    if result.enlargements:
        yield f"memory for silhouettes was enlarged {result.enlargements} times during the fit; each time recompiles"


def _cause(config: Config | None, name: str) -> str:
    if config is None:
        return "since no pixel changes with it: try another initial value, a filter with bilinear taps, or silhouettes"
    section, *_, key = name.split(".")
    if section != "scene":
        if config.filter.looks_up_nearest:
            return "since nearest look-ups have no gradient: choose a filter with bilinear ones"
        return "since no pixel changes with it: try another initial value"
    if key in ("azimuth", "elevation") and not _is_obeyed(config, name):
        return "since the cone of a spot light without inner_angle is ignored: set inner_angle, or do not fit this"
    if "meshes" in name:
        mesh = config.scene.meshes[int(name.split(".")[2])]
        if not mesh.casts:
            return "since its mesh does not cast: set casts: true"
    if not config.has_silhouettes:
        return "since outlines have no gradient without silhouettes: remove shadow_map.silhouettes"
    if config.filter.looks_up_nearest:
        return "since nearest look-ups have no gradient at outlines: choose a filter with bilinear ones"
    if "meshes" in name:
        return "since no pixel sees its shadow: it is outside the light's frustum, or its shadow is outside the image"
    return "since no pixel sees a shadow's outline: the light's frustum contains nothing that the camera sees"


def _is_obeyed(config: Config, name: str) -> bool:
    lights = {"scene." + ".".join(map(str, key)): light for key, light in config.scene.each_light.items()}
    light = lights[name.rpartition(".")[0]]
    return not isinstance(light, SpotLight) or light.inner_angle is not None
