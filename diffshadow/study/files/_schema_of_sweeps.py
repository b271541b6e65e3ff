"""The schema of the results of many runs: sweeps, recommendations, and what these keep of each run."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ...config import SweepConfig
from ...settings.engines import EngineName
from ._schema_parts import Count, Fraction, Numbers, Part, Seconds, Single, disagrees, listed, short


class Sweep(Part):
    """`runs`: how many there are; so many of them are `done` and `failed`."""

    schema_version: Count = 0
    kind: Literal["sweep"]
    name: str = Field(min_length=1)
    source: str = ""
    runs: Count = 0
    done: Count = 0
    failed: Count = 0
    settings: SweepConfig
    versions: dict[str, str] = {}
    command: str = ""


class _Candidate(Part):
    id: str
    bias: str
    filter: str
    resolution: Annotated[list[Count], Field(min_length=2, max_length=2)]
    values: Numbers
    units: dict[str, str]
    rmse: Fraction
    false_shadow: Fraction
    false_light: Fraction
    fit_rmse: Fraction
    map_ms: Seconds
    lookup_ms: Seconds
    ratio: Seconds
    spread: Annotated[float, Field(ge=0)] = 0.0
    front: bool

    @model_validator(mode="after")
    def _agrees(self) -> "_Candidate":
        if list(self.values) != list(self.units):
            raise disagrees("units", f"has the keys {listed(self.units)}", f"the keys of values, {listed(self.values)}")
        return self


class _Advice(Part):
    """`engine`, `code`: of advice for an engine, which it is, and its code for each light."""

    engine: EngineName | None = None
    code: dict[str, str] = {}
    over: str
    noise: Fraction | None
    within: Fraction
    recommended: str
    candidates: list[_Candidate] = Field(min_length=1)
    verdict: list[str]
    problems: list[str]

    @model_validator(mode="after")
    def _agrees(self) -> "_Advice":
        if self.recommended not in (each.id for each in self.candidates):
            raise disagrees("recommended", f"is {short(self.recommended)}", "the id of a candidate")
        return self


class Advise(Sweep):
    """`advice`: of all fits; not there before they are done."""

    kind: Literal["advise"]  # type: ignore[assignment]
    advice: _Advice | None = None


class _Times(Part):
    map_ms: Seconds
    lookup_ms: Seconds
    ratio: Seconds
    spread: Annotated[float, Field(ge=0)]


class _Load(Part):
    others: Fraction | None
    unevenness: Annotated[float, Field(ge=0)]


class _LeastBias(Part):
    value: Single
    false_shadow: Fraction
    false_light: Fraction


class Measurements(Part):
    """Of a recommendation: times of techniques by `ids` of their runs, how busy the machine was meanwhile, and biases
    by pairs of these."""

    ids: list[str]
    times: list[_Times]
    load: _Load
    least_biases: dict[str, _LeastBias]


class Outcome(Part):
    """Of a run of a sweep."""

    schema_version: Count = 0
    files: list[str] = []
    id: str
    status: Literal["ok", "failed"]
    error: str | None
    metrics: dict[str, Annotated[int, Field(ge=0, lt=2**53)] | Single | None]
    seconds: dict[str, Seconds]
