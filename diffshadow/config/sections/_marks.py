"""The type and the marks of a key."""

from collections.abc import Sequence
from typing import Any

from pydantic.fields import FieldInfo

from ...settings import bare


def marked(field: FieldInfo) -> tuple[Any, tuple[Any, ...]]:
    """The bare type of `field`, and all of its marks."""
    kind, marks = bare(field.annotation)
    return kind, _flat((*field.metadata, *marks))


def _flat(marks: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(inner for mark in marks for inner in (mark.metadata if isinstance(mark, FieldInfo) else (mark,)))
