"""The schema of `result.json`, checked as strictly as a configuration, so that readers can rely on it.

Unknown keys are ignored, since a later version or a user may have added them.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError, from_json

from ... import io
from ...config import SweepConfig
from ...settings.engines import EngineName
from ...settings.quantities import MAX_TEXELS
from ...settings.reference import Encoding

# Far more than any run writes.
_MAX_BYTES = 64 << 20
_LONGEST_SHOWN = 60
_DISAGREES = "disagrees"
_PYDANTIC = "Input should be "
# Plain words for pydantic's messages, which name Python's types.
_EXPECTED = {
    "model_type": "a section with keys",
    "dict_type": "a section with keys",
    "list_type": "a list",
    "string_type": "text",
    "int_type": "a whole number",
    "float_type": "a number",
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
}
SLACK = 1e-3
"""How far rounding may move an error or a visibility out of its range."""

Fraction = Annotated[float, Field(ge=-SLACK, le=1 + SLACK)]
Similarity = Annotated[float, Field(ge=-1 - SLACK, le=1 + SLACK)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
_Side = Annotated[int, Field(ge=1, le=MAX_TEXELS)]
Seconds = Annotated[float, Field(ge=0, le=1e12)]
# The range of float32, in which fits are computed.
Single = Annotated[float, Field(ge=-3.4e38, le=3.4e38)]
Numbers = dict[str, Single]


class _Part(BaseModel):
    """A part of a result. Values are not coerced, and every number is finite."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)


class _Errors(_Part):
    """Errors of one state, over all lights; `flip`, of the shaded picture, is `None` if it was not measured."""

    rmse: Fraction
    mae: Fraction
    ssim: Similarity
    false_shadow_rate: Fraction
    false_light_rate: Fraction
    flip: Fraction | None = None


class _LightErrors(_Part):
    """Errors of one state under one light; `None` if no pixel counts."""

    rmse: Fraction | None
    mae: Fraction | None
    ssim: Similarity | None
    false_shadow_rate: Fraction | None
    false_light_rate: Fraction | None


class _Extents(_Part):
    """Figures of the extents of texels, in pixels."""

    worst: Annotated[float, Field(ge=0)]
    percentile_99: Annotated[float, Field(ge=0)]
    mean_log2: Single
    undersampled: Fraction


class _Aliasing(_Part):
    extent: _Extents
    perspective: _Extents


class _RenderedLight(_Part):
    light: str
    errors: _LightErrors
    aliasing: _Aliasing | None = None
    reference_noise_floor: Fraction | None = None
    pixels: Count | None = None


class _FittedLight(_Part):
    """`validation`: whether the fit has not seen it."""

    light: str
    before: _LightErrors
    after: _LightErrors
    validation: bool = False


class _BeforeAndAfter(_Part):
    before: _Errors
    after: _Errors


class _Metrics(_Part):
    compare: str
    reference_noise_floor: Fraction | None
    pixels: Count


class _RenderMetrics(_Metrics):
    technique: str = ""
    errors: _Errors
    lights: list[_RenderedLight] = Field(min_length=1)


class _FitMetrics(_Metrics):
    """`shown`: for fits over views, the indices of views that have pictures, the worst first. `resolution`: (height,
    width) of the images, of a fit without a configuration."""

    before: _Errors
    after: _Errors
    lights: list[_FittedLight] = Field(min_length=1)
    validation: _BeforeAndAfter | None = None
    shown: list[Count] | None = None
    resolution: Annotated[list[_Side], Field(min_length=2, max_length=2)] | None = None


class _Bounds(_Part):
    lower: Single
    upper: Single
    unit: str


class _Phase(_Part):
    width: float = Field(ge=0)
    steps: Count
    result: str
    gradient_norm: Annotated[float, Field(ge=0)] | None
    # A user's loss may be greater than 1.
    hard_loss: Annotated[float, Field(ge=0)] | None
    values: Numbers
    blur: float = Field(default=0.0, ge=0)
    searched: float = Field(default=0.0, ge=0, le=1)


class _Solver(_Part):
    """`flat`: the parameters without a gradient; `is_own_loss`: whether losses are of a user's own loss;
    `initial_loss`: its value at the start, under the hard compare; none where lights or meshes move."""

    name: str = ""
    steps: Count
    chosen_phase: int = Field(ge=-1)
    flat: list[str] = []
    is_own_loss: bool = False
    initial_loss: Annotated[float, Field(ge=0)] | None = None
    seconds_compiling: Seconds | None = None
    seconds_running: Seconds | None = None
    phases: list[_Phase]


