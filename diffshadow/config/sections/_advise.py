"""Section of a recommendation: the techniques to fit and to compare."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field

from ...settings import Form, Limits, Unit, rules
from ...settings.quantities import Size
from .._errors import KeyPath, dotted, listing, show
from ._axes import LABEL
from ._fitted import is_pose
from ._section import Conflict, Section, fault

PARAMETERS = "parameters"
"""The key of an entry with the numbers to fit. All other keys except the label are set."""
LISTS = ("biases", "filters")
"""The keys of the lists; every combination of their entries is a technique."""
_OF_A_TECHNIQUE = ("technique", "shadow_map", "bias", "compare", "filter", "fit.anneal", "fit.solver")
_SIZE = "shadow_map.resolution"

# The start of fits, in texels. `rules.STARTS` are for this radius.
_RADIUS = 2.0

Entries = Annotated[tuple[dict[str, Any], ...], Form("a list of sections of dotted keys")]
_Sizes = Annotated[tuple[Size, ...], Form("a list of [height, width]"), Unit("texels")]


def _bias(label: str, starts: rules.Numbers, *fitted: str, plane: str = "none") -> dict[str, Any]:
    # With a disk of 16 texels, the offset stays within the faces of a point light's map of 512 texels.
    most = {"constant": 30.0, "slope": 10.0, "normal_offset": 6.0}
    return {
        LABEL: label,
        "bias": {**starts._asdict(), "plane": {"type": plane}},
        PARAMETERS: {f"bias.{name}": {"lower": 0.0, "upper": most[name]} for name in fitted},
    }


def _biases() -> tuple[dict[str, Any], ...]:
    """Biases whose fits start at the rules of thumb for the filters below."""
    starts, with_plane = rules.STARTS, rules.Numbers(rules.plane_constant_for(_RADIUS + 0.5), 0.0, 0.0)
    return (
        _bias("constant", starts["constant"], "constant"),
        _bias("slope", starts["constant + slope"], "constant", "slope"),
        _bias("normal offset", starts["normal offset"], "normal_offset"),
        _bias("constant + offset", starts["constant + normal offset"], "constant", "normal_offset"),
        _bias("receiver plane", with_plane, "constant", plane="receiver_plane"),
    )


def _filters() -> tuple[dict[str, Any], ...]:
    radius = lambda upper: {"filter.radius": {"lower": 0.0, "upper": upper}}
    disk = {"type": "random_disk", "samples": 16, "radius": _RADIUS}
    return (
        {LABEL: "nearest", "filter": {"type": "nearest"}},
        {LABEL: "tent", "filter": {"type": "tent", "radius": _RADIUS}, PARAMETERS: radius(4.0)},
        {LABEL: "16-tap disk", "filter": disk, PARAMETERS: radius(16.0)},
    )


class AdviseConfig(Section):
    """Techniques that `diffshadow advise` fits and compares: every bias with every filter, at every resolution."""

    biases: Entries = Field(
        default_factory=_biases,
        description="sections of dotted keys; label is a name, and parameters the numbers to fit, as in fit.parameters",
    )
    filters: Entries = Field(default_factory=_filters, description="the same for filters")
    resolutions: _Sizes | None = Field(
        default=None,
        description="[height, width] of the maps, in texels; default: shadow_map.resolution, and half of it",
    )
    within: Annotated[
        float,
        Limits(0, 1),
        "the cheapest technique with an RMSE of at most this fraction above the lowest is recommended",
    ] = 0.03

    def faults(self) -> Iterator[Conflict]:
        for name in LISTS:
            yield from _bad_entries(name, getattr(self, name))
        yield from self._set_by_both()
        if self.resolutions == ():
            yield ("resolutions",), fault("is an empty list", "at least one size", "add one, or remove the key")
        for i, size in enumerate(self.resolutions or ()):
            if size in (self.resolutions or ())[:i]:
                what = fault(f"is {show(size)} again", "sizes that differ", "remove one of them")
                yield ("resolutions", i), what

    def _set_by_both(self) -> Iterator[Conflict]:
        """Faults of keys that an entry of each list sets. One of the two values would be lost."""
        biases, filters = (
            [((name, i, *path), key) for i, entry in enumerate(getattr(self, name)) for path, key in _all_set(entry)]
            for name in LISTS
        )
        for path, key in filters:
            for earlier, other in biases:
                if key == other or key.startswith(f"{other}.") or other.startswith(f"{key}."):
                    message = f"sets {key}, and {dotted(('advise', *earlier))} sets {other}"
                    yield path, fault(message, "every value set by a bias or a filter", "remove one of them")
                    break


def keys_set(entry: Mapping[str, Any]) -> list[str]:
    """The keys that an entry sets, without its label and parameters."""
    return [key for key in entry if key not in (LABEL, PARAMETERS)]


def _bad_entries(name: str, entries: Sequence[Mapping[str, Any]]) -> Iterator[Conflict]:
    if not entries:
        yield (name,), fault("is an empty list", "at least one entry", "add one, or remove the key to get the default")
    labels = [entry.get(LABEL) for entry in entries]
    for i, (label, entry) in enumerate(zip(labels, entries, strict=True)):
        if not isinstance(label, str) or not label.strip() or not label.isprintable():
            given = "has no label" if label is None else f"has the label {show(label)}"
            yield (name, i), fault(given, "text on one line that names it", "add 'label: slope'")
        elif label in labels[:i]:
            yield (name, i, LABEL), fault(f"is {show(label)} again", "labels that differ", "change one of them")
        for key in keys_set(entry):
            if key == _SIZE:
                yield (name, i, key), fault("is set", "maps of the sizes in advise.resolutions", "set it there")
            elif not any(key == start or key.startswith(f"{start}.") for start in _OF_A_TECHNIQUE):
                what = fault("is the same for all techniques", f"keys of {listing(_OF_A_TECHNIQUE)}", "remove it")
                yield (name, i, key), what
        parameters = entry.get(PARAMETERS, {})
        if not isinstance(parameters, Mapping):
            mend = "write 'bias.slope: {lower: 0, upper: 9}'"
            yield (name, i, PARAMETERS), fault(f"is {show(parameters)}", "a section of bounds by key", mend)
            continue
        for key in filter(is_pose, parameters):
            what = fault("moves the scene", "numbers of a technique, because all have the same truth", "remove it")
            yield (name, i, PARAMETERS, key), what


def _all_set(entry: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    yield from (((key,), key) for key in keys_set(entry))
    parameters = entry.get(PARAMETERS)
    for key in parameters if isinstance(parameters, Mapping) else ():
        yield (PARAMETERS, key), f"{PARAMETERS} {key}"
