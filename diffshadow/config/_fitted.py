"""Which numbers of a configuration a fit may change: those that their sections mark as `Fitted`."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic_core import PydanticCustomError

from ._biases import BiasConfig, PlaneConfig
from ._errors import did_you_mean, listing, show
from ._filters import FilterConfig
from ._poses import is_pose, pose_faults
from ._section import Conflict, Fitted, Section, fault, is_number, look, variants_of

FILTERS = variants_of(FilterConfig)
"""Each filter's section by its `type`."""
_PLANES = variants_of(PlaneConfig)
DEFAULT_FILTER = "random_disk"


def fit_paths(data: Any) -> dict[str, str]:
    """The numbers that the technique of a configuration can fit.

    **Arguments:**

    - `data`: a configuration, or the data of one that may hold faults.

    **Returns:** where each number is in the `ShadowMapping` that the configuration stands for, a dotted path, by the
    key that sets it, such as `"bias.slope.value"` by `"bias.slope"`.
    """
    found = {}
    for holder, section in _holders(data).items():
        for key, field in section.model_fields.items():
            mark = next((mark for mark in field.metadata if isinstance(mark, Fitted)), None)
            if mark is not None:
                found[f"{holder}.{key}"] = f"{holder}.{mark.path or key}"
    return found


def start_of(data: Any, name: str) -> Any:
    """What the key `name` is set to in `data`, or its default."""
    holder, _, key = name.rpartition(".")
    section, given = _holders(data)[holder], look(data, *holder.split("."), default={})
    if isinstance(given, Mapping):
        given = section.completed(given)
    return look(given, key, default=section.model_fields[key].default)


def parameter_faults(data: Any, parameters: Mapping[str, Any]) -> Iterator[Conflict]:
    """What is wrong with `parameters`, the section `fit.parameters`, in a configuration of `data`."""
    known = fit_paths(data)
    for name, parameter in parameters.items():
        path = ("fit", "parameters", name)
        if is_pose(name):
            yield from ((path, what) for what in pose_faults(data, name, look(parameter, "lower")))
            continue
        if name not in known:
            yield path, _no_such_parameter(name, tuple(known), data)
            continue
        lower, upper, initial = (look(parameter, key) for key in ("lower", "upper", "initial"))
        yield from _beyond_limits(data, name, lower, upper)
        if initial is not None or not (is_number(lower) and is_number(upper)):
            continue
        start = start_of(data, name)
        # A value below 0 is an error of the key that sets it.
        if is_number(start) and start >= 0 and lower < upper:
            yield from ((path, what) for what in outside(start, lower, upper, name))
        elif start is None:
            said = f"has no value to start from, for {name} is not set"
            yield path, fault(said, "an initial value within the bounds", f"add initial, or set {name}")


def outside(
    initial: float | int, lower: float | int, upper: float | int, name: str | None = None
) -> Iterator[PydanticCustomError]:
    """A fault unless `initial`, taken from the key `name` if there is one, lies within the bounds."""
    if lower <= initial <= upper:
        return
    given = f"is {initial}" if name is None else f"starts at {name} = {initial}"
    mend = "move it inside" if name is None else f"give an initial value, change {name}"
    yield fault(given, f"a start from lower = {lower} to upper = {upper}", f"{mend}, or widen the bounds")


def _holders(data: Any) -> dict[str, type[Section]]:
    """The sections that may hold numbers to fit, by their keys."""
    plane = _PLANES.get(str(look(data, "bias", "plane", "type", default="none")), _PLANES["none"])
    return {"bias": BiasConfig, "bias.plane": plane, "filter": FILTERS[_filter_type(data)]}


def _filter_type(data: Any) -> str:
    # A misspelt type is an error of its own; a name may still be wrong for every filter.
    kind = str(look(data, "filter", "type", default=DEFAULT_FILTER))
    return kind if kind in FILTERS else DEFAULT_FILTER


def _no_such_parameter(name: str, known: tuple[str, ...], data: Any) -> PydanticCustomError:
    mend = did_you_mean(name, known, "name one of these")
    return fault(f"cannot be fitted with filter type {_filter_type(data)!r}", listing(known), mend)


def _beyond_limits(data: Any, name: str, lower: Any, upper: Any) -> Iterator[Conflict]:
    """Faults of bounds that the key `name` itself could not be set to."""
    holder, _, key = name.rpartition(".")
    path = ("fit", "parameters", name)
    for limit in _holders(data)[holder].model_fields[key].metadata:
        least, above, most = (_bound(limit, kind) for kind in ("ge", "gt", "le"))
        if is_number(lower) and least is not None and lower < least:
            yield (*path, "lower"), fault(f"is {lower}", f"a number at least {show(least)}, as for {name}", "raise it")
        if is_number(lower) and above is not None and lower <= above:
            yield (*path, "lower"), fault(f"is {lower}", f"a number greater than {above}, as for {name}", "raise it")
        if is_number(upper) and most is not None and upper > most:
            yield (*path, "upper"), fault(f"is {upper}", f"a number at most {show(most)}, as for {name}", "lower it")


def _bound(limit: Any, kind: str) -> int | float | None:
    value = getattr(limit, kind, None)
    return value if is_number(value) else None
