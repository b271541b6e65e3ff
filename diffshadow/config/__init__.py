"""Configurations: strict YAML files, and the modules built from them.

`load_config` does not need JAX. The `build_…` functions do, and import it when they are first accessed.
"""

from typing import TYPE_CHECKING

from ._errors import ConfigError as ConfigError
from ._errors import Mistake as Mistake
from ._errors import Place as Place
from ._errors import printable as printable
from .reading._advise import Advice as Advice
from .reading._advise import Technique as Technique
from .reading._advise import load_advice as load_advice
from .reading._dump import Row as Row
from .reading._dump import describe as describe
from .reading._dump import dump as dump
from .reading._dump import dump_resolved as dump_resolved
from .reading._dump import fit_units as fit_units
from .reading._load import load_config as load_config
from .reading._load import parse_config as parse_config
from .reading._of_run import CONFIG_FILE as CONFIG_FILE
from .reading._of_run import FITTED_FILE as FITTED_FILE
from .reading._of_run import RECOMMENDED_FILE as RECOMMENDED_FILE
from .reading._of_run import RESULT_FILE as RESULT_FILE
from .reading._of_run import SettingsFile as SettingsFile
from .reading._of_run import settings_file as settings_file
from .reading._of_run import with_fitted as with_fitted
from .reading._sweep_runs import Sweep as Sweep
from .reading._sweep_runs import SweepRun as SweepRun
from .reading._sweep_runs import SweepRuns as SweepRuns
from .reading._sweep_runs import load_sweep as load_sweep
from .sections._axes import LABEL as LABEL
from .sections._fitted import fit_paths as fit_paths
from .sections._fitted import is_limit as is_limit
from .sections._lights import DirectionalLightConfig as DirectionalLightConfig
from .sections._section import changed as changed
from .sections._sweep import LIMIT_ERROR as LIMIT_ERROR
from .sections._sweep import PlotConfig as PlotConfig
from .sections._sweep import SweepConfig as SweepConfig
from .whole._schema import Config as Config
from .whole._schema import View as View

if TYPE_CHECKING:
    from .building._modules import FitPlan as FitPlan
    from .building._modules import Screen as Screen
    from .building._modules import ShapePlan as ShapePlan
    from .building._modules import build_fit as build_fit
    from .building._modules import build_fittable as build_fittable
    from .building._modules import build_mesh as build_mesh
    from .building._modules import build_scene as build_scene
    from .building._modules import build_shading as build_shading
    from .building._modules import build_shadow_mapping as build_shadow_mapping
    from .building._modules import build_shape as build_shape
    from .building._modules import build_technique as build_technique
else:

    def __getattr__(name):
        if not name.startswith("build_") and name not in ("FitPlan", "Screen", "ShapePlan"):
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from .building import _modules

        return getattr(_modules, name)
