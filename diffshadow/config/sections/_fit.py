"""Sections of a fit: its parameters, solver and annealing."""

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ._fitted import outside
from ._poses import is_pose
from ._section import MOST_TEXELS, Conflict, Form, Section, Texels, Unit, as_list, fault, is_number, ordered
from ._technique import LEAST_WIDTH, SoftKernel
from ._views import LossConfig, ValidationConfig, ViewsConfig


class FitParameterConfig(Section):
    """The bounds and start of a number to fit, in the unit of its key.

    For numbers of the scene with a traced reference, the values in `scene` are the truth.
    """

    initial: float | None = Field(
        default=None, description="where the fit starts; default: the value of the key it names"
    )
    lower: float = Field(description="least value")
    upper: float = Field(description="greatest value")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from ordered(cls, data, "lower", "upper")
        initial, lower, upper = (data.get(key) for key in ("initial", "lower", "upper"))
        if is_number(initial) and is_number(lower) and is_number(upper) and lower < upper:
            yield from ((("initial",), what) for what in outside(initial, lower, upper))


class SolverConfig(Section):
    """The optimizer."""

    type: Literal["levenberg_marquardt", "dogleg", "bfgs", "lbfgs", "adam"] = Field(
        default="levenberg_marquardt", description="the method"
    )
    # About a day, at a second per step.
    max_steps: Annotated[int, Unit("steps")] = Field(default=30, ge=1, le=100_000, description="most steps in a phase")
    rtol: float = Field(default=1e-4, gt=0, lt=1, description="relative change at which a phase ends")
    atol: float = Field(default=1e-6, gt=0, lt=1, description="absolute change at which a phase ends")
    learning_rate: float = Field(
        default=0.05,
        gt=0,
        le=math.pi,
        description="for adam only: length of its first steps, in units where the bounds are pi apart",
    )
    noise: float | None = Field(
        default=None,
        ge=0,
        lt=1,
        description="fraction of the loss by which it jumps; default: 0.25 in fits that move lights or meshes, else 0",
    )


class AnnealConfig(Section):
    """The soft compare's width during a fit: from `start` to `end` in geometric steps."""

    start: Texels = Field(default=2.0, ge=LEAST_WIDTH, description="width in the first phase, in texels")
    end: Texels = Field(default=0.05, ge=LEAST_WIDTH, description="width in the last phase, in texels")
    phases: int = Field(default=4, ge=1, le=100, description="number of phases")
    kernel: SoftKernel = Field(default="logistic", description="shape of the soft compare's step")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        yield from ordered(cls, data, "end", "start", equal=True)


_Excess = Annotated[float, Field(gt=0, le=10)]
_Blur = Annotated[float, Field(ge=0, le=MOST_TEXELS)]
_as_names = BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)
LEAST_BIAS = "least_bias"
"""The preference for the least biases, then the least radii."""

UPPER = 10.0
"""The upper bound of the constant bias in a fit that names no parameters, in texels. A large start raises it."""


def _default_parameters() -> dict[str, FitParameterConfig]:
    return {"bias.constant": FitParameterConfig(lower=0.0, upper=UPPER)}


class FitConfig(Section):
    """The parameters of a fit, and its settings."""

    parameters: dict[str, FitParameterConfig] = Field(
        default_factory=_default_parameters, description="numbers to fit, by the key that sets them"
    )
    solver: SolverConfig = Field(default_factory=SolverConfig, description="the optimizer")
    anneal: AnnealConfig = Field(default_factory=AnnealConfig, description="the soft compare's width during the fit")
    blurs: Annotated[tuple[_Blur, ...], as_list, Form("a list of numbers that fall"), Unit("pixels")] | None = Field(
        default=None,
        description="for lights and meshes: standard deviation of the Gaussian under which images are compared, in "
        "each phase; default: from an eighth of the image's shorter side to 3, in steps of about a third",
    )
    multistart: Annotated[int, Unit("starts")] = Field(
        default=1, ge=1, le=1024, description="number of starts: the initial values, and others within the bounds"
    )
    views: ViewsConfig | None = Field(
        default=None, description="scenes to fit to together, instead of the configuration's own"
    )
    validation: ValidationConfig | None = Field(
        default=None, description="scenes to measure the result on, which the fit does not see"
    )
    intervals: Annotated[tuple[_Excess, ...], as_list, Form("a list of fractions, such as [0.01, 0.05]")] = Field(
        default=(),
        description="for each, how far every parameter may move before the error exceeds its best by this fraction, "
        "with the others fitted again",
    )
    prefer: Annotated[tuple[str, ...], as_list, _as_names, Form("least_bias, or a list of parameters")] = Field(
        default=(),
        description="parameters to bring as close to 0 as tolerance allows, the first first; least_bias: all biases, "
        "then radii",
    )
    tolerance: _Excess = Field(
        default=0.01, description="for prefer: fraction of its best by which the error may exceed it"
    )
    front: Annotated[int, Unit("points")] = Field(
        default=0,
        ge=0,
        le=101,
        description="points of the front of false shadow against false light, 3 or more; default: not found",
    )
    loss: LossConfig = Field(default_factory=LossConfig, description="what the fit minimises")
    # Each draws the map again.
    evaluations: int = Field(
        default=30,
        ge=1,
        le=100_000,
        description="for numbers that lay out the map: evaluations of the error in a search, for each parameter",
    )

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        parameters, blurs = data.get("parameters"), data.get("blurs")
        names = parameters if isinstance(parameters, Mapping) else {}
        if data.get("front") in (1, 2):
            what = fault(f"is {data['front']}", "0 for none, or at least 3 points", "raise it, such as to 9")
            yield ("front",), what
        if parameters == {}:
            mend = "add 'bias.constant: {lower: 0, upper: 10}'"
            yield ("parameters",), fault("is empty", "at least one parameter to fit", mend)
        if isinstance(blurs, list | tuple) and all(is_number(blur) for blur in blurs):
            if not blurs or any(a <= b for a, b in itertools.pairwise(blurs)):
                message = "does not fall" if blurs else "is empty"
                yield ("blurs",), fault(message, "numbers of pixels that fall", "write a list such as [24, 3]")
            elif not any(is_pose(str(name)) for name in names):
                mend = "remove the key, or add a parameter of the scene, such as scene.light.azimuth"
                yield ("blurs",), fault("is given, and nothing moves", "a parameter of a light or mesh with it", mend)
