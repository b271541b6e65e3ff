"""Builds filters, biases and compares from their sections."""

from typing import Any

from ... import shadow
from ...settings import Settings
from ...settings.biases import NoPlane
from ...settings.maps import Compare, HardCompare, SoftCompare
from ...settings.patterns import Pattern
from ...settings.techniques import Cascades, FittedLayout
from ..sections._config import Config
from ..sections._section import settings_of
from ..sections._technique import BiasConfig

# The module that each class of settings describes.
_MODULES: dict[type[Settings], Any] = {
    module.settings: module for module in vars(shadow).values() if hasattr(module, "settings")
}

# Patterns whose function has another name.
_PATTERNS = {"poisson": "poisson_disk"}


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
    """How the map of `config` is laid out; `fitting` as for `build_filter`."""
    if not isinstance(config.technique, FittedLayout):
        return shadow.SingleMap()
    bounds = config.fit.parameters if fitting else {}
    section = config.laid_out(bounds)
    arguments = values_of(section)
    if isinstance(section, Cascades):
        arguments["max_share"] = section.max_share(bounds)
    return module_of(section)(**arguments)


def module_of(section: Any) -> Any:
    """The module that a section of several variants describes."""
    settings = settings_of(type(section))
    return _MODULES[settings] if settings.plugin is None else _guarded(settings)


def _guarded(settings: type[Settings]) -> Any:
    """Makes what a user's class describes. Whatever that raises is a mistake of the configuration."""

    def make(**arguments: Any) -> Any:
        try:
            return settings.plugin(**arguments)
        except Exception as error:
            raise ValueError(
                f"cannot be made: {vars(settings)['type']} raises {type(error).__name__}: {error}; expected an object: "
                "change its keys, or mend the class"
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
