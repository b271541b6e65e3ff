"""Configurations: strict YAML files, and the modules they stand for.

`load_config` needs no JAX; the `build_…` functions do, and load it when they are first asked for.
"""

from typing import TYPE_CHECKING, Any

from ._dump import Row as Row
from ._dump import describe as describe
from ._dump import dump_resolved as dump_resolved
from ._errors import ConfigError as ConfigError
from ._errors import Place as Place
from ._errors import Problem as Problem
from ._load import load_config as load_config
from ._load import parse_config as parse_config
from ._scene import CameraConfig as CameraConfig
from ._scene import CameraOrbit as CameraOrbit
from ._scene import DirectionalLightConfig as DirectionalLightConfig
from ._scene import LightConfig as LightConfig
from ._scene import LightOrbit as LightOrbit
from ._scene import MeshConfig as MeshConfig
from ._scene import OrthographicCameraConfig as OrthographicCameraConfig
from ._scene import PinholeCameraConfig as PinholeCameraConfig
from ._scene import SceneConfig as SceneConfig
from ._scene import SpotLightConfig as SpotLightConfig
from ._schema import AnnealConfig as AnnealConfig
from ._schema import Config as Config
from ._schema import FitConfig as FitConfig
from ._schema import FitParameterConfig as FitParameterConfig
from ._schema import ImageReferenceConfig as ImageReferenceConfig
from ._schema import ReferenceConfig as ReferenceConfig
from ._schema import SolverConfig as SolverConfig
from ._schema import TracedReferenceConfig as TracedReferenceConfig
from ._schema import fit_names as fit_names
from ._technique import BiasConfig as BiasConfig
from ._technique import BilinearConfig as BilinearConfig
from ._technique import CompareConfig as CompareConfig
from ._technique import FilterConfig as FilterConfig
from ._technique import FourTapConfig as FourTapConfig
from ._technique import HardCompareConfig as HardCompareConfig
from ._technique import NearestConfig as NearestConfig
from ._technique import PercentageCloserConfig as PercentageCloserConfig
from ._technique import RandomDiskConfig as RandomDiskConfig
from ._technique import ShadowMapConfig as ShadowMapConfig
from ._technique import SoftCompareConfig as SoftCompareConfig
from ._technique import sample_grid as sample_grid

if TYPE_CHECKING:
    from ._build import FitPlan as FitPlan
    from ._build import build_fit as build_fit
    from ._build import build_mesh as build_mesh
    from ._build import build_scene as build_scene
    from ._build import build_technique as build_technique

_NEED_JAX = frozenset({"FitPlan", "build_fit", "build_mesh", "build_scene", "build_technique"})


def __getattr__(name: str) -> Any:
    if name not in _NEED_JAX:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import _build

    return getattr(_build, name)
