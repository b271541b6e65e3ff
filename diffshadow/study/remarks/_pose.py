"""Remarks on what an image does not determine of lights and meshes."""

from collections.abc import Iterator

from ... import fit
from ...config import Config
from ...settings.scene import SpotLight


def pose_remarks(config: Config | None, result: fit.FitResult, *, is_explained: bool = True) -> Iterator[str]:
    """A sentence for each parameter that the image does not determine, with the cause.

    **Arguments:**

    - `is_explained`: whether the fit explains the image. If not, nothing is said of how well it determines the values.
    """
    for name in result.flat:
        yield f"{name} was not fitted: its gradient is zero throughout, {_cause(config, name)}"
    for group in () if result.precision is None or not is_explained else result.precision.undetermined:
        if len(group) == 1:
            yield f"the image hardly determines {group[0]}: other values of it fit as well"
        else:
            listed = f"{', '.join(group[:-1])} and {group[-1]}"
            yield f"the image hardly determines {listed}: they can change together and fit as well"
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
