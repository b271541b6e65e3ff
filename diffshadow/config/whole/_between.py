"""Faults between sections that are valid on their own."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from ..._words import counted
from ...settings.engines import BabylonJs, Engine, ThreeJs
from ...settings.filters import PercentageCloserSoft
from ...settings.fit import widest_blur
from ...settings.scene import LightKind, PointLight
from ...settings.techniques import (
    SPARE,
    Cascades,
    FittedLayout,
    Mapped,
    PerspectiveWarp,
    ProjectiveShadow,
    ResolutionMatched,
    ShadowVolumes,
)
from .._errors import KeyPath, dotted
from ..sections._fitted import is_searched, parameter_faults
from ..sections._lights import DirectionalLightConfig
from ..sections._section import Conflict, fault, value_at
from ._costs import FACES_OF_A_CUBE, cost_faults, fit_cost_faults
from ._parts import Parts
from ._preferences import preference_faults


def run_faults(config: Parts) -> Iterator[Conflict]:
    """Faults of any run of `config`."""
    yield from cost_faults(config)
    if isinstance(config.technique, Mapped):
        yield from _beyond_guards(config, {})
        yield from _beyond_margins(config, {})
        yield from _beyond_gutters(config, {})
        if config.shadow_map.silhouettes:
            yield from _silhouettes_of_others(config, "with silhouettes")
    if isinstance(config.technique, ShadowVolumes):
        yield from _cut_out(config, "with shadow volumes", "choose another technique")
    if isinstance(config.technique, Mapped) and config.bias.factors is not None:
        yield from _wrong_factors(config, config.technique)
    if isinstance(config.technique, FittedLayout):
        for key, light in config.scene.each_light.items():
            if not isinstance(light, DirectionalLightConfig):
                message = f"is {light.type}, while technique.type is {config.technique.type}"
                mend = "change it, or set technique.type to shadow_map"
                yield ("scene", *key, "type"), fault(message, "directional", mend)
    if isinstance(config.technique, PerspectiveWarp | ResolutionMatched):
        section, kind = config.shadow_map, config.technique.type
        for key, given in (("silhouettes", section.silhouettes), ("polygon_offset", section.polygon_offset)):
            if given and (key == "silhouettes" or kind == "perspective_warp"):
                message = f"is given, and technique.type is {kind}, whose maps cannot have it"
                yield ("shadow_map", key), fault(message, "a map without it", "remove it, or choose another technique")
    if isinstance(config.technique, Cascades) and config.technique.shares is not None:
        yield from _unfit_for_shares(config)
    if isinstance(config.technique, Engine):
        yield from _foreign_to_engine(config, config.technique)
    if not isinstance(config.technique, Engine):
        for i, mesh in enumerate(config.scene.meshes):
            if not mesh.receives:
                message = f"is false, and technique.type is {config.technique.type}, which shows shadows on all meshes"
                yield ("scene", "meshes", i, "receives"), fault(message, "true, or an engine's technique", "remove it")
    if isinstance(config.technique, ProjectiveShadow) and all(mesh.casts for mesh in config.scene.meshes):
        message = "projects shadows onto meshes that do not cast, and all of scene.meshes cast"
        yield ("technique", "type"), fault(message, "a mesh that does not cast", "set casts: false for the receivers")
    yield from _faults_of_shape(config)
    if config.reference.type == "picture":
        for key in ("sweep", "advise"):
            if getattr(config, key) is not None:
                what = fault("is given with reference.type picture", "a single fit to a picture", "remove one of them")
                yield (key,), what
    intensities, lights = config.shading.intensities, len(config.scene.each_light)
    if intensities is not None and len(intensities) != lights:
        message = f"has {counted(len(intensities), 'entry')}, and the scene has {counted(lights, 'light')}"
        yield ("shading", "intensities"), fault(message, "one for each light", "add or remove some")
    if config.reference.type == "image" and len(config.scene.each_light) > 1:
        message = f"is a single image, for {len(config.scene.each_light)} lights"
        yield ("reference", "type"), fault(message, "one light, or a traced reference", "set it to traced")


def _faults_of_shape(config: Parts) -> Iterator[Conflict]:
    """Faults of a fit of a shape."""
    shape, lights = config.fit.shape, config.scene.each_light
    if shape is None:
        return
    for key in ("images", "masks", "targets"):
        count = len(getattr(shape, key))
        if count and count != len(lights):
            message = f"has {counted(count, 'entry')}, and the scene has {counted(len(lights), 'light')}"
            yield ("fit", "shape", key), fault(message, "one for each light", "add or remove some")
    for i, number in enumerate(shape.moves):
        if not 0 <= number < len(lights) or number in shape.moves[:i]:
            message = f"is {number}, and the scene has {counted(len(lights), 'light')}"
            expected = f"each number from 0 to {len(lights) - 1} at most once"
            yield ("fit", "shape", "moves", i), fault(message, expected, "change or remove it")
    if config.technique.type != "shadow_map":
        message = f"is {config.technique.type}, and fit.shape draws plain shadow maps"
        yield ("technique", "type"), fault(message, "shadow_map", "remove the technique")
    for key in ("sweep", "advise"):
        if getattr(config, key) is not None:
            yield (key,), fault("is given together with fit.shape", "one or the other", "remove one of them")
    for key in ("views", "validation"):
        if getattr(config.fit, key) is not None:
            mend = "remove it; fit.shape.unseen has lights for measuring"
            yield ("fit", key), fault("is given together with fit.shape", "one or the other", mend)
    for i, phase in enumerate(shape.phases):
        most = widest_blur(*shape.resolution)
        if phase.blur > most:
            message = f"is {phase.blur:g}, and fit.shape.resolution is {list(shape.resolution)}"
            expected = f"at most {most:g} pixels, an eighth of its shorter side"
            yield ("fit", "shape", "phases", i, "blur"), fault(message, expected, "make it narrower")


def _unfit_for_shares(config: Parts) -> Iterator[Conflict]:
    """Faults of maps that cascades of several sizes cannot have."""
    (height, width), mend = config.shadow_map.resolution, "change it, or remove technique.shares"
    if height != width:
        message = f"is {[height, width]}, and technique.shares are given, for square maps"
        yield ("shadow_map", "resolution"), fault(message, "two equal numbers", mend)
    if config.shadow_map.silhouettes:
        message = "is true, and technique.shares are given, for maps without silhouettes"
        yield ("shadow_map", "silhouettes"), fault(message, "false", mend)


def _foreign_to_engine(config: Parts, technique: Engine) -> Iterator[Conflict]:
    """Faults of what an engine does not have."""
    for key, light in config.scene.each_light.items():
        path = ("scene", *key, "type")
        if light.type not in get_args(LightKind):
            yield path, fault(f"is {light.type}, which no engine has", "directional, spot or point", "change it")
        elif isinstance(technique, ThreeJs) and light.type == "point" and technique.shadow_type == "VSMShadowMap":
            message = "is point, for which three.js draws no VSMShadowMap"
            yield path, fault(message, "directional or spot", "change it, or technique.shadow_type")
    count = len(config.scene.meshes)
    height, width = config.shadow_map.resolution
    if isinstance(technique, BabylonJs) and height != width:
        message = f"is {[height, width]}, and technique.type is babylon.js, whose maps are square"
        yield ("shadow_map", "resolution"), fault(message, "two equal numbers", "change it")
    elif height != width and any(light.type == "point" for light in config.scene.each_light.values()):
        message = f"is {[height, width]}, and a light is point, whose map is a cube's faces in engines"
        yield ("shadow_map", "resolution"), fault(message, "two equal numbers", "change it")
    for name in ("side", "shadow_side", "back_face_culling"):
        sides = getattr(technique, name, None)
        if isinstance(sides, tuple) and len(sides) != count:
            message = f"has {counted(len(sides), 'entry')}, and the scene has {counted(count, 'mesh')}"
            yield ("technique", name), fault(message, "one for each", "give one for all, or one for each")


def _wrong_factors(config: Parts, technique: Mapped) -> Iterator[Conflict]:
    """A fault unless there are as many factors of the bias as maps of each light."""
    given = len(config.bias.factors or ())
    for light in config.scene.each_light.values():
        layers = FACES_OF_A_CUBE if isinstance(light, PointLight) else technique.layers
        if layers == 1:
            message, mend = f"has {given} factors, for a light with one map", "remove it, or use cascades"
            yield ("bias", "factors"), fault(message, "a light with several maps", mend)
        elif layers != given:
            message = f"has {given} factors, for a light with {layers} maps"
            yield ("bias", "factors"), fault(message, "as many", "give one for each map")


def fit_faults(config: Parts) -> Iterator[Conflict]:
    """Faults that only a fit of `config` has, in addition to `data_faults_of_fit`."""
    yield from fit_cost_faults(config)
    yield from _beyond_the_greatest_radius(config)
    if isinstance(config.technique, Mapped):
        yield from _beyond_guards(config, config.fit.parameters)
        yield from _beyond_margins(config, config.fit.parameters)
        yield from _beyond_gutters(config, config.fit.parameters)
    yield from _unused_in_layout(config)
    yield from _unsuitable_views(config)
    yield from preference_faults(config)
    if not config.moves:
        return
    if config.technique.is_whole:
        message = f"is {config.technique.type} in a fit of lights or meshes"
        yield ("technique", "type"), fault(message, "shadow_map or cascades", "change it")
    for name in config.fit.parameters:
        if is_searched(config, name):
            what = fault("lays out the map in a fit of lights or meshes", "a fit of one or the other", "remove it")
            yield ("fit", "parameters", name), what
    if isinstance(config.technique, PerspectiveWarp | ResolutionMatched):
        message = f"is {config.technique.type} in a fit of lights or meshes, which needs maps with silhouettes"
        yield ("technique", "type"), fault(message, "shadow_map or cascades", "change it")
    if isinstance(config.technique, Mapped) and config.shadow_map.silhouettes is None:
        yield from _silhouettes_of_others(config, "in a fit of lights or meshes, with silhouettes")
    if isinstance(config.technique, Cascades) and config.technique.shares and config.has_silhouettes:
        message = "is given in a fit of lights or meshes, which needs maps with silhouettes"
        yield ("technique", "shares"), fault(message, "cascades of one size", "remove it")
    yield from _wide_blurs(config)
    for key, light in config.scene.each_light.items():
        if isinstance(light, DirectionalLightConfig) and light.frame == "casters":
            message = "is casters in a fit of lights or meshes, whose shadows may move outside the initial frame"
            yield ("scene", *key, "frame"), fault(message, "scene", "remove it")
        if isinstance(light, DirectionalLightConfig) and light.shadow_camera is not None:
            message = "is given in a fit of lights or meshes, which fits the map to the scene at every step"
            yield ("scene", *key, "shadow_camera"), fault(message, "a map that is fitted", "remove it")


def data_faults_of_fit(data: Any) -> Iterator[Conflict]:
    """Faults that only a fit has, of a configuration or the unchecked data of one."""
    parameters = value_at(data, "fit", "parameters")
    if isinstance(parameters, Mapping):
        yield from parameter_faults(data, parameters)
    if parameters == {} and value_at(data, "fit", "shape") is None:
        mend = "add 'bias.constant: {lower: 0, upper: 10}'"
        yield ("fit", "parameters"), fault("is empty", "at least one parameter to fit", mend)


def _unused_in_layout(config: Parts) -> Iterator[Conflict]:
    """Faults of fitted numbers of the layout that others replace."""
    section = config.technique
    unused: dict[str, tuple[str, str]] = {}
    if isinstance(section, Cascades) and section.distances is not None:
        unused["logarithmic"] = "technique.distances is given", "remove it, or technique.distances"
    if isinstance(section, PerspectiveWarp):
        if section.method != "trapezoidal":
            unused["focus"] = f"technique.method is {section.method}", "remove it, or set the method to trapezoidal"
        if section.strength is not None or "technique.strength" in config.fit.parameters:
            unused["focus"] = "technique.strength replaces it", "remove one of them"
    for key, (why, mend) in unused.items():
        if f"technique.{key}" in config.fit.parameters:
            what = fault(f"changes nothing, since {why}", "a number that the layout uses", mend)
            yield ("fit", "parameters", f"technique.{key}"), what


def _unsuitable_views(config: Parts) -> Iterator[Conflict]:
    """Faults of views in fits that are of one scene alone, and of maps of several sizes where only one can be."""
    if config.fit.validation is not None and config.fit.views is None and config.moves:
        yield ("fit", "validation"), fault("is given in a fit of lights or meshes", "a fit of a technique", "remove it")
    if config.fit.views is None:
        return
    if config.moves:
        yield ("fit", "views"), fault("are given in a fit of lights or meshes", "a fit of a technique", "remove them")
    sizes = "shadow_map.resolution" in config.fit.views.axes
    searches = any(is_searched(config, name) for name in config.fit.parameters)
    if sizes and (searches or isinstance(config.technique, Engine)):
        given = f"change shadow_map.resolution, with technique.type {config.technique.type} and its parameters"
        yield ("fit", "views"), fault(given, "one size for all", "set it outside of the views")


def _beyond_the_greatest_radius(config: Parts) -> Iterator[Conflict]:
    """A fault if the fit's bounds let a disk's least radius exceed its greatest."""
    bounds, section = config.fit.parameters.get("filter.min_radius"), config.filter
    if bounds is not None and isinstance(section, PercentageCloserSoft) and bounds.upper > section.max_radius:
        message = f"is {bounds.upper:g}, and filter.max_radius is {section.max_radius:g}"
        what = fault(message, "at most filter.max_radius", "lower it, or raise filter.max_radius")
        yield ("fit", "parameters", "filter.min_radius", "upper"), what


def _silhouettes_of_others(config: Parts, why: str) -> Iterator[Conflict]:
    """Faults of a map with silhouettes that does not store the nearest of all faces."""
    section = config.shadow_map
    for key, value, plain in (("depth_layer", section.depth_layer, "nearest"), ("cull", section.cull, "none")):
        if value != plain:
            mend = "remove it, or set shadow_map.silhouettes to false"
            yield ("shadow_map", key), fault(f"is {value} {why}", plain, mend)
    yield from _cut_out(config, why, "set shadow_map.silhouettes to false")


def _cut_out(config: Parts, why: str, mend: str) -> Iterator[Conflict]:
    """Faults of alpha tests where the outlines of casters matter."""
    for i, mesh in enumerate(config.scene.meshes):
        if mesh.alpha_cutoff:
            message = f"is {mesh.alpha_cutoff:g} {why}, whose outlines are those of whole faces"
            what = fault(message, "meshes without an alpha test", f"remove it, or {mend}")
            yield ("scene", "meshes", i, "alpha_cutoff"), what


def _wide_blurs(config: Parts) -> Iterator[Conflict]:
    """Faults of blurs that are wide for the image."""
    resolution = config.scene.camera.resolution
    most = widest_blur(*resolution)
    for i, blur in enumerate(config.fit.blurs or ()):
        if blur > most:
            message = f"is {blur:g}, and scene.camera.resolution is {list(resolution)}"
            expected = f"at most {most:g} pixels, an eighth of its shorter side"
            yield ("fit", "blurs", i), fault(message, expected, "make it narrower, or the image larger")


def _beyond_guards(config: Parts, bounds: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of filters that read beyond the faces of a point light's map, with fitted numbers at their `bounds`."""
    reach, name = config.reach(bounds)
    if bounds and name is None:
        # `run_faults` reports a reach that does not depend on the bounds.
        return
    path: KeyPath = _key_of_reach(config) if name is None else ("fit", "parameters", name, "upper")
    half = min(config.shadow_map.resolution) / 2
    for key, light in config.scene.each_light.items():
        if not isinstance(light, PointLight) or reach <= light.guard / (1 + light.guard) * half:
            continue
        guard = dotted(("scene", *key, "guard"))
        mends = [f"raise {guard} to {_rounded_up(reach / (half - reach)):g}"] if reach <= half / 2 else []
        mends += ["raise shadow_map.resolution", f"lower {dotted(path)}" if len(path) > 1 else "choose another filter"]
        yield (
            path,
            fault(
                f"lets the filter read {reach:g} texels away, beyond the edge of a face of a point light's map",
                f"at most {light.guard / (1 + light.guard) * half:.3g} texels, which {guard} = {light.guard:g} allows",
                f"{', '.join(mends[:-1])}, or {mends[-1]}",
            ),
        )


