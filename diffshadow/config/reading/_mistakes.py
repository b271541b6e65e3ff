"""Translates pydantic's errors into messages for the author of a configuration."""

import re
from collections.abc import Iterable
from typing import Any

from pydantic import ValidationError

from .._errors import KeyPath, Mistake, Origin, did_you_mean, dotted, listing, nearest, show
from ..sections._section import FAULT, Conflict, fault, type_of, value_at
from ._keys import ROOT, FollowedPath, Slot, follow, keys_of, places_of

_NUMBER_IN_TEXT = re.compile(r"[-+]?(\d[\d_]*)?[.,]?\d+([eE][-+]?\d+)?")
# Beyond this, not every whole number is a float.
_MAX_COUNTED = 2**53
_SWITCHES = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false", "n": "false"}


def mistakes_of(error: ValidationError, origin: Origin) -> list[Mistake]:
    """Every fault in `error`, with the place where it was written."""
    mistakes = []
    for details in error.errors(include_url=False):
        path, message = _explain(details, origin)
        mistakes.append(Mistake(origin.place(path), dotted(path), message))
    return mistakes


def mistakes_at(conflicts: Iterable[Conflict], origin: Origin) -> list[Mistake]:
    """The mistakes of `conflicts`, with the places where their keys were written."""
    return [Mistake(origin.place(path), dotted(path), what.message()) for path, what in conflicts]


def _explain(details: Any, origin: Origin) -> tuple[KeyPath, str]:
    found = follow(details["loc"])
    path, slot = found.path, found.slot or ROOT
    match details["type"]:
        case kind if kind == FAULT:
            return path, fault(**details["ctx"]).message()
        case "extra_forbidden":
            return path, _unknown_key(found, origin)
        case "missing":
            return path, f"is missing; expected {slot.expected()}; add it: {_description(slot)}"
        case "union_tag_invalid" | "union_tag_not_found":
            return (*path, "type"), _wrong_value(value_at(details["input"], "type"), slot)
        case _:
            return path, _wrong_value(details["input"], slot)


def _unknown_key(found: FollowedPath, origin: Origin) -> str:
    key, section = str(found.path[-1]), dotted(found.path[:-1])
    holder = found.section or ROOT.variants[0]
    keys = keys_of(holder)
    has_variants = len(found.variants) > 1 or holder.plugin is not None
    kind = f" (type: {type_of(holder)})" if has_variants else ""
    message = f"is not a key of {section or 'the top level'}{kind}; expected {listing(keys)}"
    owners = [type_of(variant) for variant in found.variants if key in variant.model_fields]
    if owners and origin.place(found.path).line is not None and origin.place((*found.path[:-1], "type")).line is None:
        # The type comes from an override, which cannot remove keys of the file.
        return f"{message}; override the whole section: {section}={{type: {type_of(holder)}, …}}"
    if owners:
        return f"{message}; remove it, or set {section}.type to {listing(owners)}"
    suggestions = places_of(key)
    if not suggestions and (near := nearest(key, keys)):
        suggestions = (near,)
    return f"{message}; did you mean {listing(map(repr, suggestions))}?" if suggestions else f"{message}; remove it"


def _wrong_value(value: Any, slot: Slot) -> str:
    return f"is {show(value)}; expected {slot.expected()}; {_remedy(value, slot)}"


def _remedy(value: Any, slot: Slot) -> str:
    if value is None:
        mend = "remove the key to get its default" if _has_default(slot) else "give it a value"
        return f"write {{type: none}}, or {mend}" if "none" in map(type_of, slot.siblings) else mend
    if slot.form is not None and slot.form.example:
        return f"write a list such as {slot.form.example}"
    if slot.choices:
        return did_you_mean(value, map(str, slot.choices), "choose one of these")
    if slot.kind is bool and str(value).lower() in _SWITCHES:
        return f"write {_SWITCHES[str(value).lower()]}"
    if slot.kind in (int, float) and isinstance(value, str) and _NUMBER_IN_TEXT.fullmatch(value):
        point = ", with a decimal point" if slot.kind is float else ""
        return f"write it without quotes{point} and without other characters between the digits"
    if slot.kind is int and isinstance(value, float) and value.is_integer() and abs(value) < _MAX_COUNTED:
        return f"write {int(value)}"
    if slot.kind is str:
        return "put it in quotes" if isinstance(value, int | float) else "write text"
    if slot.variants:
        word = nearest(value, map(type_of, slot.siblings)) if isinstance(value, str) else None
        return "write its keys below it, indented" if word is None else f"write {{type: {word}}}"
    if isinstance(slot.default, int | float):
        return f"give such a value (the default is {show(slot.default)})"
    return "give such a value"


def _has_default(slot: Slot) -> bool:
    return slot.field is not None and not slot.field.is_required()


def _description(slot: Slot) -> str:
    return slot.meaning or (slot.field.description if slot.field is not None else None) or "a value"
