"""What the schema says of a key: its type in plain words, its unit, its place among the others."""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from .._errors import KeyPath, dotted, listing
from ..sections._marks import Limits, bare, is_union, marked
from ..sections._section import Form, Section, Unit, type_of
from ..whole._schema import Config


@dataclass(frozen=True)
class Slot:
    """A value of the schema.

    - `kind`: its bare type.
    - `marks`: what its annotation says besides.
    - `field`: that holds it.
    - `siblings`: the variants, itself among them, of which `kind` is one.
    """

    kind: Any
    marks: tuple[Any, ...] = ()
    field: FieldInfo | None = None
    siblings: tuple[type[Section], ...] = ()

    @property
    def variants(self) -> tuple[type[Section], ...]:
        """The sections that may stand here; none where no section may."""
        kinds = (bare(kind)[0] for kind in get_args(self.kind)) if is_union(self.kind) else (self.kind,)
        return tuple(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section))

    @property
    def unit(self) -> str:
        """The value's unit, or nothing."""
        return next((mark.name for mark in self.marks if isinstance(mark, Unit)), "")

    @property
    def choices(self) -> tuple[str, ...]:
        """The words to choose from; none where the value is no choice."""
        if len(self.variants) > 1:
            return tuple(type_of(variant) for variant in self.variants)
        return tuple(map(str, get_args(self.kind))) if get_origin(self.kind) is Literal else ()

    @property
    def default(self) -> Any:
        """The value where none is given; `None` where there is none, or it is a whole section."""
        value = None if self.field is None else self.field.default
        return None if value is PydanticUndefined else value

    def expected(self) -> str:
        """The values that may stand here, in plain words."""
        form = next((mark.words for mark in self.marks if isinstance(mark, Form)), None)
        unit = f", in {self.unit}" if self.unit else ""
        if form is not None:
            return f"{form}{unit}"
        if self.choices:
            return listing(self.choices)
        if self.variants:
            return f"a section with {_with_keys(self.variants[0])}"
        words = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
        return f"{words.get(self.kind, 'a section')}{_limits(self.marks)}{unit}"


ROOT = Slot(Config)


@dataclass(frozen=True)
class Found:
    """Where a location leads: the path of keys, what may stand there, and the section that holds it.

    `slot` is `None` for a key that the schema does not have; `section` is `None` where a list or a dict holds the
    value, and one of `variants` where the section has several.
    """

    path: KeyPath
    slot: Slot | None
    section: type[Section] | None
    variants: tuple[type[Section], ...]


def follow(location: Sequence[str | int]) -> Found:
    """Reads one of pydantic's locations, in which names of variants stand between the keys."""
    path: KeyPath = ()
    slot: Slot | None = ROOT
    section: type[Section] | None = None
    variants: tuple[type[Section], ...] = ()
    for step in location:
        among = slot.variants if slot is not None else ()
        chosen = next((variant for variant in among if len(among) > 1 and type_of(variant) == step), None)
        if slot is not None and chosen is not None:
            slot = Slot(chosen, slot.marks, slot.field, among)
            continue
        # A fault that the section round this one finds names no variant, so any that has the key serves.
        section = next((variant for variant in among if step in variant.model_fields), among[0] if among else None)
        variants = (slot.siblings or among) if slot is not None else ()
        path = (*path, step)
        slot = None if slot is None else _inside(slot, step)
    return Found(path, slot, section, variants)


def keys_of(section: type[Section]) -> list[str]:
    """The keys of `section`, `type` first."""
    return sorted(section.model_fields, key=lambda key: key != "type")


def slot_of(field: FieldInfo) -> Slot:
    """What the schema says of `field`'s value."""
    return Slot(*marked(field), field)


def _all_keys(slot: Slot = ROOT, path: KeyPath = ()) -> Iterator[KeyPath]:
    """The path of every key in the schema; a list's entries are numbered 0."""
    for variant in slot.variants:
        for key, field in variant.model_fields.items():
            inner = slot_of(field)
            yield (*path, key)
            if get_origin(inner.kind) is tuple and (entry := _inside(inner, 0)) is not None and entry.variants:
                yield from _all_keys(entry, (*path, key, 0))
            yield from _all_keys(inner, (*path, key))


def places_of(key: str) -> tuple[str, ...]:
    """Where the schema has a key of this name, each place once, dotted."""
    return tuple(dict.fromkeys(dotted(path) for path in _every_key() if path[-1] == key))


@functools.cache
def _every_key() -> tuple[KeyPath, ...]:
    return tuple(_all_keys())


def _inside(slot: Slot, step: str | int) -> Slot | None:
    if slot.variants:
        field = next((v.model_fields[str(step)] for v in slot.variants if step in v.model_fields), None)
        return None if field is None else slot_of(field)
    arguments = get_args(slot.kind)
    if get_origin(slot.kind) is tuple and isinstance(step, int):
        entry = arguments[0] if arguments[-1] is Ellipsis else arguments[step]
    elif get_origin(slot.kind) is dict:
        entry = arguments[1]
    else:
        return None
    kind, marks = bare(entry)
    units = (mark for mark in slot.marks if isinstance(mark, Unit))
    return Slot(kind, (*marks, *units))


def _limits(marks: Sequence[Any]) -> str:
    limits = Limits.of(marks)
    words = " and ".join(word for word in (limits.least, limits.most) if word)
    return f" {words}" if words else ""


def _with_keys(section: type[Section]) -> str:
    keys = keys_of(section)
    return f"the key {keys[0]}" if len(keys) == 1 else f"the keys {', '.join(keys)}"
