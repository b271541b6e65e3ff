"""Sections of a technique: how maps are drawn and laid out, biases, compares and filters."""

import itertools
import math
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_args

from pydantic import Field

from ..._words import counted
from ...settings import Form, biases, engines, filters, maps, rules, techniques
from ...settings.biases import Number
from ...settings.patterns import MAX_TAPS, Pattern, Vogel
from ...settings.quantities import MAX_TEXELS
from ...settings.scene import LightKind
from ...settings.techniques import MAX_ACROSS, SPARE
from .._errors import KeyPath, dotted
from ._section import Conflict, Section, Variants, changed, fault, given, is_number, value_at

if TYPE_CHECKING:
    from ._config import Config

Bounds = Mapping[str, Any]
"""Sections of fitted numbers, by name."""
# About 64 bytes each while four moments of a map are blurred: 4 GB. This is one map of 8192 x 8192.
_MAX_TEXELS = 1 << 26


def _too_many_texels(config: "Config", path: KeyPath, resolution: tuple[int, int], layers: int) -> Iterator[Conflict]:
    """A fault of maps with this `resolution`, and this many for each light, that would take too much memory."""
    height, width = resolution
    count = sum(light.maps(layers) for light in config.scene.each_light.values())
    if count * height * width > _MAX_TEXELS:
        message = f"is [{height}, {width}], and {count} such maps hold {count * height * width:,} texels"
        expected = f"at most {_MAX_TEXELS:,}, which take 4 GB while they are blurred"
        mend = "make it smaller, or use fewer lights or cascades; a point light has six maps"
        yield path, fault(message, expected, mend)


class AnyTechniqueConfig(Section, techniques.Technique):
    """A method of drawing shadows.

    - `is_mapped`: whether the sections shadow_map, bias, compare and filter apply.
    - `is_selective`: whether meshes can be excluded from receiving shadows.
    """

    is_mapped: ClassVar[bool] = False
    is_selective: ClassVar[bool] = False

    def laid_out(self, config: "Config", bounds: Bounds) -> Self:
        """The technique with values for missing reserves of its layout, as large as fitted numbers within `bounds`
        need."""
        return self

    def max_share(self, bounds: Bounds) -> float | None:
        """The largest fraction of all texels that a cascade may have, in (0, 1]. `None` unless cascades have shares.

        **Arguments:**

        - `bounds`: the bounds of fitted numbers, by name. The numbers may have any value within their bounds.
        """
        return None

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if config.moves and self.is_whole:
            message = f"is {self.type} in a fit of lights or meshes"
            yield ("technique", "type"), fault(message, "shadow_map or cascades", "change it")


class MappedConfig(AnyTechniqueConfig, techniques.Mapped):
    """Shadow maps."""

    is_mapped = True

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from _too_many_texels(config, ("shadow_map", "resolution"), config.shadow_map.resolution, self.layers)


class FittedLayoutConfig(MappedConfig, techniques.FittedLayout):
    """Maps that are fitted to the camera's view, under directional lights."""

    def laid_out(self, config: "Config", bounds: Bounds) -> Self:
        return self if self.margin is not None else changed(self, margin=config.reach(bounds).texels + SPARE)

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_run(config, at)
        yield from self._beyond_margins(config, {})
        for key, light in config.scene.each_light.items():
            if light.type != "directional":
                message = f"is {light.type}, while technique.type is {self.type}"
                mend = "change it, or set technique.type to shadow_map"
                yield ("scene", *key, "type"), fault(message, "directional", mend)

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from self._beyond_margins(config, config.fit.parameters)

    def _beyond_margins(self, config: "Config", bounds: Bounds) -> Iterator[Conflict]:
        """A fault of a given margin that is smaller than the reach of filters, with fitted numbers at their
        `bounds`."""
        reach = config.reach(bounds)
        # A margin that is too small without the bounds is a fault of the run.
        if self.margin is None or self.margin >= reach.texels or (bounds and self.margin < config.reach({}).texels):
            return
        by = f"{dotted(reach.path)} lets the filter read" if reach.is_of_fit else "the filter reads"
        message = f"is {self.margin:g}, and {by} {reach.texels:g} texels away, where the map may end"
        yield ("technique", "margin"), fault(message, f"at least {reach.texels:g}", "raise it, or remove it")


