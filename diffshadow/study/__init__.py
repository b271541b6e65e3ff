"""Runs: from a configuration to a folder of numbers, images and a report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._report import report
from .imports._import import import_scene
from .pages._compare import compare
from .runs._check import check as check
from .runs._convert import convert
from .runs._fit import run_fit
from .runs._pose import pose_problems as pose_problems
from .runs._render import run_render
from .runs._save import save_fit
from .runs._shape import shadow_on as shadow_on
from .runs._shape import shape_problem as shape_problem

__all__ = [
    "compare",
    "convert",
    "import_scene",
    "report",
    "run_advise",
    "run_fit",
    "run_render",
    "run_sweep",
    "save_fit",
]

if TYPE_CHECKING:
    from .advice._advise import print_advise_plan as print_advise_plan
    from .advice._advise import run_advise
    from .sweeps._run import print_plan as print_plan
    from .sweeps._run import run_sweep

_OF_SWEEPS = {
    "print_plan": ".sweeps._run",
    "run_sweep": ".sweeps._run",
    "print_advise_plan": ".advice._advise",
    "run_advise": ".advice._advise",
}


def __getattr__(name: str) -> Any:
    # On first use: sweeps load Dask, pandas and Arrow.
    if name in _OF_SWEEPS:
        return getattr(import_module(_OF_SWEEPS[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
