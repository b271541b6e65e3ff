"""Fitting shadow-mapping settings, lights and casters to a reference by gradient."""

from ._arrangement import Arrangement as Arrangement
from ._arrangement import MeshPose as MeshPose
from ._history import Step as Step
from ._parameters import Parameter as Parameter
from ._parameters import parameter_names as parameter_names
from ._parameters import resolve as resolve
from ._parameters import with_values as with_values
from ._poses import MapSettings as MapSettings
from ._poses import PoseProblem as PoseProblem
from ._poses import cone_share as cone_share
from ._precision import Precision as Precision
from ._residuals import Problem as Problem
from ._settings import Anneal as Anneal
from ._settings import Solver as Solver
from ._solve import FitResult as FitResult
from ._solve import Outcome as Outcome
from ._solve import Start as Start
from ._solve import fit as fit