class OneMapConfig(FittedLayoutConfig):
    """A layout of one map, which lacks some features of other maps."""

    lacks: ClassVar[tuple[str, ...]] = ("silhouettes",)

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_run(config, at)
        for key in self.lacks:
            if getattr(config.shadow_map, key):
                message = f"is given, and technique.type is {self.type}, whose maps cannot have it"
                yield ("shadow_map", key), fault(message, "a map without it", "remove it, or choose another technique")

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_fit(config, at)
        if config.moves:
            message = f"is {self.type} in a fit of lights or meshes, which needs maps with silhouettes"
            yield ("technique", "type"), fault(message, "shadow_map or cascades", "change it")


class CascadesConfig(FittedLayoutConfig, techniques.Cascades):
    """Cascaded shadow maps: a map for each of several ranges of the camera's depth, under directional lights."""

    exclusive = (("distances", "shadow_distance"),)

    def laid_out(self, config: "Config", bounds: Bounds) -> Self:
        section, blend = super().laid_out(config, bounds), bounds.get("technique.blend")
        if self.max_blend is not None or blend is None:
            return section
        return changed(section, max_blend=max(self.blend, blend.upper))

    def max_share(self, bounds: Bounds) -> float | None:
        if self.shares is None:
            return None
        ends = [bounds.get(f"technique.shares.{i}") for i in range(len(self.shares))]
        low = [min(share, end.lower) if end else share for share, end in zip(self.shares, ends, strict=True)]
        high = [max(share, end.upper) if end else share for share, end in zip(self.shares, ends, strict=True)]
        return max(most / (most + sum(low) - least) for least, most in zip(low, high, strict=True))

    def faults(self) -> Iterator[Conflict]:
        if self.distances is not None and self.depths != "camera":
            yield ("depths",), fault("is surface, and distances are given", "camera", "remove depths, or distances")
        for i, (before, after) in enumerate(itertools.pairwise(self.distances or ())):
            if after <= before:
                message = f"is {after:g}, after {before:g}"
                yield ("distances", i + 1), fault(message, "increasing depths", "sort them, without repetitions")
        if self.shares is not None and len(self.shares) != self.layers:
            message = f"has {counted(len(self.shares), 'share')}, for {counted(self.layers, 'cascade')}"
            yield ("shares",), fault(message, "as many", "give one for each cascade")

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_run(config, at)
        yield from self._too_large_a_share(config, {})
        if self.shares is None:
            return
        resolution, mend = config.shadow_map.resolution, "change it, or remove technique.shares"
        if resolution[0] != resolution[1]:
            message = f"is {list(resolution)}, and technique.shares are given, whose maps are square"
            yield ("shadow_map", "resolution"), fault(message, "two equal numbers", mend)
        if config.shadow_map.silhouettes:
            message = "is true, and technique.shares are given, whose maps have no silhouettes"
            yield ("shadow_map", "silhouettes"), fault(message, "false", mend)

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_fit(config, at)
        yield from self._too_large_a_share(config, config.fit.parameters)
        if config.moves and self.shares and config.has_silhouettes:
            message = "is given in a fit of lights or meshes, which needs maps with silhouettes"
            yield ("technique", "shares"), fault(message, "cascades of one size", "remove it")
        if self.distances is not None:
            why = "technique.distances is given"
            yield from _unused(config, "logarithmic", why, "remove it, or technique.distances")

    def _too_large_a_share(self, config: "Config", bounds: Bounds) -> Iterator[Conflict]:
        """A fault of layers as large as the largest cascade, with fitted shares at their `bounds`."""
        greatest = self.max_share(bounds)
        if greatest is None or (bounds and greatest == self.max_share({})):
            # A fault that does not depend on the bounds is a fault of the run.
            return
        (height, width), count = config.shadow_map.resolution, self.layers * len(config.scene.each_light)
        side = int((height * width * self.layers * greatest) ** 0.5)
        if side <= MAX_TEXELS and side**2 * count <= _MAX_TEXELS:
            return
        message = f"lets a cascade have {greatest:.3g} of all texels: {side:,}², for which every map has memory"
        most = min(MAX_TEXELS, int((_MAX_TEXELS / count) ** 0.5))
        mend = f"lower it, or shadow_map.resolution = [{height}, {width}]"
        yield (("fit", "parameters") if bounds else ("technique", "shares")), fault(message, f"at most {most:,}²", mend)


