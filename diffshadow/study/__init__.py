"""Runs: from a configuration to a folder of numbers, images and a report."""

from ._fit_run import run_fit as run_fit
from ._render_run import run_render as run_render
from ._techniques import draw_from_light as draw_from_light
from ._techniques import draw_visibility as draw_visibility
