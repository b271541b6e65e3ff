"""Fitting shadow-mapping settings, lights and casters to a reference by gradient."""

from ._anneal import Anneal as Anneal
from ._arrangement import Arrangement as Arrangement
from ._arrangement import MeshPose as MeshPose
from ._fit import FitResult as FitResult
from ._fit import fit as fit
from ._history import Step as Step
from ._parameters import Parameter as Parameter
from ._parameters import Parameters as Parameters
from ._parameters import parameter_names as parameter_names
from ._parameters import resolve as resolve
from ._parameters import with_values as with_values
from ._precision import Precision as Precision
from ._run import Outcome as Outcome
from ._run import Start as Start
from ._train import Training as Training
from ._train import TrainingPhase as TrainingPhase
from ._train import mean_square_error as mean_square_error
from ._train import train as train
from .problems import AbstractProblem as AbstractProblem
from .problems import PoseProblem as PoseProblem
from .problems import TechniqueProblem as TechniqueProblem
from .problems import cone_fraction as cone_fraction
from .solvers import Solver as Solver
