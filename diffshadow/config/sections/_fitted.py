"""Which numbers of a configuration can be fitted: those marked as `Fitted` in their sections."""

import functools
from collections.abc import Iterator, Mapping
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from ...settings import Fitted, Limits, Setting, bare
from ...settings.techniques import Technique
from .._errors import did_you_mean, listing
from ._biases import PLANES, BiasConfig, TermsConfig
from ._filters import FILTERS
from ._poses import could_be_pose, is_pose, pose_faults, pose_of
from ._section import Conflict, Section, fault, is_index, is_number, marked, type_of, value_at
from ._technique import TECHNIQUES


def fit_paths(data: Any) -> dict[str, str]:
    """The numbers of a configuration's technique that can be fitted.

    **Arguments:**

    - `data`: a configuration, or the unchecked data of one.

    **Returns:** the dotted path of each number in the technique that the configuration builds, by the key that sets it;
    for example, `"bias.slope"` maps to `"bias.slope.value"`.
    """
    return {
        f"{holder}.{key}{entry}": f"{_field(holder, section)}{_path(section, key)}{entry}"
        for holder, section in _holders(data).items()
        for key, mark in _fitted_keys(section).items()
        for entry in _entries(section.model_fields[key], mark, value_at(data, *holder.split("."), key))
    }


def _entries(field: FieldInfo, mark: Fitted, value: Any) -> list[str]:
    """What follows the key of a field in the names of its numbers: their indices if it is a list."""
    if get_origin(marked(field)[0]) is not tuple:
        return [] if mark.needs_value and value is None else [""]
    return [f".{i}" for i in range(len(value))] if isinstance(value, list | tuple) else []


def is_searched(data: Any, name: str) -> bool:
    """Whether the number `name` of a configuration is found by a search, rather than by gradient."""
    holder, key, _ = key_of(name)
    section = _holders(data).get(holder)
    return section is not None and key in (fitted := _fitted_keys(section)) and fitted[key].searched


def key_of(name: str) -> tuple[str, str, int | None]:
    """The section that holds the number `name`, its key there, and its index if the key holds a list."""
    holder, _, key = name.rpartition(".")
    if not is_index(key):
        return holder, key, None
    return *key_of(holder)[:2], int(key)


def start_of(data: Any, name: str) -> Any:
    """The value of the key `name` in `data`, or its default."""
    holder, key, index = key_of(name)
    section, given = _holders(data)[holder], value_at(data, *holder.split("."), default={})
    if isinstance(given, Mapping):
        given = section.completed(given)
    value = value_at(given, key, default=section.model_fields[key].default)
    return value if index is None else value[index]


def is_limit(data: Any, name: str, bound: float) -> bool:
    """Whether the number `name` cannot lie beyond `bound`, or has no sense there.

    That is a limit of its key, or 0 of a number of the technique: no bias, no radius.
    """
    pose = pose_of(data, name)
    limits = _limits_of(data, name) if pose is None else pose.limits
    return bound in (limits.low, limits.high) or (pose is None and bound == 0)


def misnamed(data: Any, parameters: Mapping[str, Any]) -> Iterator[Conflict]:
    """Faults of the entries of `parameters`, the section `fit.parameters`, whose names exist in no configuration."""
    holders = [(h, section) for h, sections in _HOLDERS.items() for section in sections]
    everywhere = {f"{h}.{key}" for h, s in (*holders, *_holders(data).items()) for key in _fitted_keys(s)}
    for name in parameters:
        path = ("fit", "parameters", name)
        if is_pose(name) and not could_be_pose(name):
            yield from ((path, what) for what in pose_faults(data, name))
        elif not is_pose(name) and ".".join(key_of(name)[:2]) not in everywhere:
            yield path, _no_such_parameter(data, name)


def parameter_faults(data: Any, parameters: Mapping[str, Any]) -> Iterator[Conflict]:
    """What is wrong with `parameters`, the section `fit.parameters`, in a fit of the configuration `data`."""
    known = fit_paths(data)
    for name, parameter in parameters.items():
        pose = pose_of(data, name)
        unknown = [] if name in known else [_no_such_parameter(data, name)]
        wrong = pose_faults(data, name) if is_pose(name) else unknown
        yield from ((("fit", "parameters", name), what) for what in wrong)
        if pose is not None:
            yield from _beyond_limits(name, parameter, pose.limits)
        elif name in known:
            limits = _limits_of(data, name)
            yield from _beyond_limits(name, parameter, limits)
            yield from _start_outside(name, parameter, start_of(data, name), limits)


