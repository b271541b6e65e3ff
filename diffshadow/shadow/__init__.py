"""Shadow mapping with its biases, compares and filters; shadow volumes, irregular z-buffers and projective shadows."""

from ..settings.engines import BabylonFilter, BabylonQuality
from ..settings.maps import SoftKernel
from ..settings.patterns import DiskMapping
from ..settings.techniques import LevelNorm, WarpMethod
from ._aliasing import Aliasing, aliasing
from ._compare import AbstractCompare, HardCompare, SoftCompare
from ._draw_map import MapPlan, MapSettings, draw_shadow_map, plan_crossings
from ._irregular import IrregularScene, IrregularZBuffer
from ._lookup import Lookup, look_up
from ._map import Overflow, ShadowMap
from ._projective import ProjectiveShadow, ProjectiveTexture
from ._receiver import Receiver, receiver
from ._rule_of_thumb import bias_for
from ._shadow_mapping import ShadowMapping
from ._technique import AbstractTechnique, FittableTechnique, Side
from ._volumes import ShadowVolumes, Volumes, VolumeScene, shadow_volumes
from .biases import (
    AbstractBias,
    AdaptiveBias,
    Bias,
    BiasTerms,
    ConstantBias,
    LinearBias,
    NormalOffset,
    PerceptronBias,
    ReceiverPlane,
    SlopeBias,
)
from .biases import OffsetProfile as OffsetProfile
from .engines import ENGINE_TECHNIQUES as ENGINE_TECHNIQUES
from .engines import GODOT_QUALITIES as GODOT_QUALITIES
from .engines import OFFSET_PROFILES as OFFSET_PROFILES
from .engines import (
    AbstractEngineShadows,
    BabylonJs,
    Bevy,
    EngineLight,
    EngineMap,
    GodotCompatibility,
    PlayCanvas,
    ThreeJs,
    engine_code,
    engine_settings,
)
from .engines import EngineSetting as EngineSetting
from .engines import LightFrame as LightFrame
from .engines import PlainBias as PlainBias
from .engines import castano_radius as castano_radius
from .engines import light_frame as light_frame
from .engines import radius_settings as radius_settings
from .filters import AbstractFilter
from .filters._castano import Castano
from .filters._exponential import ExponentialShadowMap
from .filters._exponential_variance import ExponentialVarianceShadowMap
from .filters._four_tap import FourTap
from .filters._moments import MomentShadowMap
from .filters._pcf import PercentageCloser
from .filters._pcss import PercentageCloserSoft
from .filters._random_disk import RandomDisk
from .filters._separable import Separable
from .filters._single import Bilinear, Nearest
from .filters._tent import Tent
from .filters._variance import VarianceShadowMap
from .kernels import Atlas, mean_of_taps
from .kernels import StoredMap as StoredMap
from .kernels import without_depths as without_depths
from .layouts import AbstractLayout, Cascades, PerspectiveWarp, ResolutionMatched, SingleMap
from .layouts import Choice as Choice
from .layouts import LayerFigure as LayerFigure
from .layouts import MapFigure as MapFigure
from .patterns import Pattern, halton, poisson_disk, sobol, stratified, uniform, vogel
from .shaders import shader_buffers, to_shader
from .silhouettes import SilhouetteMap

__all__ = [
    "AbstractBias",
    "AbstractCompare",
    "AbstractEngineShadows",
    "AbstractFilter",
    "AbstractLayout",
    "AbstractTechnique",
    "AdaptiveBias",
    "Aliasing",
    "Atlas",
    "BabylonFilter",
    "BabylonJs",
    "BabylonQuality",
    "Bevy",
    "Bias",
    "BiasTerms",
    "Bilinear",
    "Cascades",
    "Castano",
    "ConstantBias",
    "DiskMapping",
    "EngineLight",
    "EngineMap",
    "ExponentialShadowMap",
    "ExponentialVarianceShadowMap",
    "FittableTechnique",
    "FourTap",
    "GodotCompatibility",
    "HardCompare",
    "IrregularScene",
    "IrregularZBuffer",
    "LevelNorm",
    "LinearBias",
    "Lookup",
    "MapPlan",
    "MapSettings",
    "MomentShadowMap",
    "Nearest",
    "NormalOffset",
    "Overflow",
    "Pattern",
    "PercentageCloser",
    "PercentageCloserSoft",
    "PerceptronBias",
    "PerspectiveWarp",
    "PlayCanvas",
    "ProjectiveShadow",
    "ProjectiveTexture",
    "RandomDisk",
    "Receiver",
    "ReceiverPlane",
    "ResolutionMatched",
    "Separable",
    "ShadowMap",
    "ShadowMapping",
    "ShadowVolumes",
    "Side",
    "SilhouetteMap",
    "SingleMap",
    "SlopeBias",
    "SoftCompare",
    "SoftKernel",
    "Tent",
    "ThreeJs",
    "VarianceShadowMap",
    "VolumeScene",
    "Volumes",
    "WarpMethod",
    "aliasing",
    "bias_for",
    "draw_shadow_map",
    "engine_code",
    "engine_settings",
    "halton",
    "look_up",
    "mean_of_taps",
    "plan_crossings",
    "poisson_disk",
    "radius_settings",
    "receiver",
    "shader_buffers",
    "shadow_volumes",
    "sobol",
    "stratified",
    "to_shader",
    "uniform",
    "vogel",
]


def __dir__() -> list[str]:
    return __all__