class _Precision(_Part):
    """As `fit.Precision`."""

    names: list[str] = []
    deviations: dict[str, float | None] = {}
    correlations: list[list[float | None]] = []
    undetermined: list[list[str]] = []


class _Start(_Part):
    initial: Numbers
    end: Numbers = {}
    loss: Annotated[float, Field(ge=0)] | None


class _Poses(_Part):
    truth: Numbers = {}
    error: Numbers = {}
    precision: _Precision | None = None
    starts: list[_Start] | None = None
    enlargements: Count = 0


class _At(_Part):
    value: Single
    error: Annotated[float, Field(ge=0)]


class _End(_At):
    is_bound: bool


class _Interval(_Part):
    within: Annotated[float, Field(gt=0)]
    lower: _End
    upper: _End


class _Profile(_Part):
    """The error along a parameter, (value, error) in order of the values, and where it is close to the best."""

    best: _At
    points: list[Annotated[list[Single | None], Field(min_length=2, max_length=2)]]
    intervals: list[_Interval]


class _FrontPoint(_Part):
    """A setting, its roots of the mean square of what is too dark and too light, and of all errors."""

    values: Numbers
    false_shadow: Annotated[float, Field(ge=0)]
    false_light: Annotated[float, Field(ge=0)]
    rmse: Fraction | None = None
    ratio: Annotated[float, Field(gt=0)] | None = None
    is_knee: bool


class _Verdict(_Part):
    """What a fit comes to, and what to try."""

    kind: str
    sentence: str = Field(min_length=1)
    remedies: list[str] = []
    constant_rmse: Fraction | None = None


class _Run(_Part):
    schema_version: Count = 0
    name: str = Field(min_length=1)
    warnings: list[str] | None = None
    seconds: dict[str, Seconds]
    versions: dict[str, str]
    files: list[str] = []


class _Render(_Run):
    kind: Literal["render"]
    seed: Seed
    command: str
    metrics: _RenderMetrics


class _Fit(_Run):
    """A fit made in Python has neither seed nor command, since it has no configuration."""

    kind: Literal["fit"]
    seed: Seed | None = None
    command: str | None = None
    verdict: _Verdict | None = None
    metrics: _FitMetrics
    initial: Numbers
    fitted: Numbers = Field(min_length=1)
    bounds: dict[str, _Bounds]
    solver: _Solver
    poses: _Poses | None = None
    profiles: dict[str, _Profile] = {}
    front: list[_FrontPoint] = []
    code: dict[str, str] = {}

    @model_validator(mode="after")
    def _agrees(self) -> "_Fit":
        """Checks that all parts have the same parameters and phases."""
        poses = self.poses or _Poses()
        named = {
            "initial": self.initial,
            "bounds": self.bounds,
            **({"profiles": self.profiles} if self.profiles else {}),
            **{f"front.{i}.values": point.values for i, point in enumerate(self.front)},
            **{f"solver.phases.{i}.values": phase.values for i, phase in enumerate(self.solver.phases)},
            **{f"poses.starts.{i}.initial": start.initial for i, start in enumerate(poses.starts or ())},
        }
        for key, numbers in named.items():
            if list(numbers) != list(self.fitted):
                raise _fault(key, f"has the keys {_listed(numbers)}", f"the keys of fitted, {_listed(self.fitted)}")
        for name, bounds in self.bounds.items():
            if bounds.lower >= bounds.upper:
                raise _fault(f"bounds.{name}", f"are {bounds.lower:g} and {bounds.upper:g}", "lower less than upper")
        if any(index >= len(self.metrics.lights) for index in self.metrics.shown or ()):
            raise _fault("metrics.shown", f"is {self.metrics.shown}", f"less than {len(self.metrics.lights)}")
        if (self.seed is None) != (self.command is None):
            raise _fault("command and seed", "are not both there", "both, or neither of a fit made in Python")
        if self.command is None and self.metrics.resolution is None:
            raise _fault("metrics.resolution", "is missing", "the size of the images, since there is no command")
        phases, chosen = len(self.solver.phases), self.solver.chosen_phase
        if chosen >= phases:
            raise _fault("solver.chosen_phase", f"is {chosen}", f"less than {phases}, the number of phases")
        return self


class _Shadow(_Part):
    """How far a shadow overlaps its target, as intersection over union."""

    light: str
    before: Fraction
    map: Fraction
    rays: Fraction