class PerspectiveWarpConfig(OneMapConfig, techniques.PerspectiveWarp):
    """One map under each directional light, warped so that surfaces close to the camera get more texels."""

    lacks = ("silhouettes", "polygon_offset")

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_fit(config, at)
        if self.strength is not None or "technique.strength" in config.fit.parameters:
            yield from _unused(config, "focus", "technique.strength replaces it", "remove one of them")
        elif self.method != "trapezoidal":
            mend = "remove it, or set the method to trapezoidal"
            yield from _unused(config, "focus", f"technique.method is {self.method}", mend)


class ResolutionMatchedConfig(OneMapConfig, techniques.ResolutionMatched):
    """A virtual map under each directional light. Only the pages that the camera needs are drawn, at the resolution of
    the screen."""

    def faults(self) -> Iterator[Conflict]:
        for key, value in (("page", self.page), ("finest", self.finest)):
            if value & (value - 1):
                below = 1 << (value.bit_length() - 1)
                yield (key,), fault(f"is {value}", "a power of two", f"set it to {below} or {2 * below}")
        if not 2 <= self.finest / self.page <= MAX_ACROSS:
            message = f"is {self.finest}, and pages are {self.page} texels wide"
            yield ("finest",), fault(message, f"from 2 to {MAX_ACROSS} pages", "change it, or page")
        if self.margin is not None and self.margin > self.page // 2:
            message = f"is {self.margin:g}, and pages are {self.page} texels wide"
            yield ("margin",), fault(message, "at most half of that", "lower it, or enlarge page")

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_run(config, at)
        yield from self._beyond_gutters(config, {})

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_fit(config, at)
        yield from self._beyond_gutters(config, config.fit.parameters)

    def _beyond_gutters(self, config: "Config", bounds: Bounds) -> Iterator[Conflict]:
        """A fault of a filter that reads farther than half a page, with fitted numbers at their `bounds`."""
        reach = config.reach(bounds)
        is_within = self.margin is not None or reach.texels + SPARE <= self.page // 2
        if not is_within and (reach.is_of_fit or not bounds):
            far = f"{reach.texels:g} texels away, further than a gutter of technique.page = {self.page}"
            expected = f"at most {self.page / 2 - SPARE:g}"
            yield reach.path, fault(f"lets the filter read {far}", expected, "enlarge technique.page, or lower it")


def _unused(config: "Config", key: str, why: str, mend: str) -> Iterator[Conflict]:
    """A fault if a fitted number of a layout has no effect."""
    name = f"technique.{key}"
    if name in config.fit.parameters:
        what = fault(f"changes nothing, since {why}", "a number that the layout uses", mend)
        yield ("fit", "parameters", name), what


class ShadowVolumesConfig(AnyTechniqueConfig, techniques.ShadowVolumes):
    """Hard shadows from shadow volumes, without a map."""

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from config.scene.cut_out("with shadow volumes", "choose another technique")


