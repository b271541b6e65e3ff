"""Shadow maps, and the biases, compares and filters that turn them into visibility."""

from ._bias import AbstractBias as AbstractBias
from ._bias import Bias as Bias
from ._bias import BiasTerms as BiasTerms
from ._bias import ConstantBias as ConstantBias
from ._bias import NormalOffset as NormalOffset
from ._bias import SlopeBias as SlopeBias
from ._compare import AbstractCompare as AbstractCompare
from ._compare import HardCompare as HardCompare
from ._compare import SoftCompare as SoftCompare
from ._compare import SoftKernel as SoftKernel
from ._map import ShadowMap as ShadowMap
from ._map import draw_shadow_map as draw_shadow_map
from ._receiver import Lookup as Lookup
from ._receiver import Receiver as Receiver
from ._receiver import look_up as look_up
from ._receiver import receiver as receiver
from ._technique import ShadowMapping as ShadowMapping
from .filters import AbstractFilter as AbstractFilter
from .filters import Bilinear as Bilinear
from .filters import FourTap as FourTap
from .filters import Nearest as Nearest
from .filters import PercentageCloser as PercentageCloser
from .filters import RandomDisk as RandomDisk
from .filters import offset_table as offset_table
