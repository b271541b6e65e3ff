"""Quantities and faults of the schema of `result.json`."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from ...settings.quantities import MAX_TEXELS

_LONGEST_SHOWN = 60
DISAGREES = "disagrees"
"""The type of a fault between keys."""
SLACK = 1e-3
"""How far rounding may move an error or a visibility out of its range."""

Fraction = Annotated[float, Field(ge=-SLACK, le=1 + SLACK)]
Similarity = Annotated[float, Field(ge=-1 - SLACK, le=1 + SLACK)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Side = Annotated[int, Field(ge=1, le=MAX_TEXELS)]
Seconds = Annotated[float, Field(ge=0, le=1e12)]
# The range of float32, in which fits are computed.
Single = Annotated[float, Field(ge=-3.4e38, le=3.4e38)]
Numbers = dict[str, Single]


class Part(BaseModel):
    """A part of a result. Values are not coerced, and every number is finite."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)


def disagrees(key: str, given: str, expected: str) -> PydanticCustomError:
    """A fault between keys: which key, what was given, and what was expected."""
    words = {"key": key, "given": given, "expected": expected}
    return PydanticCustomError(DISAGREES, "{key}: {given}; expected {expected}", words)


def listed(names: Mapping[str, Any]) -> str:
    """Names in a sentence."""
    return short(", ".join(names) or "nothing")


def short(text: str) -> str:
    """Text that is cut where it is too long for a sentence."""
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}…"