class ProjectiveShadowConfig(AnyTechniqueConfig, techniques.ProjectiveShadow):
    """The casters' silhouette, drawn into a texture and projected onto the meshes that do not cast."""

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from _too_many_texels(config, ("technique", "resolution"), self.resolution, 1)
        if all(mesh.casts for mesh in config.scene.meshes):
            message, mend = (
                "projects shadows only onto meshes that do not cast, but all of scene.meshes cast",
                ("set casts: false for the receivers"),
            )
            yield ("technique", "type"), fault(message, "a mesh that does not cast", mend)


class EngineConfig(AnyTechniqueConfig, engines.Engine):
    """The shadows of an engine. `of_meshes`: its keys that may be a list with an entry for each mesh."""

    is_selective = True
    of_meshes: ClassVar[tuple[str, ...]] = ()

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        resolution, count = config.shadow_map.resolution, len(config.scene.meshes)
        yield from _too_many_texels(config, ("shadow_map", "resolution"), resolution, 1)
        for key, light in config.scene.each_light.items():
            if light.type not in get_args(LightKind):
                what = fault(f"is {light.type}, which no engine has", "directional, spot or point", "change it")
                yield ("scene", *key, "type"), what
            elif light.type not in self.kinds:
                what = fault(
                    f"is {light.type}, which {self.type} does not draw here", " or ".join(self.kinds), "change it"
                )
                yield ("scene", *key, "type"), what
        if resolution[0] != resolution[1] and (why := self.square_for(config)):
            yield (
                ("shadow_map", "resolution"),
                fault(f"is {list(resolution)}, and {why}", "two equal numbers", "change it"),
            )
        for name in self.of_meshes:
            sides = getattr(self, name)
            if isinstance(sides, tuple) and len(sides) != count:
                message = f"has {counted(len(sides), 'entry')}, and the scene has {counted(count, 'mesh')}"
                yield ("technique", name), fault(message, "one for each", "give one for all, or one for each")

    def square_for(self, config: "Config") -> str:
        """The reason why maps must be square. Empty if they need not be."""
        if self.has_square_maps:
            return f"technique.type is {self.type}, whose maps are square"
        has_cube = any(light.type == "point" for light in config.scene.each_light.values())
        return "a light is point, and engines draw its map as a cube's faces" if has_cube else ""


class ThreeJsConfig(EngineConfig, engines.ThreeJs):
    """The shadows of three.js r187, with the names, units and defaults of light.shadow and renderer.shadowMap."""

    of_meshes = ("side", "shadow_side")

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        yield from super().faults_of_run(config, at)
        for key, light in config.scene.each_light.items():
            if light.type == "point" and self.shadow_type == "VSMShadowMap":
                message = "is point, for which three.js draws no VSMShadowMap"
                what = fault(message, "directional or spot", "change it, or technique.shadow_type")
                yield ("scene", *key, "type"), what


class BabylonJsConfig(EngineConfig, engines.BabylonJs):
    """The shadows of Babylon.js 9.34 (WebGL2), with the names, units and defaults of its ShadowGenerator. The map must
    be square."""

    of_meshes = ("back_face_culling",)


class PlayCanvasConfig(EngineConfig, engines.PlayCanvas):
    """The shadows of PlayCanvas 2.23 (WebGL2, without clustered lighting), with the names, units and defaults of its
    LightComponent. The map must be square."""

    of_meshes = ("side",)


class BevyConfig(EngineConfig, engines.Bevy):
    """The shadows of Bevy 0.19 under directional and spot lights, with the names, units and defaults of its lights. The
    map must be square."""

    of_meshes = ("side",)


class GodotCompatibilityConfig(EngineConfig, engines.GodotCompatibility):
    """The shadows of Godot 4.6 in its Compatibility renderer, with the names, units and defaults of its lights. The map
    must be square."""

    of_meshes = ("side",)


TECHNIQUES = Variants(techniques.Technique, "shadow_map", __name__)
TechniqueConfig = Annotated[AnyTechniqueConfig, TECHNIQUES]


