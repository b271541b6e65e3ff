"""Filters: ways to turn a shadow map into visibility, one technique per file."""

from ._abstract import AbstractFilter as AbstractFilter
from ._castano import Castano as Castano
from ._exponential import ExponentialShadowMap as ExponentialShadowMap
from ._exponential_variance import ExponentialVarianceShadowMap as ExponentialVarianceShadowMap
from ._four_tap import FourTap as FourTap
from ._moments import MomentShadowMap as MomentShadowMap
from ._pcf import PercentageCloser as PercentageCloser
from ._pcss import PercentageCloserSoft as PercentageCloserSoft
from ._random_disk import RandomDisk as RandomDisk
from ._separable import Separable as Separable
from ._single import Bilinear as Bilinear
from ._single import Nearest as Nearest
from ._tent import Tent as Tent
from ._variance import VarianceShadowMap as VarianceShadowMap
