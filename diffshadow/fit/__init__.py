"""Fitting shadow-mapping settings to a reference by gradient."""

from ._history import Step as Step
from ._parameters import Parameter as Parameter
from ._parameters import parameter_names as parameter_names
from ._parameters import resolve as resolve
from ._parameters import with_values as with_values
from ._residuals import Problem as Problem
from ._settings import Anneal as Anneal
from ._settings import Solver as Solver
from ._solve import FitResult as FitResult
from ._solve import Outcome as Outcome
from ._solve import fit as fit