def _start_outside(name: str, parameter: Any, start: Any, limits: Limits) -> Iterator[Conflict]:
    """A fault if `name` has no initial value and `start`, the value of its key, is missing or out of bounds."""
    path = ("fit", "parameters", name)
    lower, upper, initial = (value_at(parameter, key) for key in ("lower", "upper", "initial"))
    if initial is not None or not (is_number(lower) and is_number(upper)):
        return
    # A value beyond the limits is reported for the key that sets it.
    if is_number(start) and not limits.undercut_by(start) and not limits.exceeded_by(start) and lower < upper:
        yield from ((path, what) for what in outside(start, lower, upper, name))
    elif start is None:
        message = f"has no start, since {name} is not set"
        yield path, fault(message, "an initial value within the bounds", f"add initial, or set {name}")


def outside(
    initial: float | int, lower: float | int, upper: float | int, name: str | None = None
) -> Iterator[PydanticCustomError]:
    """A fault unless `initial` is within the bounds; `name` is the key that it was taken from, if any."""
    if lower <= initial <= upper:
        return
    given = f"is {initial}" if name is None else f"starts at {name} = {initial}"
    mend = "move it inside" if name is None else f"give an initial value, change {name}"
    yield fault(given, f"a start from lower = {lower} to upper = {upper}", f"{mend}, or widen the bounds")


# All sections with numbers that can be fitted, by their keys.
_HOLDERS = {
    "bias": [BiasConfig],
    "bias.terms": [TermsConfig],
    "bias.plane": [*PLANES.sections.values()],
    "filter": [*FILTERS.sections.values()],
    "technique": [*TECHNIQUES.sections.values()],
}
# Where the module's fields are called otherwise than their section.
_FIELDS = {"bias.terms": "bias.terms.weights", "technique": "layout"}


def _field(holder: str, section: type[Section]) -> str:
    """What precedes the names of a section's numbers in the technique that it builds."""
    return "" if _is_whole(section) else f"{_FIELDS.get(holder, holder)}."


def _is_whole(section: type[Section]) -> bool:
    """Whether it is a technique whose numbers are all its own."""
    return issubclass(section, Technique) and section.is_whole


def _path(section: type[Section], key: str) -> str:
    """The path of a section's number in the module that it builds."""
    (path,) = Setting.of(None, marks=marked(section.model_fields[key])[1]).paths(key)
    return path


@functools.cache
def _fitted_keys(section: type[Section]) -> dict[str, Fitted]:
    """The keys of `section` that can be fitted."""
    fields = section.model_fields.items()
    return {key: mark for key, field in fields for mark in marked(field)[1] if isinstance(mark, Fitted)}


def _holders(data: Any) -> dict[str, type[Section]]:
    """The sections of `data` with numbers that can be fitted, by their keys."""
    technique = TECHNIQUES.of(value_at(data, "technique"))
    if _is_whole(technique):
        return {"technique": technique}
    return {
        "bias": BiasConfig,
        "bias.terms": TermsConfig,
        "bias.plane": PLANES.of(value_at(data, "bias", "plane")),
        "filter": FILTERS.of(value_at(data, "filter")),
        "technique": technique,
    }


def _no_such_parameter(data: Any, name: str) -> PydanticCustomError:
    known = tuple(fit_paths(data))
    mend = "name one of these"
    if not any(name == f"filter.{field}" for kind in FILTERS.sections.values() for field in kind.model_fields):
        # A parameter of another filter is not a misspelling.
        mend = did_you_mean(name, known, mend)
    holders = _holders(data)
    kind = "technique" if _is_whole(holders["technique"]) else "filter"
    of = f"{kind} type {type_of(holders[kind])!r}"
    return fault(f"cannot be fitted with {of}", listing(known), mend)


def _beyond_limits(name: str, parameter: Any, limits: Limits) -> Iterator[Conflict]:
    """Faults of bounds beyond the limits of the number `name`."""
    path, lower, upper = ("fit", "parameters", name), value_at(parameter, "lower"), value_at(parameter, "upper")
    if is_number(lower) and limits.undercut_by(lower):
        yield (*path, "lower"), fault(f"is {lower}", f"a number {limits.least}, as for {name}", "raise it")
    if is_number(upper) and limits.exceeded_by(upper):
        yield (*path, "upper"), fault(f"is {upper}", f"a number {limits.most}, as for {name}", "lower it")


def _limits_of(data: Any, name: str) -> Limits:
    """The limits of the key `name`."""
    holder, key, index = key_of(name)
    kind, marks = marked(_holders(data)[holder].model_fields[key])
    return Limits.of(marks if index is None else bare(get_args(kind)[0])[1])