class _UnseenShadow(_Part):
    light: str
    rays: Fraction


class _MovedLight(_Part):
    """How far a light is from its place in the scene, degrees."""

    light: str
    before: Annotated[float, Field(ge=0)]
    after: Annotated[float, Field(ge=0)]


class _ShapeMetrics(_Part):
    """`chamfer`, `size`: world units, if the shape that casts the targets is known.

    `self_intersections`: pairs of faces.
    """

    initial_loss: Annotated[float, Field(ge=0)]
    loss: Annotated[float, Field(ge=0)]
    lights: list[_Shadow] = Field(min_length=1)
    unseen: list[_UnseenShadow] = []
    moved: list[_MovedLight] = []
    self_intersections: Annotated[int, Field(ge=0)] = 0
    chamfer: Annotated[float, Field(ge=0)] | None = None
    size: Annotated[float, Field(gt=0)] | None = None


class _PictureErrors(_Part):
    """`flip` is none without the package that measures it."""

    rmse: Annotated[float, Field(ge=0)]
    mae: Annotated[float, Field(ge=0)]
    flip: Annotated[float, Field(ge=0)] | None = None


class _PictureMetrics(_Part):
    before: _PictureErrors
    after: _PictureErrors
    pixels: Count
    resolution: Annotated[list[Count], Field(min_length=2, max_length=2)]


class _Picture(_Run):
    """A fit made in Python has neither seed nor command, since it has no configuration."""

    kind: Literal["picture"]
    encoding: Encoding
    seed: Seed | None = None
    command: str | None = None
    initial: Numbers
    fitted: Numbers = Field(min_length=1)
    bounds: dict[str, _Bounds]
    truth: Numbers
    deviations: Numbers
    camera: dict[str, Annotated[list[float], Field(min_length=3, max_length=3)]]
    metrics: _PictureMetrics
    steps: Count

    @model_validator(mode="after")
    def _agrees(self) -> "_Picture":
        """Checks that all parts have the same parameters."""
        for key, numbers in (("initial", self.initial), ("bounds", self.bounds)):
            if list(numbers) != list(self.fitted):
                raise _fault(key, f"has the keys {_listed(numbers)}", f"the keys of fitted, {_listed(self.fitted)}")
        return self


class _ShapePhase(_Part):
    steps: Count
    loss: Annotated[float, Field(ge=0)]


class _Shape(_Run):
    kind: Literal["shape"]
    seed: Seed
    command: str
    metrics: _ShapeMetrics
    vertices: Count
    chosen_phase: int = Field(ge=-1)
    phases: list[_ShapePhase]


class _Sweep(_Part):
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


class _Candidate(_Part):
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
            raise _fault("units", f"has the keys {_listed(self.units)}", f"the keys of values, {_listed(self.values)}")
        return self


class _Advice(_Part):
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
            raise _fault("recommended", f"is {_short(self.recommended)}", "the id of a candidate")
        return self


class _Advise(_Sweep):
    """`advice`: of all fits; not there before they are done."""

    kind: Literal["advise"]  # type: ignore[assignment]
    advice: _Advice | None = None


class _Times(_Part):
    map_ms: Seconds
    lookup_ms: Seconds
    ratio: Seconds
    spread: Annotated[float, Field(ge=0)]


class _Load(_Part):
    others: Fraction | None
    unevenness: Annotated[float, Field(ge=0)]


class _LeastBias(_Part):
    value: Single
    false_shadow: Fraction
    false_light: Fraction


class _Measurements(_Part):
    """Of a recommendation: times of techniques by `ids` of their runs, how busy the machine was meanwhile, and biases
    by pairs of these."""

    ids: list[str]
    times: list[_Times]
    load: _Load
    least_biases: dict[str, _LeastBias]


class _Outcome(_Part):
    """Of a run of a sweep."""

    schema_version: Count = 0
    files: list[str] = []
    id: str
    status: Literal["ok", "failed"]
    error: str | None
    metrics: dict[str, Annotated[int, Field(ge=0, lt=2**53)] | Single | None]
    seconds: dict[str, Seconds]


_KINDS: Mapping[str, type[_Part]] = {
    "render": _Render,
    "fit": _Fit,
    "shape": _Shape,
    "picture": _Picture,
    "sweep": _Sweep,
    "advise": _Advise,
}


