"""Preferences among values whose errors are close to the best."""

from collections.abc import Iterator

from .._errors import listing
from ..sections._fit import MIN_BIAS, FitConfig
from ..sections._section import Conflict, fault
from ._parts import Parts

_RADII = ("radius", "light_size", "blur_scale")


def preferences(fit: FitConfig) -> list[str]:
    """The parameters that should come as close to 0 as possible, in their order."""
    biases = [name for name in fit.parameters if name.startswith("bias.") or "bias" in name.rpartition(".")[2]]
    radii = [name for name in fit.parameters if name.rpartition(".")[2] in _RADII and name not in biases]
    found: dict[str, None] = {}
    for name in fit.prefer:
        found |= dict.fromkeys([*biases, *(radii if biases else ())] if name == MIN_BIAS else [name])
    return list(found)


def preference_faults(config: Parts) -> Iterator[Conflict]:
    """Faults of intervals and preferences that there cannot be."""
    fit = config.fit
    if config.moves:
        for key, given in (("intervals", fit.intervals), ("prefer", fit.prefer), ("front", fit.front)):
            if given:
                yield ("fit", key), fault("is given in a fit of lights or meshes", "a fit of a technique", "remove it")
        return
    for name in fit.prefer:
        if name == MIN_BIAS:
            if not preferences(fit):
                mend = "add bias.constant, or remove the preference"
                yield ("fit", "prefer"), fault("is least_bias, and no bias is fitted", "one among fit.parameters", mend)
        elif name not in fit.parameters:
            what = fault(f"names {name}, which is not fitted", listing((MIN_BIAS, *fit.parameters)), "change it")
            yield ("fit", "prefer"), what