class ShadowMapConfig(Section, maps.ShadowMap):
    """The depth map drawn from the light."""

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if self.silhouettes:
            yield from self._silhouettes_of_others(config, "with silhouettes")

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if config.moves and self.silhouettes is None:
            yield from self._silhouettes_of_others(config, "in a fit of lights or meshes, with silhouettes")

    def _silhouettes_of_others(self, config: "Config", why: str) -> Iterator[Conflict]:
        """Faults of a map with silhouettes that does not store the nearest of all faces."""
        if not config.technique.is_mapped:
            return
        for key, value, plain in (("depth_layer", self.depth_layer, "nearest"), ("cull", self.cull, "none")):
            if value != plain:
                mend = "remove it, or set shadow_map.silhouettes to false"
                yield ("shadow_map", key), fault(f"is {value} {why}", plain, mend)
        yield from config.scene.cut_out(why, "set shadow_map.silhouettes to false")


COMPARES = Variants(maps.Compare, "hard", __name__)
CompareConfig = Annotated[maps.Compare, COMPARES]


PLANES = Variants(biases.Plane, "none", __name__)
PlaneConfig = Annotated[biases.Plane, PLANES]


class TermsConfig(Section, biases.Terms):
    """The weights of a bias that is linear in values that a shader knows about a receiver. A sum below 0 counts as
    0."""

    @property
    def given(self) -> bool:
        """Whether any weight is given."""
        return any(getattr(self, key) is not None for key in type(self).model_fields)


_Numbers = Annotated[tuple[Number, ...], Form("a list of numbers")]


class LayerConfig(Section):
    """A hidden layer of a network."""

    weight: Annotated[
        tuple[_Numbers, ...], Form("a list of lists of numbers"), "a list of weights for each of the layer's values"
    ]
    bias: Annotated[_Numbers, "offset of each of the layer's values"]


class NetworkConfig(Section):
    """A perceptron that corrects the terms. The network's inputs are all features of the terms except `one`."""

    hidden: Annotated[tuple[LayerConfig, ...], Form("a list of layers"), "hidden layers, each with weight and bias"]
    last: Annotated[_Numbers, "weights of the last hidden layer's values, in texels"]