def _beyond_margins(config: Parts, bounds: Mapping[str, Any]) -> Iterator[Conflict]:
    """A fault of a given margin that is narrower than filters read, with fitted numbers at their `bounds`."""
    margin, (reach, name) = getattr(config.technique, "margin", None), config.reach(bounds)
    # `run_faults` reports a margin that is too narrow without the bounds.
    if margin is None or margin >= reach or (bounds and margin < config.reach({})[0]):
        return
    by = "the filter reads" if name is None else f"fit.parameters.{name}.upper lets the filter read"
    message = f"is {margin:g}, and {by} {reach:g} texels away, where the map may end"
    yield ("technique", "margin"), fault(message, f"at least {reach:g}", "raise it, or remove it")


def _beyond_gutters(config: Parts, bounds: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of filters that read further than half a page of a virtual map, with fitted numbers at their `bounds`."""
    technique, (reach, name) = config.technique, config.reach(bounds)
    if not isinstance(technique, ResolutionMatched) or technique.margin is not None:
        return
    if (bounds and name is None) or reach + SPARE <= technique.page // 2:
        return
    path: KeyPath = _key_of_reach(config) if name is None else ("fit", "parameters", name, "upper")
    message = f"lets the filter read {reach:g} texels away, further than a gutter of technique.page = {technique.page}"
    yield path, fault(message, f"at most {technique.page / 2 - SPARE:g}", "enlarge technique.page, or lower it")


def _key_of_reach(config: Parts) -> KeyPath:
    """The key that contributes most to the filter's reach."""
    section = config.filter
    if config.bias.normal_offset > section.reach:
        return ("bias", "normal_offset")
    keys = [key for key in (section.radius_key, "size", "weights") if hasattr(section, key)]
    return ("filter", *keys[:1])


def _rounded_up(value: float) -> float:
    """`value` rounded up to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / step) * step
