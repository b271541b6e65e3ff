"""Finds keys in the schema: their types in plain words, units and paths."""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from ...settings import InputFile, Setting, Unit, bare
from .._errors import KeyPath, dotted
from ..sections._config import Config
from ..sections._section import Section, Variants, marked, type_of


@dataclass(frozen=True)
class Slot(Setting):
    """A value of the schema.

    - `field`: the field that contains it.
    - `siblings`: all variants of the section, if it is one of them.
    """

    field: FieldInfo | None = None
    siblings: tuple[type[Section], ...] = ()

    @property
    def variants(self) -> tuple[type[Section], ...]:
        """The sections that are valid here. Empty if the value is not a section."""
        if self._named is not None:
            return tuple(self._named.sections.values())
        return (self.kind,) if isinstance(self.kind, type) and issubclass(self.kind, Section) else ()

    def variant(self, word: str | int) -> type[Section] | None:
        """The variant named `word`, if a type selects variants."""
        return None if self._named is None else self._named.named(word)

    @property
    def _named(self) -> Variants | None:
        return next((mark for mark in self.marks if isinstance(mark, Variants)), None)

    @property
    def choices(self) -> tuple[Any, ...]:
        return super().choices if self._named is None else tuple(map(type_of, self.variants))

    def expected(self, unit: str | None = None) -> str:
        is_section = len(self.variants) == 1 and self._named is None and self.form is None
        return f"a section with {_with_keys(self.variants[0])}" if is_section else super().expected(unit)


ROOT = Slot(Config)


@dataclass(frozen=True)
class FollowedPath:
    """The result of `follow`: the path of keys, the value's slot in the schema, and the section that contains it.

    `slot` is `None` for a key that is not in the schema. `section` is `None` if a list or a dict contains the value. If
    the section has several variants, `section` is one of `variants`.
    """

    path: KeyPath
    slot: Slot | None
    section: type[Section] | None
    variants: tuple[type[Section], ...]


def follow(location: Sequence[str | int]) -> FollowedPath:
    """Resolves a location of pydantic, which contains the names of variants between keys."""
    path: KeyPath = ()
    slot: Slot | None = ROOT
    section: type[Section] | None = None
    variants: tuple[type[Section], ...] = ()
    for step in location:
        among = slot.variants if slot is not None else ()
        chosen = None if slot is None else slot.variant(step)
        if slot is not None and chosen is not None:
            slot = Slot(chosen, field=slot.field, siblings=among)
            continue
        # A fault found by the enclosing section does not name a variant, so any variant with the key will do.
        section = next((variant for variant in among if step in variant.model_fields), among[0] if among else None)
        variants = (slot.siblings or among) if slot is not None else ()
        path = (*path, step)
        slot = None if slot is None else _inside(slot, step)
    return FollowedPath(path, slot, section, variants)


@functools.cache
def keys_of(section: type[Section]) -> tuple[str, ...]:
    """The keys of `section`, with `type` first."""
    return tuple(sorted(section.model_fields, key=lambda key: key != "type"))


def slot_of(field: FieldInfo) -> Slot:
    """The slot of `field`."""
    default = None if field.default is PydanticUndefined else field.default
    return Slot(*marked(field), default, field=field)


def _all_keys(slot: Slot = ROOT, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Slot]]:
    """The path and the slot of every key in the schema. Entries of lists have the index 0."""
    for variant in slot.variants:
        for key, field in variant.model_fields.items():
            inner = slot_of(field)
            yield (*path, key), inner
            if get_origin(inner.kind) is tuple and (entry := _inside(inner, 0)) is not None and entry.variants:
                yield from _all_keys(entry, (*path, key, 0))
            yield from _all_keys(inner, (*path, key))


@functools.cache
def file_marks() -> dict[str, InputFile]:
    """The mark of each key that names an input file, by its dotted path without indices."""
    marks = (([step for step in path if step != 0], mark) for path, slot in _all_keys() for mark in slot.marks)
    return {dotted(path): mark for path, mark in marks if isinstance(mark, InputFile)}


def places_of(key: str) -> tuple[str, ...]:
    """The distinct dotted paths of all keys in the schema with this name."""
    return tuple(dict.fromkeys(dotted(path) for path in _every_key() if path[-1] == key))


def is_key(name: str) -> bool:
    """Whether the dotted key `name` exists in some configuration. An index is valid for a list of any length."""
    path: KeyPath = tuple(0 if word.isdecimal() else word for word in name.split("."))
    known = _every_key()
    # The numbers of a list have no keys.
    return path in known or (path[-1] == 0 and path[:-1] in known)


@functools.cache
def _every_key() -> tuple[KeyPath, ...]:
    return tuple(path for path, _ in _all_keys())


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


def _with_keys(section: type[Section]) -> str:
    keys = keys_of(section)
    return f"the key {keys[0]}" if len(keys) == 1 else f"the keys {', '.join(keys)}"
