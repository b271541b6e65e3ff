"""Fitting shadow-mapping settings, lights and casters to a reference by gradient."""

from ._anneal import Anneal as Anneal
from ._arrangement import Arrangement as Arrangement
from ._arrangement import MeshPose as MeshPose
from ._fit import FitResult as FitResult
from ._fit import fit as fit
from ._front import FrontPoint as FrontPoint
from ._history import Step as Step
from ._loss import Loss as Loss
from ._parameters import Parameter as Parameter
from ._parameters import Parameters as Parameters
from ._parameters import parameter_names as parameter_names
from ._parameters import resolve as resolve
from ._parameters import with_values as with_values
from ._precision import Precision as Precision
from ._profile import End as End
from ._profile import Interval as Interval
from ._profile import Profile as Profile
from ._profile import Side as Side
from ._run import Outcome as Outcome
from ._run import Start as Start
from .problems import AbstractProblem as AbstractProblem
from .problems import PoseProblem as PoseProblem
from .problems import TechniqueProblem as TechniqueProblem
from .problems import cone_fraction as cone_fraction
from .solvers import Solver as Solver
