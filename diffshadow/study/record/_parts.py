"""The parts of records: quantities with their ranges, and faults between keys."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from ...settings.quantities import MAX_TEXELS

_LONGEST_SHOWN = 60
DISAGREES = "disagrees"
"""The type of a fault between keys."""
SLACK = 1e-3
"""The distance by which rounding may move an error or a visibility out of its range."""

Fraction = Annotated[float, Field(ge=-SLACK, le=1 + SLACK)]
Similarity = Annotated[float, Field(ge=-1 - SLACK, le=1 + SLACK)]
Positive = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Side = Annotated[int, Field(ge=1, le=MAX_TEXELS)]
Seconds = Annotated[float, Field(ge=0, le=1e12)]
# The range of float32, in which fits are computed.
Single = Annotated[float, Field(ge=-3.4e38, le=3.4e38)]
Numbers = dict[str, Single]


def absent(default: Any = None) -> Any:
    """The default of a key that is omitted if it has this value."""
    return Field(default=default, exclude_if=lambda value: value == default)


class Part(BaseModel):
    """A part of a record, as it is made, written to `result.json` and read again.

    Values are not coerced. Every number is finite: other numbers become `None`. Unknown keys are ignored, because a
    later version or a user may have added them.
    """

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)

    @classmethod
    def of(cls, source: Any, **more: Any) -> Self:
        """A part that takes each of its fields from `more`, or otherwise from the attribute of `source` with the same
        name."""
        names = [name for name in cls.model_fields if name not in more and hasattr(source, name)]
        return cls(**{name: getattr(source, name) for name in names}, **more)

    @model_validator(mode="before")
    @classmethod
    def _made_plain(cls, given: Any) -> Any:
        # The results of `fit` have parts of their own, which are named tuples.
        return plain(given._asdict() if hasattr(given, "_asdict") else given)


def plain(value: Any) -> Any:
    """`value` in a form that JSON can store. Non-finite numbers become `None`, and lone surrogates are escaped."""
    if isinstance(value, str):
        # Python uses lone surrogates for bytes of paths that are not UTF-8.
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {plain(str(key)): plain(inner) for key, inner in value.items()}
    # A named tuple becomes a part.
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return [plain(inner) for inner in value]
    return value


def check_keys(key: str, numbers: Mapping[str, Any], of: str, expected: Mapping[str, Any]) -> None:
    """**Raises** a fault unless the `numbers` at `key` have the same keys as the numbers at `of`."""
    if list(numbers) != list(expected):
        theirs = short(", ".join(expected) or "nothing")
        has = f"has the keys {short(', '.join(numbers) or 'nothing')}"
        raise disagrees(key, has, f"the keys of {of}, {theirs}")


def disagrees(key: str, given: str, expected: str) -> PydanticCustomError:
    """A fault between keys: the key, the given value, and the expected value."""
    words = {"key": key, "given": given, "expected": expected}
    return PydanticCustomError(DISAGREES, "{key}: {given}; expected {expected}", words)


def short(text: str) -> str:
    """`text`, cut if it is too long for a sentence."""
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}…"
