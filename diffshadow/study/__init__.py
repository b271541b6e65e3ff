"""Runs: from a configuration to a folder of numbers, images and a report."""

from ._check import check as check
from ._compare import compare as compare
from ._fit_run import run_fit as run_fit
from ._pose_run import pose_problems as pose_problems
from ._render_run import run_render as run_render
from ._report import report as report
from ._sweep_run import print_plan as print_plan
from ._sweep_run import run_sweep as run_sweep
from ._techniques import draw_from_light as draw_from_light
from ._techniques import draw_visibility as draw_visibility