def read_json(file: Path) -> Any:
    """The content of a JSON file.

    **Raises** `FileError` if it cannot be read, is not JSON, or is far larger than any run's.
    """
    try:
        # Reading anything else, such as a pipe, could block forever.
        if not file.is_file():
            raise io.FileError(f"there is no file {file}; expected what a run wrote: run it again")
        if file.stat().st_size > _MAX_BYTES:
            raise io.FileError(
                f"{file} has {file.stat().st_size:,} bytes; expected at most {_MAX_BYTES:,}: run it again"
            )
        return from_json(file.read_bytes(), allow_inf_nan=False)
    except io.FileError:
        raise
    except (OSError, ValueError) as error:
        raise io.FileError(f"{file} is damaged ({error}); expected what a run wrote: run it again") from error


def write_json(file: Path, value: Any) -> None:
    """Writes `value` to a JSON file, as `read_json` reads it."""
    text = json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    file.write_text(text + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """`value` in a form that JSON can hold: non-finite numbers become null, and lone surrogates are escaped."""
    if isinstance(value, Mapping):
        return {_plain(str(key)): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, str):
        # Python uses lone surrogates for bytes of paths that are not UTF-8.
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def as_stored(result: Mapping[str, Any]) -> dict[str, Any]:
    """What `result.json` holds of a run, a sweep or a recommendation: the keys of the schema, and no other.

    **Raises** `ValidationError` for a key or a value that readers would not take.
    """
    kind = _KINDS.get(result.get("kind", ""), _Outcome)
    stored = kind.model_validate(_plain(result), extra="forbid").model_dump(mode="json", exclude_unset=True)
    # In the order that they were given in, so that a fit's verdict comes first.
    return {key: stored[key] for key in result}


def checked_result(result: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """The known keys of the result of a fit, a render, a sweep or a recommendation. `file` is where it came from.

    **Raises** `FileError` that names the first invalid key.
    """
    try:
        return _KINDS[result["kind"]].model_validate(result).model_dump(exclude_unset=True)
    except ValidationError as error:
        raise io.FileError(f"{file} is damaged: {_first(error)}: run it again") from error


def is_outcome(stored: Any, id: str, kinds: Mapping[str, type], others: tuple[str, ...]) -> bool:
    """Whether `stored` is a valid outcome of the run `id` of a sweep.

    **Arguments:**

    - `stored`: the content of the run's `result.json`.
    - `kinds`: the types of the metrics of a successful run, by name.
    - `others`: the prefixes of the names of further metrics; if empty, there are none.
    """
    try:
        outcome = _Outcome.model_validate(stored)
    except ValidationError:
        return False
    if outcome.id != id or (outcome.status == "ok") != (outcome.error is None):
        return False
    if outcome.status == "failed":
        return not outcome.metrics
    further = outcome.metrics.keys() - kinds.keys()
    return (
        kinds.keys() <= outcome.metrics.keys()
        and all(outcome.metrics[name] is None or isinstance(outcome.metrics[name], kinds[name]) for name in kinds)
        and all(name.startswith(others) for name in further)
    )


def are_measurements(stored: Any) -> bool:
    """Whether `stored` is what a recommendation keeps of its measurements."""
    try:
        found = _Measurements.model_validate(stored)
    except ValidationError:
        return False
    return len(found.ids) == len(found.times)


def _fault(key: str, given: str, expected: str) -> PydanticCustomError:
    words = {"key": key, "given": given, "expected": expected}
    return PydanticCustomError(_DISAGREES, "{key}: {given}; expected {expected}", words)


def _first(error: ValidationError) -> str:
    """The first fault in words, and the number of further ones."""
    details = error.errors(include_url=False)
    first, more = details[0], f", and {len(details) - 1} more such faults" if len(details) > 1 else ""
    key, message = ".".join(map(str, first["loc"])), first["msg"]
    if first["type"] == _DISAGREES:
        return f"{message}{more}"
    if first["type"] == "missing":
        return f"{key} is missing; expected what a run wrote{more}"
    expected = _EXPECTED.get(first["type"])
    if expected is not None:
        expected = expected.format(**first.get("ctx", {}))
    elif message.startswith(_PYDANTIC):
        expected = message.removeprefix(_PYDANTIC)
    else:
        # A fault of a section of the configuration, whose message says what was expected.
        return f"{key}: {message}{more}"
    return f"{key} is {_short(json.dumps(first['input'], default=str))}; expected {expected}{more}"


def _listed(names: Mapping[str, Any]) -> str:
    return _short(", ".join(names) or "nothing")


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}…"
