"""Configurations: strict YAML files, and the modules built from them.

`load_config` does not need JAX. The `build_…` functions do, and import it when they are first accessed.
"""

from typing import TYPE_CHECKING, Any

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
from .sections._advise import AdviseConfig as AdviseConfig
from .sections._axes import LABEL as LABEL
from .sections._axes import PathConfig as PathConfig
from .sections._axes import QuasiRandomAxisConfig as QuasiRandomAxisConfig
from .sections._axes import QuasiRandomConfig as QuasiRandomConfig
from .sections._axes import SunConfig as SunConfig
from .sections._biases import AdaptiveBiasConfig as AdaptiveBiasConfig
from .sections._biases import BiasConfig as BiasConfig
from .sections._biases import LayerConfig as LayerConfig
from .sections._biases import NetworkConfig as NetworkConfig
from .sections._biases import NoPlaneConfig as NoPlaneConfig
from .sections._biases import PlaneConfig as PlaneConfig
from .sections._biases import ReceiverPlaneConfig as ReceiverPlaneConfig
from .sections._biases import TermsConfig as TermsConfig
from .sections._engines import BabylonJsConfig as BabylonJsConfig
from .sections._engines import EngineConfig as EngineConfig
from .sections._engines import ThreeJsConfig as ThreeJsConfig
from .sections._filters import BilinearConfig as BilinearConfig
from .sections._filters import CastanoConfig as CastanoConfig
from .sections._filters import ExponentialConfig as ExponentialConfig
from .sections._filters import ExponentialVarianceConfig as ExponentialVarianceConfig
from .sections._filters import FilterConfig as FilterConfig
from .sections._filters import FourTapConfig as FourTapConfig
from .sections._filters import MomentsConfig as MomentsConfig
from .sections._filters import NearestConfig as NearestConfig
from .sections._filters import PatternedConfig as PatternedConfig
from .sections._filters import PercentageCloserConfig as PercentageCloserConfig
from .sections._filters import PercentageCloserSoftConfig as PercentageCloserSoftConfig
from .sections._filters import RandomDiskConfig as RandomDiskConfig
from .sections._filters import SeparableConfig as SeparableConfig
from .sections._filters import TentConfig as TentConfig
from .sections._filters import VarianceConfig as VarianceConfig
from .sections._fit import AnnealConfig as AnnealConfig
from .sections._fit import FitConfig as FitConfig
from .sections._fit import FitParameterConfig as FitParameterConfig
from .sections._fit import SolverConfig as SolverConfig
from .sections._fitted import fit_paths as fit_paths
from .sections._fitted import is_limit as is_limit
from .sections._lights import DirectionalLightConfig as DirectionalLightConfig
from .sections._lights import LightConfig as LightConfig
from .sections._lights import LightOrbit as LightOrbit
from .sections._lights import PointLightConfig as PointLightConfig
from .sections._lights import RectangleLightConfig as RectangleLightConfig
from .sections._lights import ShadowCamera as ShadowCamera
from .sections._lights import SpotLightConfig as SpotLightConfig
from .sections._reference import ImageReferenceConfig as ImageReferenceConfig
from .sections._reference import ReferenceConfig as ReferenceConfig
from .sections._reference import TracedReferenceConfig as TracedReferenceConfig
from .sections._scene import CameraConfig as CameraConfig
from .sections._scene import CameraOrbit as CameraOrbit
from .sections._scene import MeshConfig as MeshConfig
from .sections._scene import OrthographicCameraConfig as OrthographicCameraConfig
from .sections._scene import PinholeCameraConfig as PinholeCameraConfig
from .sections._scene import SceneConfig as SceneConfig
from .sections._shading import AttenuationConfig as AttenuationConfig
from .sections._shading import ModulatedConfig as ModulatedConfig
from .sections._shading import PhongConfig as PhongConfig
from .sections._shading import ShadingConfig as ShadingConfig
from .sections._sweep import LIMIT_ERROR as LIMIT_ERROR
from .sections._sweep import PlotConfig as PlotConfig
from .sections._sweep import SweepConfig as SweepConfig
from .sections._technique import CascadesConfig as CascadesConfig
from .sections._technique import CompareConfig as CompareConfig
from .sections._technique import HardCompareConfig as HardCompareConfig
from .sections._technique import IrregularZBufferConfig as IrregularZBufferConfig
from .sections._technique import MappedConfig as MappedConfig
from .sections._technique import PerspectiveWarpConfig as PerspectiveWarpConfig
from .sections._technique import ProjectiveTextureConfig as ProjectiveTextureConfig
from .sections._technique import ResolutionMatchedConfig as ResolutionMatchedConfig
from .sections._technique import ShadowMapConfig as ShadowMapConfig
from .sections._technique import ShadowMappingConfig as ShadowMappingConfig
from .sections._technique import ShadowVolumesConfig as ShadowVolumesConfig
from .sections._technique import SoftCompareConfig as SoftCompareConfig
from .sections._technique import TechniqueConfig as TechniqueConfig
from .sections._views import LossConfig as LossConfig
from .sections._views import ViewsConfig as ViewsConfig
from .whole._schema import Config as Config
from .whole._schema import View as View

if TYPE_CHECKING:
    from .building._modules import FitPlan as FitPlan
    from .building._modules import build_fit as build_fit
    from .building._modules import build_fittable as build_fittable
    from .building._modules import build_mesh as build_mesh
    from .building._modules import build_scene as build_scene
    from .building._modules import build_shading as build_shading
    from .building._modules import build_shadow_mapping as build_shadow_mapping
    from .building._modules import build_technique as build_technique

_NEED_JAX = frozenset(
    {
        "FitPlan",
        "build_fit",
        "build_mesh",
        "build_scene",
        "build_shading",
        "build_fittable",
        "build_shadow_mapping",
        "build_technique",
    }
)


def __getattr__(name: str) -> Any:
    if name not in _NEED_JAX:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .building import _modules

    return getattr(_modules, name)
