"""Builds the technique and the shading of a configuration."""

from typing import Any

from ... import shading, shadow
from ...settings import Settings
from ...settings.biases import NoPlane
from ...settings.engines import Engine
from ...settings.maps import Compare, HardCompare, SoftCompare
from ...settings.patterns import Pattern
from ...settings.shading import INTENSITY, ModulatedShadow
from ...settings.techniques import Cascades, FittedLayout, Mapped
from ..sections._config import Config
from ..sections._section import settings_of
from ..sections._technique import BiasConfig
from ._scene import blame

# The module for each class of settings.
_MODULES: dict[type[Settings], Any] = {
    module.settings: module for module in vars(shadow).values() if hasattr(module, "settings")
}

# Patterns whose function has another name.
_PATTERNS = {"poisson": "poisson_disk"}


def build_technique(config: Config, *, fitting: bool = True) -> shadow.AbstractTechnique:
    """The technique of `config`.

    **Arguments:**

    - `fitting`: whether its numbers may later be set to any value within the bounds of their fit. Otherwise the section
      `fit` is ignored, and a box filter takes only the taps for the radius of `config`.

    **Raises** `ConfigError` if its parts cannot be made.
    """
    if isinstance(config.technique, Mapped | Engine):
        return build_fittable(config, fitting=fitting)
    with blame(config, ("technique",)):
        return module_of(config.technique)(**values_of(config.technique))


def build_shadow_mapping(config: Config, *, fitting: bool = True) -> shadow.ShadowMapping:
    """The shadow mapping of `config`, even if the configuration has another technique. Everything else is as in
    `build_technique`."""
    config = config.with_starts() if fitting else config
    with blame(config, ("bias",)):
        bias = build_bias(config.bias)
    with blame(config, ("compare",)):
        compare = build_compare(config.compare)
    with blame(config, ("filter",)):
        kernel = build_filter(config, fitting=fitting)
    settings = shadow.MapSettings(**values_of(config.shadow_map))
    with blame(config, ("technique",)):
        return shadow.ShadowMapping(kernel, bias, compare, settings, build_layout(config, fitting=fitting))


def build_fittable(config: Config, *, fitting: bool = True) -> Any:
    """The technique of `config` that a fit changes: an engine's, a user's, or shadow mapping. Everything else is as in
    `build_technique`."""
    section = config.technique
    if not section.is_whole:
        return build_shadow_mapping(config, fitting=fitting)
    with blame(config, ("technique",)):
        if not isinstance(section, Engine):
            return module_of(section)(**values_of(section))
        return module_of(section)(resolution=config.shadow_map.resolution, **values_of(section))


def build_shading(config: Config) -> shading.AbstractShading:
    """The shading of `config`.

    **Raises** `ConfigError` if it cannot be made.
    """
    section, lights = config.shading, len(config.scene.each_light)
    intensity = INTENSITY / lights if section.intensity is None else section.intensity
    intensities = section.intensities
    if intensities is None and section.fits_each_intensity(config):
        intensities = (intensity,) * lights
    with blame(config, ("shading",)):
        phong = shading.Phong(
            ambient=section.ambient,
            intensity=intensity,
            intensities=intensities,
            specular=section.specular,
            shininess=section.shininess,
            background=section.background,
            attenuation=shading.Attenuation(**values_of(section.attenuation)),
            model=section.model,
        )
        return shading.ModulatedShadow(phong, section.factor) if isinstance(section, ModulatedShadow) else phong


def build_filter(config: Config, *, fitting: bool) -> shadow.AbstractFilter:
    """The filter of `config`: the module that its section describes, with the section's keys as arguments.

    **Arguments:**

    - `fitting`: whether its numbers may later be set to any value within the bounds of their fit.
    """
    section = config.filter
    arguments = values_of(section)
    if isinstance(section, Pattern):
        for key in Pattern.each():
            del arguments[key]
        make = getattr(shadow, _PATTERNS.get(section.pattern, section.pattern))
        of = lambda samples: make(samples, section.pattern_size, config.seed, section.rotated)
        arguments["pattern"] = of(section.samples)
        if "search_samples" in arguments:
            arguments["search"] = of(arguments.pop("search_samples"))
    if section.grows_with_radius:
        bounds = config.fit.parameters.get("filter.radius") if fitting else None
        arguments["max_radius"] = max(arguments["radius"], bounds.upper) if bounds else None
    return module_of(section)(**arguments)


def build_bias(section: BiasConfig) -> shadow.Bias:
    """The bias of a configuration."""
    return shadow.Bias(
        constant=shadow.ConstantBias(section.constant, section.unit),
        slope=shadow.SlopeBias(
            section.slope, section.slope_profile, section.slope_least, section.slope_most, section.unit
        ),
        normal_offset=shadow.NormalOffset(section.normal_offset, section.normal_offset_profile),
        plane=None if isinstance(section.plane, NoPlane) else module_of(section.plane)(**values_of(section.plane)),
        factors=section.factors,
        terms=_terms(section),
    )


def build_compare(section: Compare) -> shadow.AbstractCompare:
    """The compare of a configuration."""
    match section:
        case SoftCompare(width=width, kernel=kernel):
            return shadow.SoftCompare(width, kernel)
        case HardCompare(operator=operator):
            return shadow.HardCompare(operator)
    raise AssertionError


def build_layout(config: Config, *, fitting: bool) -> shadow.AbstractLayout:
    """The layout of the map of `config`. `fitting` is as for `build_filter`."""
    if not isinstance(config.technique, FittedLayout):
        return shadow.SingleMap()
    bounds = config.fit.parameters if fitting else {}
    section = config.laid_out(bounds)
    arguments = values_of(section)
    if isinstance(section, Cascades):
        arguments["max_share"] = section.max_share(bounds)
    return module_of(section)(**arguments)


def module_of(section: Any) -> Any:
    """The module for a section with several variants."""
    settings = settings_of(type(section))
    return _MODULES[settings] if settings.plugin is None else _guarded(settings)


def _guarded(settings: type[Settings]) -> Any:
    """Makes the object of a user's class. Whatever that raises is a mistake of the configuration."""

    def make(**arguments: Any) -> Any:
        try:
            return settings.plugin(**arguments)
        except Exception as error:
            raise ValueError(
                f"cannot be made: {vars(settings)['type']} raises {type(error).__name__}: {error}; expected an "
                "object: change its keys, or fix the class"
            ) from error

    return make


def _terms(section: BiasConfig) -> shadow.AbstractBias | None:
    weights = {key: weight for key, weight in values_of(section.terms).items() if weight is not None}
    linear, network = shadow.LinearBias(weights) if weights else None, section.network
    if linear is None or network is None:
        return linear
    return shadow.PerceptronBias.of(linear, [(layer.weight, layer.bias) for layer in network.hidden], network.last)


def values_of(section: Any) -> dict[str, Any]:
    """The values of a section's keys, without its type."""
    return {key: getattr(section, key) for key in type(section).model_fields if key != "type"}
