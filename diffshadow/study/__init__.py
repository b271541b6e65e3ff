"""Runs: from a configuration to a folder of numbers, images and a report."""

from ._report import report as report
from .pages._compare import compare as compare
from .runs._check import check as check
from .runs._fit import run_fit as run_fit
from .runs._pose import pose_problems as pose_problems
from .runs._render import run_render as run_render
from .sweeps._run import print_plan as print_plan
from .sweeps._run import run_sweep as run_sweep