class BiasConfig(Section, biases.Bias):
    """Biases, which move receivers towards the light before the compare."""

    terms: TermsConfig = Field(
        default_factory=TermsConfig, description="a bias that depends on several values that a shader knows"
    )
    network: Annotated[NetworkConfig | None, "a perceptron that corrects terms; default: none"] = None
    plane: PlaneConfig = Field(default_factory=PLANES.make, description="bias from the receiver's plane")

    def faults(self) -> Iterator[Conflict]:
        if self.network is not None and not self.terms.given:
            what = fault("is given without terms", "the terms that it corrects", "give terms, such as {slope: 0.5}")
            yield ("network",), what

    def faults_of_run(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        if self.factors is None or not isinstance(config.technique, MappedConfig):
            return
        given = len(self.factors)
        for light in config.scene.each_light.values():
            maps = light.maps(config.technique.layers)
            if maps == 1:
                message, mend = f"has {given} factors, for a light with one map", "remove it, or use cascades"
                yield ("bias", "factors"), fault(message, "a light with several maps", mend)
            elif maps != given:
                message = f"has {given} factors, for a light with {maps} maps"
                yield ("bias", "factors"), fault(message, "as many", "give one for each map")


class PatternedConfig(Section, Pattern):
    """A filter whose taps follow a pattern, a different one for each pixel of a tile."""

    def faults(self) -> Iterator[Conflict]:
        taps = self.samples * self.pattern_size**2
        if taps > MAX_TAPS:
            message = f"is {self.samples} with pattern_size {self.pattern_size}, which makes {taps:,} taps per tile"
            expected = f"at most {MAX_TAPS:,}, which take seconds to generate"
            yield ("samples",), fault(message, expected, "lower one of them")

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        if data.get("pattern") != "vogel":
            return data
        return {"pattern_size": Vogel.pattern_size, "rotated": Vogel.rotated, **data}


class RandomDiskConfig(PatternedConfig, filters.RandomDisk):
    """Taps on a disk."""


class PercentageCloserSoftConfig(PatternedConfig, filters.PercentageCloserSoft):
    """A disk as wide as the penumbra, which is estimated by a blocker search."""

    def faults_of_fit(self, config: "Config", at: KeyPath) -> Iterator[Conflict]:
        bounds = config.fit.parameters.get("filter.min_radius")
        if bounds is not None and bounds.upper > self.max_radius:
            message = f"is {bounds.upper:g}, and filter.max_radius is {self.max_radius:g}"
            what = fault(message, "at most filter.max_radius", "lower it, or raise filter.max_radius")
            yield ("fit", "parameters", "filter.min_radius", "upper"), what


FILTERS = Variants(filters.Filter, "random_disk", __name__)
FilterConfig = Annotated[filters.Filter, FILTERS]


_NONE = rules.Numbers(0.0, 0.0, 0.0)
_PLANES = ({}, {"type": "none"}, {"type": "receiver_plane"})
"""Sections of a plane with measured rules."""


def with_bias(data: Mapping[str, Any], across: float = math.inf) -> Mapping[str, Any]:
    """The data of a configuration with a constant and a slope bias, and a normal offset unless both are given. Invalid
    sections are reported elsewhere.

    A normal offset lets the filter read farther. There is no default offset if a map's borders limit the reach of the
    filter.

    **Arguments:** `across`: the width of a typical caster in texels.
    """
    bias, kernel = data.get("bias", {}), data.get("filter", {})
    if not isinstance(bias, Mapping) or not isinstance(kernel, Mapping):
        return data
    rule = {key: _within(data, key, value) for key, value in _rule(bias, kernel, across)._asdict().items()}
    if ("constant" in bias and "slope" in bias) or _has_near_borders(data):
        rule.pop("normal_offset")
    return {**data, "bias": {**rule, **bias}}


def _has_near_borders(data: Mapping[str, Any]) -> bool:
    """Whether a filter can read beyond a map's part: a point light's face, a page, or a given margin."""
    lights = value_at(data, "scene", "lights")
    every = [value_at(data, "scene", "light"), *(lights if isinstance(lights, list | tuple) else ())]
    if any(value_at(light, "type") == "point" for light in every):
        return True
    return (
        value_at(data, "technique", "type") == "resolution_matched" or value_at(data, "technique", "margin") is not None
    )


def _has_terms(bias: Mapping[str, Any]) -> bool:
    """`TermsConfig.given` for a bias that is not validated yet. Values other than mappings are reported elsewhere."""
    terms = bias.get("terms")
    return bool(given(terms, *terms) if isinstance(terms, Mapping) else terms)


def _rule(bias: Mapping[str, Any], kernel: Mapping[str, Any], across: float) -> rules.Numbers:
    # Rules are in texels. A bias of terms needs no rule.
    if bias.get("unit") == "depth" or _has_terms(bias) or bias.get("plane", {}) not in _PLANES:
        return _NONE
    kind: Any = FILTERS.of(kernel)
    values = {key: kernel.get(key, field.default) for key, field in kind.model_fields.items()}
    plane = value_at(bias, "plane", "type", default="none") != "none"
    if not issubclass(kind, rules.MEASURED):
        return rules.bias_of(kind, 0.0, plane=plane, across=across)
    if not all(is_number(values[key]) for key in ("radius", "size") if key in values):
        return _NONE
    return rules.bias_of(kind, float(kind.reach_of(SimpleNamespace(**values))), plane=plane, across=across)


def _within(data: Mapping[str, Any], key: str, value: float) -> float:
    """A number of the bias, clipped to the bounds of its fit."""
    bounds = value_at(data, "fit", "parameters", f"bias.{key}")
    low, high = (value_at(bounds, end) for end in ("lower", "upper"))
    value = min(value, float(MAX_TEXELS))
    return min(max(value, float(low)), float(high)) if is_number(low) and is_number(high) else value
