"""Sections of a fit: its parameters, solver and annealing."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ...settings import Form, fit
from ._fitted import outside
from ._poses import is_pose
from ._section import Conflict, Section, fault, is_number
from ._shape import ShapeConfig
from ._views import LOSSES, AnyLossConfig, ValidationConfig, ViewsConfig


class FitParameterConfig(Section):
    """The bounds and start of a number to fit, in the unit of its key.

    For numbers of the scene with a traced reference, the values in `scene` are the truth.
    """

    initial: Annotated[float | None, "where the fit starts; default: the value of the key it names"] = None
    lower: Annotated[float, "least value"]
    upper: Annotated[float, "greatest value"]
    ascending = (("lower", "upper"),)

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        initial, lower, upper = (data.get(key) for key in ("initial", "lower", "upper"))
        if is_number(initial) and is_number(lower) and is_number(upper) and lower < upper:
            yield from ((("initial",), what) for what in outside(initial, lower, upper))


class SolverConfig(Section, fit.Solver):
    """The optimizer."""


class AnnealConfig(Section, fit.Anneal):
    """The soft compare's width during a fit: from `start` to `end` in geometric steps."""


_as_names = BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)
MIN_BIAS = "least_bias"
"""The preference for the least biases, then the least radii."""

UPPER = 10.0
"""The upper bound of the constant bias in a fit that names no parameters, in texels. A large start raises it."""


def _default_parameters() -> dict[str, FitParameterConfig]:
    return {"bias.constant": FitParameterConfig(lower=0.0, upper=UPPER)}


class FitConfig(Section, fit.Fit):
    """The parameters of a fit, and its settings."""

    parameters: dict[str, FitParameterConfig] = Field(
        default_factory=_default_parameters, description="numbers to fit, by the key that sets them"
    )
    solver: SolverConfig = Field(default_factory=SolverConfig, description="the optimizer")
    anneal: AnnealConfig = Field(default_factory=AnnealConfig, description="the soft compare's width during the fit")
    views: Annotated[ViewsConfig | None, "scenes to fit to together, instead of the configuration's own"] = None
    validation: Annotated[ValidationConfig | None, "scenes to measure the result on, which the fit does not see"] = None
    prefer: Annotated[
        tuple[str, ...],
        _as_names,
        Form("least_bias, or a list of parameters"),
        "parameters to bring as close to 0 as tolerance allows, the first first; least_bias: all biases, then radii",
    ] = ()
    loss: AnyLossConfig = Field(default_factory=LOSSES.make, description="what the fit minimises")
    shape: Annotated[ShapeConfig | None, "a fit of all vertices of a mesh to its shadows, instead of parameters"] = None

    @classmethod
    def completed(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        return data if data.get("shape") is None or "parameters" in data else {**data, "parameters": {}}

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        parameters, blurs = data.get("parameters"), data.get("blurs")
        names = parameters if isinstance(parameters, Mapping) else {}
        if data.get("front") in range(1, fit.FEWEST_POINTS):
            what = fault(
                f"is {data['front']}", f"0 for none, or at least {fit.FEWEST_POINTS} points", "raise it, such as to 9"
            )
            yield ("front",), what
        if data.get("shape") is not None and names:
            mend = "remove the parameters, or fit.shape"
            yield ("parameters",), fault("are given with fit.shape", "one or the other", mend)
        if isinstance(blurs, list | tuple) and all(is_number(blur) for blur in blurs):
            if not blurs or any(a <= b for a, b in itertools.pairwise(blurs)):
                message = "does not fall" if blurs else "is empty"
                yield ("blurs",), fault(message, "numbers of pixels that fall", "write a list such as [24, 3]")
            elif not any(is_pose(str(name)) for name in names):
                mend = "remove the key, or add a parameter of the scene, such as scene.light.azimuth"
                yield ("blurs",), fault("is given, and nothing moves", "a parameter of a light or mesh with it", mend)
