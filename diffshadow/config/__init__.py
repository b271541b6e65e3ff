"""Configurations: strict YAML files, and the modules they stand for.

`load_config` needs no JAX; the `build_…` functions do, and load it when they are first asked for.
"""

from typing import TYPE_CHECKING, Any

from ._biases import AdaptiveBiasConfig as AdaptiveBiasConfig
from ._biases import BiasConfig as BiasConfig
from ._biases import NoPlaneConfig as NoPlaneConfig
from ._biases import PlaneConfig as PlaneConfig
from ._biases import ReceiverPlaneConfig as ReceiverPlaneConfig
from ._dump import Row as Row
from ._dump import describe as describe
from ._dump import dump_resolved as dump_resolved
from ._dump import fit_units as fit_units
from ._errors import ConfigError as ConfigError
from ._errors import Place as Place
from ._errors import Problem as Problem
from ._errors import printable as printable
from ._filters import BilinearConfig as BilinearConfig
from ._filters import CastanoConfig as CastanoConfig
from ._filters import ExponentialConfig as ExponentialConfig
from ._filters import ExponentialVarianceConfig as ExponentialVarianceConfig
from ._filters import FilterConfig as FilterConfig
from ._filters import FourTapConfig as FourTapConfig
from ._filters import MomentsConfig as MomentsConfig
from ._filters import NearestConfig as NearestConfig
from ._filters import PatternedConfig as PatternedConfig
from ._filters import PercentageCloserConfig as PercentageCloserConfig
from ._filters import PercentageCloserSoftConfig as PercentageCloserSoftConfig
from ._filters import RandomDiskConfig as RandomDiskConfig
from ._filters import TentConfig as TentConfig
from ._filters import VarianceConfig as VarianceConfig
from ._fit import AnnealConfig as AnnealConfig
from ._fit import FitConfig as FitConfig
from ._fit import FitParameterConfig as FitParameterConfig
from ._fit import SolverConfig as SolverConfig
from ._fitted import fit_paths as fit_paths
from ._lights import DirectionalLightConfig as DirectionalLightConfig
from ._lights import LightConfig as LightConfig
from ._lights import LightOrbit as LightOrbit
from ._lights import PointLightConfig as PointLightConfig
from ._lights import RectangleLightConfig as RectangleLightConfig
from ._lights import SpotLightConfig as SpotLightConfig
from ._load import load_config as load_config
from ._load import parse_config as parse_config
from ._reference import ImageReferenceConfig as ImageReferenceConfig
from ._reference import ReferenceConfig as ReferenceConfig
from ._reference import TracedReferenceConfig as TracedReferenceConfig
from ._scene import CameraConfig as CameraConfig
from ._scene import CameraOrbit as CameraOrbit
from ._scene import MeshConfig as MeshConfig
from ._scene import OrthographicCameraConfig as OrthographicCameraConfig
from ._scene import PinholeCameraConfig as PinholeCameraConfig
from ._scene import SceneConfig as SceneConfig
from ._schema import Config as Config
from ._shading import AttenuationConfig as AttenuationConfig
from ._shading import ModulatedConfig as ModulatedConfig
from ._shading import PhongConfig as PhongConfig
from ._shading import ShadingConfig as ShadingConfig
from ._sweep import LABEL as LABEL
from ._sweep import LIMIT_ERROR as LIMIT_ERROR
from ._sweep import PlotConfig as PlotConfig
from ._sweep import QuasiRandomAxisConfig as QuasiRandomAxisConfig
from ._sweep import QuasiRandomConfig as QuasiRandomConfig
from ._sweep import SweepConfig as SweepConfig
from ._sweep_runs import Sweep as Sweep
from ._sweep_runs import SweepRun as SweepRun
from ._sweep_runs import SweepRuns as SweepRuns
from ._sweep_runs import load_sweep as load_sweep
from ._technique import CompareConfig as CompareConfig
from ._technique import HardCompareConfig as HardCompareConfig
from ._technique import ProjectiveTextureConfig as ProjectiveTextureConfig
from ._technique import ShadowMapConfig as ShadowMapConfig
from ._technique import ShadowMappingConfig as ShadowMappingConfig
from ._technique import ShadowVolumesConfig as ShadowVolumesConfig
from ._technique import SoftCompareConfig as SoftCompareConfig
from ._technique import TechniqueConfig as TechniqueConfig

if TYPE_CHECKING:
    from ._build import Casting as Casting
    from ._build import FitPlan as FitPlan
    from ._build import Technique as Technique
    from ._build import build_casting as build_casting
    from ._build import build_fit as build_fit
    from ._build import build_mesh as build_mesh
    from ._build import build_scene as build_scene
    from ._build import build_shading as build_shading
    from ._build import build_shadow_mapping as build_shadow_mapping
    from ._build import build_technique as build_technique

_NEED_JAX = frozenset(
    {
        "Casting",
        "FitPlan",
        "Technique",
        "build_casting",
        "build_fit",
        "build_mesh",
        "build_scene",
        "build_shading",
        "build_shadow_mapping",
        "build_technique",
    }
)


def __getattr__(name: str) -> Any:
    if name not in _NEED_JAX:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import _build

    return getattr(_build, name)
