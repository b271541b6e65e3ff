"""Gradient fits of shadow-mapping settings, lights and casters to a reference.

`fit` is this package, and `fit.fit` its function: after `from diffshadow import fit`, call `fit.fit(problem, ...)`.

There are two ways to fit:

- `fit.fit` finds up to some tens of named numbers with bounds, such as `bias.constant`, `filter.radius` or
  `lights.0.azimuth`, and their uncertainty. It takes one or several problems: `TechniqueProblem` (the map does not
  change) or `PoseProblem` (lights or meshes move). `study.save_fit` writes its result with a report.
- `fit.train` finds all numbers in a part of a technique, such as the weights of a network, from any number of views.
  These numbers need no names.
"""

from ._anneal import Anneal
from ._arrangement import Arrangement, MeshPose
from ._bounds import AtBound
from ._fit import FitResult, fit
from ._fit import check_loss as check_loss
from ._front import FrontPoint
from ._history import Step
from ._how import Search, Sureness
from ._hull import hull_start
from ._hull import shadow_size as shadow_size
from ._loss import Loss
from ._parameters import Parameter, Parameters, with_values
from ._parameters import parameter_names as parameter_names
from ._parameters import resolve as resolve
from ._parameters import with_parameters as with_parameters
from ._precision import Precision
from ._profile import Bound, End, Interval, Profile
from ._run import Outcome, Start
from ._shape import check_shape as check_shape
from ._shape import fit_shape
from ._shape_steps import PHASES as SHAPE_PHASES
from ._shape_steps import FittedShape, ShapePhase, ShapeState, ShapeStep
from ._train import Training, TrainingPhase, mean_square_error, train
from .problems import AbstractProblem, PictureProblem, PoseProblem, ShapeProblem, ShapeView, TechniqueProblem
from .problems import Rows as Rows
from .problems import cone_fraction as cone_fraction
from .problems import devices_of as devices_of
from .problems import stack_of as stack_of
from .solvers import Solver

__all__ = [
    "SHAPE_PHASES",
    "AbstractProblem",
    "Anneal",
    "Arrangement",
    "AtBound",
    "Bound",
    "End",
    "FitResult",
    "FittedShape",
    "FrontPoint",
    "Interval",
    "Loss",
    "MeshPose",
    "Outcome",
    "Parameter",
    "Parameters",
    "PictureProblem",
    "PoseProblem",
    "Precision",
    "Profile",
    "Search",
    "ShapePhase",
    "ShapeProblem",
    "ShapeState",
    "ShapeStep",
    "ShapeView",
    "Solver",
    "Start",
    "Step",
    "Sureness",
    "TechniqueProblem",
    "Training",
    "TrainingPhase",
    "fit",
    "fit_shape",
    "hull_start",
    "mean_square_error",
    "train",
    "with_values",
]


def __dir__() -> list[str]:
    return __all__
