"""Configurations: strict YAML files, and the modules built from them.

`load_config` does not need JAX. The `build_…` functions need it, and import it on first access.
"""

from typing import TYPE_CHECKING

from ._errors import ConfigError
from ._errors import Location as Location
from ._errors import Mistake as Mistake
from ._errors import printable as printable
from .reading._advise import Advice, load_advice
from .reading._dump import Row as Row
from .reading._dump import describe, dump, dump_resolved
from .reading._files import input_files as input_files
from .reading._files import user_modules as user_modules
from .reading._keys import is_key as is_key
from .reading._load import load_config, parse_config
from .reading._numbers import Choice as Choice
from .reading._numbers import Number as Number
from .reading._numbers import choices_of as choices_of
from .reading._numbers import numbers_of as numbers_of
from .reading._numbers import with_number as with_number
from .reading._of_run import CONFIG_FILE as CONFIG_FILE
from .reading._of_run import FITTED_FILE as FITTED_FILE
from .reading._of_run import RECOMMENDED_FILE as RECOMMENDED_FILE
from .reading._of_run import RESULT_FILE as RESULT_FILE
from .reading._of_run import settings_file, with_fitted
from .reading._sweep_runs import CheckProgress as CheckProgress
from .reading._sweep_runs import Sweep, SweepRun, SweepRuns, load_sweep
from .reading._templates import DEFAULT_TEMPLATE as DEFAULT_TEMPLATE
from .reading._templates import is_mesh as is_mesh
from .reading._templates import write_template as write_template
from .sections._axes import LABEL as LABEL
from .sections._config import Config, FitView
from .sections._fit import preferences as preferences
from .sections._fitted import fit_paths as fit_paths
from .sections._fitted import fit_units as fit_units
from .sections._fitted import is_limit as is_limit
from .sections._images import REFERENCES as REFERENCES
from .sections._scene import BUILTIN as BUILTIN
from .sections._scene import DirectionalLightConfig as DirectionalLightConfig
from .sections._section import changed as changed
from .sections._section import frozen as frozen
from .sections._sweep import FLICKER as FLICKER
from .sections._sweep import LIMIT_ERROR as LIMIT_ERROR
from .sections._sweep import PlotConfig as PlotConfig
from .sections._sweep import SweepConfig as SweepConfig

__all__ = [
    "Advice",
    "Config",
    "ConfigError",
    "FitPlan",
    "FitView",
    "ShapePlan",
    "Sweep",
    "SweepRun",
    "SweepRuns",
    "build_fit",
    "build_fittable",
    "build_free",
    "build_mesh",
    "build_scene",
    "build_shading",
    "build_shadow_mapping",
    "build_shape",
    "build_technique",
    "describe",
    "dump",
    "dump_resolved",
    "load_advice",
    "load_config",
    "load_sweep",
    "parse_config",
    "settings_file",
    "with_fitted",
]

if TYPE_CHECKING:
    from .building._modules import BuiltMeshes as BuiltMeshes
    from .building._modules import (
        FitPlan,
        ShapePlan,
        build_fit,
        build_fittable,
        build_free,
        build_mesh,
        build_scene,
        build_shading,
        build_shadow_mapping,
        build_shape,
        build_technique,
    )
    from .building._modules import Screen as Screen
    from .building._modules import build_camera as build_camera
    from .building._modules import build_lights as build_lights
    from .building._modules import build_meshes as build_meshes
else:

    def __getattr__(name):
        if not name.startswith("build_") and name not in ("FitPlan", "Screen", "ShapePlan", "BuiltMeshes"):
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from .building import _modules

        return getattr(_modules, name)


def __dir__() -> list[str]:
    return __all__
