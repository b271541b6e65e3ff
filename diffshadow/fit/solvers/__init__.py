"""Settings of solvers, and least-squares solvers that optimistix lacks."""

from ._adam import Adam as Adam
from ._levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
from ._optimistix import optimistix_options as optimistix_options
from ._optimistix import optimistix_solver as optimistix_solver
from ._settings import OptimistixSolver as OptimistixSolver
from ._settings import Solver as Solver
from ._settings import Stop as Stop
