"""Builds filters, biases and compares from their sections."""

from typing import Any

from ... import shadow
from ..sections._filters import PatternedConfig
from ..sections._technique import (
    CascadesConfig,
    CompareConfig,
    PerspectiveWarpConfig,
    ResolutionMatchedConfig,
    SoftCompareConfig,
)
from ..whole._schema import Config

# Patterns whose function has another name.
_PATTERNS = {"poisson": "poisson_disk"}


def build_filter(config: Config, *, fitting: bool) -> shadow.AbstractFilter:
    """The filter of `config`: the module that its section builds, with the section's keys as arguments.

    **Arguments:**

    - `fitting`: whether its numbers may later be set to any value within the bounds of their fit.
    """
    section = config.filter
    arguments = _arguments(config, "filter", fitting=fitting)
    if isinstance(section, PatternedConfig):
        for key in PatternedConfig.model_fields:
            del arguments[key]
        make = getattr(shadow, _PATTERNS.get(section.pattern, section.pattern))
        of = lambda samples: make(samples, section.pattern_size, config.seed, section.rotated)
        arguments["pattern"] = of(section.samples)
        if "search_samples" in arguments:
            arguments["search"] = of(arguments.pop("search_samples"))
    if section.grows_with_radius:
        bounds = config.fit.parameters.get("filter.radius") if fitting else None
        arguments["max_radius"] = max(arguments["radius"], bounds.upper) if bounds else None
    return getattr(shadow, section.builds)(**arguments)


def build_bias(config: Config, *, fitting: bool) -> shadow.Bias:
    """The bias of `config`; `fitting` as for `build_filter`."""
    given = _arguments(config, "bias", fitting=fitting)
    return shadow.Bias(
        constant=shadow.ConstantBias(given["constant"], given["unit"]),
        slope=shadow.SlopeBias(
            given["slope"], given["slope_profile"], given["slope_least"], given["slope_most"], given["unit"]
        ),
        normal_offset=shadow.NormalOffset(given["normal_offset"], given["normal_offset_profile"]),
        plane=_plane(config, fitting=fitting),
        factors=given["factors"],
        terms=_terms(config, fitting=fitting),
    )


def build_compare(config: CompareConfig) -> shadow.AbstractCompare:
    """The compare of `config`."""
    if isinstance(config, SoftCompareConfig):
        return shadow.SoftCompare(width=config.width, kernel=config.kernel)
    return shadow.HardCompare(operator=config.operator)


def build_layout(config: Config, *, fitting: bool) -> shadow.AbstractLayout:
    """How the map of `config` is laid out; `fitting` as for `build_filter`."""
    section = config.technique
    if not isinstance(section, CascadesConfig | PerspectiveWarpConfig | ResolutionMatchedConfig):
        return shadow.SingleMap()
    bounds = config.fit.parameters if fitting else {}
    laid_out: Any = config.laid_out(bounds)
    arguments = _arguments(config, "technique", fitting=fitting) | {"margin": laid_out.margin}
    if isinstance(section, PerspectiveWarpConfig):
        return shadow.PerspectiveWarp(**arguments)
    if isinstance(section, ResolutionMatchedConfig):
        return shadow.ResolutionMatched(**arguments)
    arguments["max_blend"] = laid_out.max_blend
    arguments["max_share"] = config.max_share(bounds)
    return shadow.Cascades(**arguments)


def _terms(config: Config, *, fitting: bool) -> shadow.AbstractBias | None:
    given = _arguments(config, "bias.terms", fitting=fitting)
    weights = {key: weight for key, weight in given.items() if weight is not None}
    linear, network = shadow.LinearBias(weights) if weights else None, config.bias.network
    if linear is None or network is None:
        return linear
    return shadow.PerceptronBias.of(linear, [(layer.weight, layer.bias) for layer in network.hidden], network.last)


def _plane(config: Config, *, fitting: bool) -> shadow.AbstractBias | None:
    modules = {"receiver_plane": shadow.ReceiverPlane, "adaptive": shadow.AdaptiveBias}
    kind = config.bias.plane.type
    return None if kind == "none" else modules[kind](**_arguments(config, "bias.plane", fitting=fitting))


def _arguments(config: Config, holder: str, *, fitting: bool) -> dict[str, Any]:
    """The values of the keys of the section `holder`. With `fitting`, keys that are fitted have numbers."""
    section: Any = config
    for key in holder.split("."):
        section = getattr(section, key)
    values = {key: getattr(section, key) for key in type(section).model_fields if key != "type"}
    # A key that is not set has the fit's initial value, if it is fitted.
    starts = {key for key, value in values.items() if value is None and f"{holder}.{key}" in config.fit.parameters}
    return values | {key: config.initial(f"{holder}.{key}") for key in starts if fitting}
