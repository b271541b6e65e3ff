"""Biases, which keep surfaces from shadowing themselves (acne). Each technique has its own file.

A texel stores one depth for a patch of surface. A slanted receiver is therefore partly behind its own stored depth,
which causes acne. Too much bias lights the shadow close to its caster, which is called peter-panning. Unless noted
otherwise, the unit of a bias is a texel, the width of a shadow-map texel at the receiver. This is the natural unit of
the error: one value works at any scale, distance and map resolution. A bias of b texels along the light's axis is `b ·
view.texel_size(distance, resolution)` in world units. Multiply by `view.depth_slope(distance)` to get window depth.
"""

from ._abstract import AbstractBias as AbstractBias
from ._abstract import BiasTerms as BiasTerms
from ._adaptive import AdaptiveBias as AdaptiveBias
from ._constant import ConstantBias as ConstantBias
from ._features import FEATURES as FEATURES
from ._linear import LinearBias as LinearBias
from ._normal_offset import NormalOffset as NormalOffset
from ._normal_offset import OffsetProfile as OffsetProfile
from ._perceptron import MAX_WEIGHTS as MAX_WEIGHTS
from ._perceptron import PerceptronBias as PerceptronBias
from ._receiver_plane import ReceiverPlane as ReceiverPlane
from ._slope import SlopeBias as SlopeBias
from ._sum import Bias as Bias
