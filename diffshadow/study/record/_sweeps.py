"""Records of many runs: sweeps, recommendations, and their summaries of single runs."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ...config import SweepConfig
from ...settings.engines import EngineName
from ._parts import Count, Fraction, Numbers, Part, Positive, Seconds, Single, absent, check_keys, disagrees, short


class ManyRuns(Part):
    """The fields that the records of sweeps and recommendations have. `runs`, `done`, `failed`: the number of all runs,
    of finished runs, and of failed runs."""

    schema_version: Count = 0
    name: str = Field(min_length=1)
    source: str = ""
    runs: Count = 0
    done: Count = 0
    failed: Count = 0
    settings: SweepConfig
    versions: dict[str, str] = {}
    command: str = ""


class SweepRecord(ManyRuns):
    """The record of a sweep."""

    kind: Literal["sweep"] = "sweep"


class Candidate(Part):
    """A fitted technique.

    - `id`: the id of its run; `bias`, `filter`: the labels of its entries; `resolution`: the resolution of its map, in
      texels.
    - `values`: the fitted numbers, by the key that sets them; `units`: the units of these numbers.
    - `rmse`, `false_shadow`, `false_light`: its errors over the validation, or over the fitted views if there is none.
    - `fit_rmse`: RMSE over the fitted views.
    - `map_ms`, `lookup_ms`: milliseconds to draw the maps of one view and to look them up.
    - `ratio`: its time relative to the fastest candidate; `spread`: the uncertainty of `ratio` as a fraction of it.
    - `front`: whether no other candidate is faster with an error as small.
    """

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
    spread: Positive = 0.0
    front: bool = False

    @property
    def ms(self) -> float:
        """Milliseconds for one view."""
        return self.map_ms + self.lookup_ms

    @property
    def times(self) -> str:
        """Its time relative to the fastest candidate, with its uncertainty."""
        return f"{self.ratio:.2f} ± {self.ratio * self.spread:.2f}"

    @property
    def size(self) -> str:
        """The map's resolution in texels, in words."""
        height, width = self.resolution
        return f"{height}²" if height == width else f"{height} × {width}"

    @property
    def name(self) -> str:
        """Its name in sentences."""
        return f"{self.bias} with {self.filter} at {self.size}"

    @model_validator(mode="after")
    def _agrees(self) -> "Candidate":
        check_keys("units", self.units, "values", self.values)
        return self


class Advice(Part):
    """`engine`, `code`: for advice on an engine, its name and its code for each light."""

    engine: EngineName | None = None
    code: dict[str, str] = {}
    over: str
    noise: Fraction | None
    within: Fraction
    recommended: str
    candidates: list[Candidate] = Field(min_length=1)
    verdict: list[str]
    problems: list[str]

    @model_validator(mode="after")
    def _agrees(self) -> "Advice":
        if self.recommended not in (each.id for each in self.candidates):
            raise disagrees("recommended", f"is {short(self.recommended)}", "the id of a candidate")
        return self


class AdviseRecord(ManyRuns):
    """The record of a recommendation. `advice`: advice from all fits; `None` before they are finished."""

    kind: Literal["advise"] = "advise"
    advice: Advice | None = absent()


class Times(Part):
    """Times of a technique for one view with all its lights.

    - `map_ms`, `lookup_ms`: in milliseconds.
    - `ratio`: its time divided by the fastest technique's time.
    - `spread`: the uncertainty of the ratio in either direction, as a fraction of it. It is half of the interval that
      contains the true median with a probability of 95 %.
    """

    map_ms: Seconds
    lookup_ms: Seconds
    ratio: Seconds
    spread: Positive


class Load(Part):
    """The load of the machine while techniques were timed.

    - `others`: the fraction of all processors' time that other processes used; `None` if the system does not report it.
    - `unevenness`: half of the interquartile range of the times of rounds, as a fraction of their median.
    """

    others: Fraction | None
    unevenness: Positive


class LeastBias(Part):
    """The lowest bias that keeps false shadow within a limit.

    - `value`: the bias in its unit. If no bias keeps the limit, the bias with the lowest false shadow.
    - `false_shadow`, `false_light`: its errors.
    """

    value: Single
    false_shadow: Fraction
    false_light: Fraction


class Measurements(Part):
    """The measurements of a recommendation: times of techniques, by `ids` of their runs; the load of the machine; and
    biases, by pairs of techniques."""

    ids: list[str]
    times: list[Times]
    load: Load
    least_biases: dict[str, LeastBias]

    @model_validator(mode="after")
    def _agrees(self) -> "Measurements":
        if len(self.ids) != len(self.times):
            raise disagrees("times", f"are {len(self.times)}", f"{len(self.ids)}, the number of ids")
        return self


class Outcome(Part):
    """A run of a sweep: status `"ok"` or `"failed"`, with metrics or an error, and the seconds of its stages."""

    schema_version: Count = 0
    id: str
    status: Literal["ok", "failed"]
    error: str | None
    metrics: dict[str, Annotated[int, Field(ge=0, lt=2**53)] | Single | None]
    seconds: dict[str, Seconds]
    files: list[str] = []
