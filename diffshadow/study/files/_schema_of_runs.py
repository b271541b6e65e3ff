"""The schema of the results of single runs: renders, and fits of techniques, lights, meshes, pictures and shapes."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ...settings.reference import Encoding
from ._schema_parts import Count, Fraction, Numbers, Part, Seconds, Seed, Side, Similarity, Single, disagrees, listed


class _Errors(Part):
    """Errors of one state, over all lights; `flip`, of the shaded picture, is `None` if it was not measured."""

    rmse: Fraction
    mae: Fraction
    ssim: Similarity
    false_shadow_rate: Fraction
    false_light_rate: Fraction
    flip: Fraction | None = None


class _LightErrors(Part):
    """Errors of one state under one light; `None` if no pixel counts."""

    rmse: Fraction | None
    mae: Fraction | None
    ssim: Similarity | None
    false_shadow_rate: Fraction | None
    false_light_rate: Fraction | None


class _Extents(Part):
    """Figures of the extents of texels, in pixels."""

    worst: Annotated[float, Field(ge=0)]
    percentile_99: Annotated[float, Field(ge=0)]
    mean_log2: Single
    undersampled: Fraction


class _Aliasing(Part):
    extent: _Extents
    perspective: _Extents


class _RenderedLight(Part):
    light: str
    errors: _LightErrors
    aliasing: _Aliasing | None = None
    reference_noise_floor: Fraction | None = None
    pixels: Count | None = None


class _FittedLight(Part):
    """`validation`: whether the fit has not seen it."""

    light: str
    before: _LightErrors
    after: _LightErrors
    validation: bool = False


class _BeforeAndAfter(Part):
    before: _Errors
    after: _Errors


class _Metrics(Part):
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
    resolution: Annotated[list[Side], Field(min_length=2, max_length=2)] | None = None


class _Bounds(Part):
    lower: Single
    upper: Single
    unit: str


class _Phase(Part):
    width: float = Field(ge=0)
    steps: Count
    result: str
    gradient_norm: Annotated[float, Field(ge=0)] | None
    # A user's loss may be greater than 1.
    hard_loss: Annotated[float, Field(ge=0)] | None
    values: Numbers
    blur: float = Field(default=0.0, ge=0)
    searched: float = Field(default=0.0, ge=0, le=1)


class _Solver(Part):
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


class _Precision(Part):
    """As `fit.Precision`."""

    names: list[str] = []
    deviations: dict[str, float | None] = {}
    correlations: list[list[float | None]] = []
    undetermined: list[list[str]] = []


class _Start(Part):
    initial: Numbers
    end: Numbers = {}
    loss: Annotated[float, Field(ge=0)] | None


class _Poses(Part):
    truth: Numbers = {}
    error: Numbers = {}
    precision: _Precision | None = None
    starts: list[_Start] | None = None
    enlargements: Count = 0


class _At(Part):
    value: Single
    error: Annotated[float, Field(ge=0)]


class _End(_At):
    is_bound: bool


class _Interval(Part):
    within: Annotated[float, Field(gt=0)]
    lower: _End
    upper: _End


class _Profile(Part):
    """The error along a parameter, (value, error) in order of the values, and where it is close to the best."""

    best: _At
    points: list[Annotated[list[Single | None], Field(min_length=2, max_length=2)]]
    intervals: list[_Interval]


class _FrontPoint(Part):
    """A setting, its roots of the mean square of what is too dark and too light, and of all errors."""

    values: Numbers
    false_shadow: Annotated[float, Field(ge=0)]
    false_light: Annotated[float, Field(ge=0)]
    rmse: Fraction | None = None
    ratio: Annotated[float, Field(gt=0)] | None = None
    is_knee: bool


class _Verdict(Part):
    """What a fit comes to, and what to try."""

    kind: str
    sentence: str = Field(min_length=1)
    remedies: list[str] = []
    # Of a picture, whose colours may be greater than 1.
    constant_rmse: Annotated[float, Field(ge=0)] | None = None


class Run(Part):
    schema_version: Count = 0
    name: str = Field(min_length=1)
    warnings: list[str] | None = None
    seconds: dict[str, Seconds]
    versions: dict[str, str]
    files: list[str] = []


class Render(Run):
    kind: Literal["render"]
    seed: Seed
    command: str
    metrics: _RenderMetrics


class Fit(Run):
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
    def _agrees(self) -> "Fit":
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
                raise disagrees(key, f"has the keys {listed(numbers)}", f"the keys of fitted, {listed(self.fitted)}")
        for name, bounds in self.bounds.items():
            if bounds.lower >= bounds.upper:
                raise disagrees(f"bounds.{name}", f"are {bounds.lower:g} and {bounds.upper:g}", "lower less than upper")
        if any(index >= len(self.metrics.lights) for index in self.metrics.shown or ()):
            raise disagrees("metrics.shown", f"is {self.metrics.shown}", f"less than {len(self.metrics.lights)}")
        if (self.seed is None) != (self.command is None):
            raise disagrees("command and seed", "are not both there", "both, or neither of a fit made in Python")
        if self.command is None and self.metrics.resolution is None:
            raise disagrees("metrics.resolution", "is missing", "the size of the images, since there is no command")
        phases, chosen = len(self.solver.phases), self.solver.chosen_phase
        if chosen >= phases:
            raise disagrees("solver.chosen_phase", f"is {chosen}", f"less than {phases}, the number of phases")
        return self


class _Shadow(Part):
    """How far a shadow overlaps its target, as intersection over union."""

    light: str
    before: Fraction
    map: Fraction
    rays: Fraction


class _UnseenShadow(Part):
    light: str
    rays: Fraction


class _MovedLight(Part):
    """How far a light is from its place in the scene, degrees."""

    light: str
    before: Annotated[float, Field(ge=0)]
    after: Annotated[float, Field(ge=0)]


class _ShapeMetrics(Part):
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


class _PictureErrors(Part):
    """`flip` is none without the package that measures it."""

    rmse: Annotated[float, Field(ge=0)]
    mae: Annotated[float, Field(ge=0)]
    flip: Annotated[float, Field(ge=0)] | None = None


class _PictureMetrics(Part):
    before: _PictureErrors
    after: _PictureErrors
    pixels: Count
    resolution: Annotated[list[Count], Field(min_length=2, max_length=2)]


class Picture(Run):
    """A fit made in Python has neither seed nor command, since it has no configuration."""

    kind: Literal["picture"]
    verdict: _Verdict | None = None
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
    def _agrees(self) -> "Picture":
        """Checks that all parts have the same parameters."""
        for key, numbers in (("initial", self.initial), ("bounds", self.bounds)):
            if list(numbers) != list(self.fitted):
                raise disagrees(key, f"has the keys {listed(numbers)}", f"the keys of fitted, {listed(self.fitted)}")
        return self


class _ShapePhase(Part):
    steps: Count
    loss: Annotated[float, Field(ge=0)]


class Shape(Run):
    kind: Literal["shape"]
    verdict: _Verdict | None = None
    seed: Seed
    command: str
    metrics: _ShapeMetrics
    vertices: Count
    chosen_phase: int = Field(ge=-1)
    phases: list[_ShapePhase]
