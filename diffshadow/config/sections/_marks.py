"""Splits an annotation into its bare type and its marks, such as limits."""

import types
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo


def bare(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """The type in `annotation`, without marks and `None`; and the marks."""
    if get_origin(annotation) is Annotated:
        inside, *marks = get_args(annotation)
        kind, inner = bare(inside)
        return kind, (*_flat(marks), *inner)
    if is_union(annotation):
        others = [kind for kind in get_args(annotation) if kind is not types.NoneType]
        if len(others) == 1:
            return bare(others[0])
    return annotation, ()


def marked(field: FieldInfo) -> tuple[Any, tuple[Any, ...]]:
    """The bare type of `field`, and all of its marks."""
    kind, marks = bare(field.annotation)
    return kind, (*_flat(field.metadata), *marks)


def is_union(annotation: Any) -> bool:
    """Whether `annotation` is a union."""
    return get_origin(annotation) in (Union, types.UnionType)


class Limits(NamedTuple):
    """The limits of a number. `above_low` and `below_high` exclude the limits themselves."""

    low: int | float | None = None
    high: int | float | None = None
    above_low: bool = False
    below_high: bool = False

    @classmethod
    def of(cls, marks: Sequence[Any]) -> "Limits":
        """The tightest limits among `marks`."""
        low, high = cls(), cls()
        for mark in marks:
            match mark:
                case Ge(ge=bound) | Gt(gt=bound) if isinstance(bound, int | float):
                    if low.low is None or bound > low.low:
                        low = cls(low=bound, above_low=isinstance(mark, Gt))
                case Le(le=bound) | Lt(lt=bound) if isinstance(bound, int | float):
                    if high.high is None or bound < high.high:
                        high = cls(high=bound, below_high=isinstance(mark, Lt))
        return cls(low.low, high.high, low.above_low, high.below_high)

    @property
    def least(self) -> str:
        """The lower limit in words; empty if there is none."""
        return "" if self.low is None else f"{'greater than' if self.above_low else 'at least'} {_text(self.low)}"

    @property
    def most(self) -> str:
        """The upper limit in words; empty if there is none."""
        return "" if self.high is None else f"{'less than' if self.below_high else 'at most'} {_text(self.high)}"

    def undercut_by(self, value: int | float) -> bool:
        """Whether `value` is below the lower limit."""
        return self.low is not None and (value <= self.low if self.above_low else value < self.low)

    def exceeded_by(self, value: int | float) -> bool:
        """Whether `value` is above the upper limit."""
        return self.high is not None and (value >= self.high if self.below_high else value > self.high)


def _text(limit: int | float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _flat(marks: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(inner for mark in marks for inner in (mark.metadata if isinstance(mark, FieldInfo) else (mark,)))
