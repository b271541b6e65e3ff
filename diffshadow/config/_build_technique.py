"""Techniques from their sections."""

from typing import Any

from .. import shadow
from ._filters import PatternedConfig
from ._schema import Config
from ._section import Section
from ._technique import CompareConfig, SoftCompareConfig

# Patterns whose name differs from that of the function that makes them.
_PATTERNS = {"poisson": "poisson_disk"}


def build_filter(config: Config, *, fitting: bool) -> shadow.AbstractFilter:
    """The filter of `config`: the module that its section names, with the section's keys as arguments.

    **Arguments:**

    - `fitting`: whether the radius may later be set to any value within the bounds of its fit.
    """
    section = config.filter
    arguments = _arguments(config, "filter")
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


def build_bias(config: Config) -> shadow.Bias:
    """The bias of `config`."""
    given = _arguments(config, "bias")
    return shadow.Bias(
        constant=shadow.ConstantBias(given["constant"], given["unit"]),
        slope=shadow.SlopeBias(
            given["slope"], given["slope_profile"], given["slope_least"], given["slope_most"], given["unit"]
        ),
        normal_offset=shadow.NormalOffset(given["normal_offset"], given["normal_offset_profile"]),
        plane=_plane(config),
    )


def build_compare(config: CompareConfig) -> shadow.AbstractCompare:
    """The compare of `config`."""
    if isinstance(config, SoftCompareConfig):
        return shadow.SoftCompare(width=config.width, kernel=config.kernel)
    return shadow.HardCompare(operator=config.operator)


def _plane(config: Config) -> shadow.AbstractBias | None:
    modules = {"receiver_plane": shadow.ReceiverPlane, "adaptive": shadow.AdaptiveBias}
    kind = config.bias.plane.type
    return None if kind == "none" else modules[kind](**_arguments(config, "bias.plane"))


def _arguments(config: Config, holder: str) -> dict[str, Any]:
    """The values of the keys of the section `holder`, with a number for those that are to be fitted."""
    section: Any = config
    for key in holder.split("."):
        section = getattr(section, key)
    return {key: _value(config, section, f"{holder}.{key}") for key in type(section).model_fields if key != "type"}


def _value(config: Config, section: Section, name: str) -> Any:
    value = getattr(section, name.rpartition(".")[2])
    # What is not set cannot be fitted, unless the fit says where it starts.
    return config.initial(name) if value is None and name in config.fit.parameters else value
