"""Records of single runs: renders, and fits of techniques, lights, meshes, pictures and shapes.

A record is made when a run ends. It is written to `result.json`, printed and drawn on the page. Reports and comparisons
read it again.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from ...settings.reference import Encoding
from ._parts import (
    Count,
    Fraction,
    Numbers,
    Part,
    Positive,
    Seconds,
    Seed,
    Side,
    Similarity,
    Single,
    absent,
    check_keys,
    disagrees,
)

UNEXPLAINED, BEST_ALREADY = "unexplained", "best already"


class Errors(Part):
    """Errors of one state over all lights. `flip` is measured on the shaded picture, or `None`."""

    rmse: Fraction
    mae: Fraction
    ssim: Similarity
    false_shadow_rate: Fraction
    false_light_rate: Fraction
    flip: Fraction | None = None


class LightErrors(Part):
    """Errors of one state under one light. `None` if no pixel counts."""

    rmse: Fraction | None
    mae: Fraction | None
    ssim: Similarity | None
    false_shadow_rate: Fraction | None
    false_light_rate: Fraction | None


class Extents(Part):
    """Figures of the extents of texels, in pixels."""

    worst: Positive
    percentile_99: Positive
    mean_log2: Single
    undersampled: Fraction


class Aliasing(Part):
    """The size of texels on the screen, and its part that perspective causes."""

    extent: Extents
    perspective: Extents


class RenderedLight(Part):
    """A light of a render. `aliasing` is `None` without a map that has visible texels."""

    light: str
    errors: LightErrors
    aliasing: Aliasing | None = None
    reference_noise_floor: Fraction | None = None
    pixels: Count | None = None


class FittedLight(Part):
    """A light or a view of a fit. `validation` is true if the fit does not use it, and `None` without a validation."""

    light: str
    before: LightErrors
    after: LightErrors
    validation: bool | None = absent()


class BeforeAndAfter(Part):
    """Errors before and after a fit."""

    before: Errors
    after: Errors


class RenderMetrics(Part):
    """The errors of a render against its reference, over `pixels` pixels."""

    compare: str
    reference_noise_floor: Fraction | None
    pixels: Count
    technique: str = ""
    errors: Errors
    lights: list[RenderedLight] = Field(min_length=1)


class FitMetrics(Part):
    """The errors of a fit's images against their references, over `pixels` pixels.

    - `validation`: the errors over the validation views.
    - `shown`: the indices of the views that have pictures, with the worst first; for several views only.
    - `resolution`: (height, width) of the images, for a fit without a configuration.
    """

    compare: str
    reference_noise_floor: Fraction | None
    pixels: Count
    before: Errors
    after: Errors
    lights: list[FittedLight] = Field(min_length=1)
    validation: BeforeAndAfter | None = absent()
    shown: list[Count] | None = absent()
    resolution: Annotated[list[Side], Field(min_length=2, max_length=2)] | None = absent()


class Bounds(Part):
    """The bounds of a parameter."""

    lower: Single
    upper: Single
    unit: str


class Phase(Part):
    """As `fit.Outcome`, with its values by name."""

    width: Positive
    steps: Count
    result: str
    gradient_norm: Positive | None
    # A user's loss may be greater than 1.
    hard_loss: Positive | None
    values: Numbers
    blur: Positive = 0.0
    searched: Annotated[float, Field(ge=0, le=1)] = 0.0


class Course(Part):
    """The course of a fit.

    - `flat`: the parameters without a gradient.
    - `is_own_loss`: whether losses come from a user's loss. `initial_loss`: its value at the start, under the hard
      compare. It is `None` for poses, because it would compare blurred images, unlike the hard losses of the phases.
    """

    name: str = ""
    steps: Count
    chosen_phase: int = Field(ge=-1)
    flat: list[str] = []
    is_own_loss: bool = absent(False)
    initial_loss: Positive | None = absent()
    seconds_compiling: Seconds | None = None
    seconds_running: Seconds | None = None
    phases: list[Phase]


class Precision(Part):
    """As `fit.Precision`."""

    names: list[str] = []
    deviations: dict[str, float | None] = {}
    correlations: list[list[float | None]] = []
    undetermined: list[list[str]] = []


class Start(Part):
    """Like `fit.Start`, with its values by name."""

    initial: Numbers
    end: Numbers = {}
    loss: Positive | None


class Poses(Part):
    """The result of a fit of lights and meshes: the known `truth`, the distance of the fit from the truth, and the
    precision with which the image determines the values."""

    truth: Numbers = {}
    error: Numbers = {}
    precision: Precision | None = None
    starts: list[Start] | None = None
    enlargements: Count = 0


class At(Part):
    """A value of a parameter, and the error there."""

    value: Single
    error: Positive


class End(At):
    """As `fit.End`."""

    is_bound: bool


class Interval(Part):
    """As `fit.Interval`."""

    within: Annotated[float, Field(gt=0)]
    lower: End
    upper: End


class Profile(Part):
    """The error along a parameter, (value, error) in order of the values, and the intervals where it is close to the
    best."""

    best: At
    points: list[Annotated[list[Single | None], Field(min_length=2, max_length=2)]]
    intervals: list[Interval]

    @classmethod
    def of(cls, source: Any, **more: Any) -> Self:
        value, error = source.best
        return super().of(source, best=At(value=value, error=error), **more)


class FrontPoint(Part):
    """Like `fit.FrontPoint`, with its values by name."""

    values: Numbers
    false_shadow: Positive
    false_light: Positive
    rmse: Fraction | None = None
    ratio: Annotated[float, Field(gt=0)] | None = None
    is_knee: bool


class Verdict(Part):
    """The verdict on a fit.

    - `kind`: `"unexplained"` if it does not explain its references, `"best already"` if the start is as good as the
      result, `"cut short"` if the solver had too few steps to tell, `"nothing fitted"` if no parameter has a slope, and
      otherwise `"fitted"`.
    - `sentence`: the verdict in words, without a full stop.
    - `remedies`: the remedies to try, one sentence each.
    - `constant_rmse`: the lowest RMSE of constant images, if the references are not explained. Colours of pictures may
      be greater than 1.
    """

    kind: str
    sentence: str = Field(min_length=1)
    remedies: list[str] = []
    constant_rmse: Positive | None = None


class Run(Part):
    """The fields that the records of all runs have. `warnings`: remarks, one sentence each; `seconds`: times of its
    stages."""

    schema_version: Count = 0
    name: str = Field(min_length=1)
    warnings: list[str] | None = None
    seconds: dict[str, Seconds]
    versions: dict[str, str]
    files: list[str] = []

    @property
    def said(self) -> Verdict | None:
        """The verdict on a fit. `None` for a render, and for a fit by an older version."""
        return getattr(self, "verdict", None)

    @property
    def is_explained(self) -> bool:
        """Whether a fit explains its references, if that is known."""
        return self.said is None or self.said.kind != UNEXPLAINED


class RenderRecord(Run):
    """The record of a render."""

    kind: Literal["render"] = "render"
    seed: Seed
    command: str
    metrics: RenderMetrics


class NumbersRecord(Run):
    """The record of a fit of numbers. A run made in Python has neither seed nor command, because it has no
    configuration."""

    seed: Seed | None = absent()
    command: str | None = absent()
    verdict: Verdict | None = None
    initial: Numbers
    fitted: Numbers = Field(min_length=1)
    bounds: dict[str, Bounds]

    @model_validator(mode="after")
    def _has_its_numbers(self) -> "NumbersRecord":
        check_keys("initial", self.initial, "fitted", self.fitted)
        check_keys("bounds", self.bounds, "fitted", self.fitted)
        return self


class FitRecord(NumbersRecord):
    """The record of a fit to images of visibility."""

    kind: Literal["fit"] = "fit"
    metrics: FitMetrics
    solver: Course
    profiles: dict[str, Profile] = absent({})
    front: list[FrontPoint] = absent([])
    code: dict[str, str] = absent({})
    code_file: str = absent("engine.js")
    poses: Poses | None = absent()

    @property
    def truth(self) -> Numbers:
        """The known true values of lights and meshes."""
        return {} if self.poses is None else self.poses.truth

    @property
    def deviations(self) -> dict[str, float | None]:
        """The known standard deviations of fitted poses."""
        return {} if self.poses is None or self.poses.precision is None else self.poses.precision.deviations

    @property
    def starts(self) -> list[Start]:
        """The course of each of several starts of a fit of poses."""
        return [] if self.poses is None else self.poses.starts or []

    @property
    def widths(self) -> list[float]:
        """The fractions of the error that define the intervals."""
        return [each.within for profile in list(self.profiles.values())[:1] for each in profile.intervals]

    @model_validator(mode="after")
    def _agrees(self) -> "FitRecord":
        """Checks that all parts have the same parameters and phases."""
        named = {
            **({"profiles": self.profiles} if self.profiles else {}),
            **{f"front.{i}.values": point.values for i, point in enumerate(self.front)},
            **{f"solver.phases.{i}.values": phase.values for i, phase in enumerate(self.solver.phases)},
            **{f"poses.starts.{i}.initial": start.initial for i, start in enumerate(self.starts)},
        }
        for key, numbers in named.items():
            check_keys(key, numbers, "fitted", self.fitted)
        for name, bounds in self.bounds.items():
            if bounds.lower >= bounds.upper:
                raise disagrees(f"bounds.{name}", f"are {bounds.lower:g} and {bounds.upper:g}", "lower less than upper")
        if any(index >= len(self.metrics.lights) for index in self.metrics.shown or ()):
            raise disagrees("metrics.shown", f"is {self.metrics.shown}", f"less than {len(self.metrics.lights)}")
        if (self.seed is None) != (self.command is None):
            raise disagrees("command and seed", "are not both there", "both, or neither of a fit made in Python")
        if self.command is None and self.metrics.resolution is None:
            raise disagrees("metrics.resolution", "is missing", "the size of the images, because there is no command")
        phases, chosen = len(self.solver.phases), self.solver.chosen_phase
        if chosen >= phases:
            raise disagrees("solver.chosen_phase", f"is {chosen}", f"less than {phases}, the number of phases")
        return self


class PictureErrors(Part):
    """Errors of a picture in its encoding. `flip` is `None` without the package that measures it."""

    rmse: Positive
    mae: Positive
    flip: Positive | None = None


class PictureMetrics(Part):
    """The errors of the drawn pictures against the reference picture."""

    before: PictureErrors
    after: PictureErrors
    pixels: Count
    resolution: Annotated[list[Count], Field(min_length=2, max_length=2)]


class PictureRecord(NumbersRecord):
    """The record of a fit to a picture. `camera`: eye, target and up of the fitted camera."""

    kind: Literal["picture"] = "picture"
    encoding: Encoding
    truth: Numbers
    deviations: dict[str, Single | None]
    camera: dict[str, Annotated[list[float], Field(min_length=3, max_length=3)]]
    metrics: PictureMetrics
    steps: Count


class Overlap(Part):
    """The overlap of a shadow with its target, as intersection over union: before the fit, and after it for the map and
    for rays."""

    light: str
    before: Fraction
    map: Fraction
    rays: Fraction


class UnseenOverlap(Part):
    """The overlap of the result under a light that the fit did not use."""

    light: str
    rays: Fraction


class MovedLight(Part):
    """The angle between a light and its position in the scene, in degrees."""

    light: str
    before: Positive
    after: Positive


class ShapeMetrics(Part):
    """The closeness of a shape's shadows to their targets.

    - `chamfer`, `size`: world units, if the shape that casts the targets is known.
    - `self_intersections`: pairs of faces.
    """

    initial_loss: Positive
    loss: Positive
    lights: list[Overlap] = Field(min_length=1)
    unseen: list[UnseenOverlap] = absent([])
    moved: list[MovedLight] = absent([])
    self_intersections: Annotated[int, Field(ge=0)] = 0
    chamfer: Positive | None = absent()
    size: Annotated[float, Field(gt=0)] | None = absent()


class ShapePhase(Part):
    """A phase of a fit of a shape. `loss`: the loss at the end of the phase, without a blur."""

    steps: Count
    loss: Positive


class ShapeRecord(Run):
    """The record of a fit of a shape."""

    kind: Literal["shape"] = "shape"
    verdict: Verdict | None = None
    seed: Seed
    command: str
    metrics: ShapeMetrics
    vertices: Count
    chosen_phase: int = Field(ge=-1)
    phases: list[ShapePhase]


VisibilityRecord = FitRecord | RenderRecord
"""The record of a run with images of visibility."""
FolderRecord = RenderRecord | FitRecord | PictureRecord | ShapeRecord
"""The record of a run."""
