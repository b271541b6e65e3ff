"""Runs: from a configuration to a folder with numbers, images and a report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._report import next_after as next_after
from ._report import report
from .imports._import import import_scene
from .pages._compare import compare
from .pages._next import after_comparison as after_comparison
from .pages._next import after_defaults as after_defaults
from .pages._next import for_engine as for_engine
from .pages._next import to_convert as to_convert
from .record._files import add_files as add_files
from .record._stored import VisibilityRun as VisibilityRun
from .record._stored import is_fit as is_fit
from .record._stored import read_run as read_run
from .runs._check import check as check
from .runs._convert import convert
from .runs._fit import fit_technique as fit_technique
from .runs._fit import run_fit
from .runs._picture import traced_picture as traced_picture
from .runs._progress import Progress as Progress
from .runs._render import run_render
from .runs._save import save_fit
from .runs._setup import trace as trace
from .runs._shape import shadow_on as shadow_on
from .runs._shape import shape_problem as shape_problem
from .runs._visibility import pose_problems as pose_problems

__all__ = [
    "compare",
    "convert",
    "engine_advice",
    "export_shader",
    "import_scene",
    "print_defaults",
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
    from .advice._defaults import LightOptions as LightOptions
    from .advice._defaults import print_defaults
    from .advice._engines import engine_advice
    from .exports._page import compared_with as compared_with
    from .exports._shader import export_shader
    from .pages._colours import difference_colours as difference_colours
    from .pages._colours import marked as marked
    from .pages._colours import on_surface as on_surface
    from .pages._colours import tinted as tinted
    from .pages._figures import history as history
    from .sweeps._run import print_plan as print_plan
    from .sweeps._run import run_sweep

_ON_USE = {
    "history": ".pages._figures",
    **dict.fromkeys(("difference_colours", "marked", "on_surface", "tinted"), ".pages._colours"),
    "print_plan": ".sweeps._run",
    "run_sweep": ".sweeps._run",
    "print_advise_plan": ".advice._advise",
    "run_advise": ".advice._advise",
    "engine_advice": ".advice._engines",
    "compared_with": ".exports._page",
    "export_shader": ".exports._shader",
    **dict.fromkeys(("LightOptions", "print_defaults"), ".advice._defaults"),
}


def __getattr__(name: str) -> Any:
    # Sweeps load Dask; pages load Matplotlib.
    if name in _ON_USE:
        return getattr(import_module(_ON_USE[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
