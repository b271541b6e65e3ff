"""Techniques that are special cases of others."""

from collections.abc import Mapping
from functools import reduce
from typing import Any

from ...config import Config, with_fitted

# Keys that do not describe the technique.
_ASIDE = {"name", "output", "sweep", "advise", "fit"}


def as_special_case(config: Config, other: Config) -> dict[str, float] | None:
    """The values of the fitted numbers of `config` at which its technique equals the technique of `other`, which fits
    fewer numbers.

    For example, a bias of a constant and a slope is the constant bias if the slope is 0.

    **Returns** `None` if there are no such values within the bounds.
    """
    if not other.fit.parameters.keys() < config.fit.parameters.keys():
        return None
    data, values = _technique(other), {}
    for name in config.fit.parameters:
        value = reduce(_entry, name.split("."), data)
        if not isinstance(value, int | float):
            return None
        values[name] = float(value)
    # Values beyond the bounds would be clipped, which changes the technique.
    return values if _technique(with_fitted(config, values)) == data else None


def _technique(config: Config) -> Any:
    return config.model_dump(mode="json", warnings=False, exclude=_ASIDE)


def _entry(data: Any, key: str) -> Any:
    return data.get(key) if isinstance(data, Mapping) else None
