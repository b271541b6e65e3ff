"""The constant and the slope bias of a configuration that gives none: what holds over many scenes with its filter."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from ...settings import rules
from ...settings.quantities import MAX_TEXELS
from ..sections._biases import has_terms
from ..sections._filters import FILTERS
from ..sections._section import is_number, value_at

_NONE = {"constant": 0.0, "slope": 0.0}
_PLANES = ({}, {"type": "none"}, {"type": "receiver_plane"})
"""Sections of a plane that the rules were measured with."""


def with_bias(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The data of a configuration with a constant and a slope bias. What is no valid section is reported elsewhere."""
    bias, kernel = data.get("bias", {}), data.get("filter", {})
    if not isinstance(bias, Mapping) or not isinstance(kernel, Mapping):
        return data
    rule = {key: _within(data, key, value) for key, value in _rule(bias, kernel).items()}
    return {**data, "bias": {**rule, **bias}}


def _rule(bias: Mapping[str, Any], kernel: Mapping[str, Any]) -> Mapping[str, float]:
    # Rules are in texels, and a bias of terms needs no other.
    if bias.get("unit") == "depth" or has_terms(bias) or bias.get("plane", {}) not in _PLANES:
        return _NONE
    kind: Any = FILTERS.of(kernel)
    values = {key: kernel.get(key, field.default) for key, field in kind.model_fields.items()}
    plane = value_at(bias, "plane", "type", default="none") != "none"
    if not issubclass(kind, rules.MEASURED):
        return rules.bias_of(kind, 0.0, plane=plane)._asdict()
    if not all(is_number(values[key]) for key in ("radius", "size") if key in values):
        return _NONE
    return rules.bias_of(kind, float(kind.reach_of(SimpleNamespace(**values))), plane=plane)._asdict()


def _within(data: Mapping[str, Any], key: str, value: float) -> float:
    """A number of the bias, moved into the bounds that it is fitted within."""
    bounds = value_at(data, "fit", "parameters", f"bias.{key}")
    low, high = (value_at(bounds, end) for end in ("lower", "upper"))
    value = min(value, float(MAX_TEXELS))
    return min(max(value, float(low)), float(high)) if is_number(low) and is_number(high) else value
