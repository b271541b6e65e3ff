"""Biases: what keeps a surface from shadowing itself, one technique a file.

A texel stores one depth for a patch of surface, so a slanted receiver lies partly behind its own depth: acne. Too much
bias lights what lies in a shadow close to its caster: Peter-panning. Unless said otherwise a bias is measured in
texels, the width of a shadow-map texel at the receiver, which is the natural unit of that error: the same numbers serve
at any scale, distance and map resolution. A bias of b texels along the light's axis is
`b · view.texel_size(distance, resolution)` in world units, and that times `view.depth_slope(distance)` in window depth.
"""

from ._abstract import AbstractBias as AbstractBias
from ._abstract import BiasTerms as BiasTerms
from ._adaptive import AdaptiveBias as AdaptiveBias
from ._constant import ConstantBias as ConstantBias
from ._normal_offset import NormalOffset as NormalOffset
from ._receiver_plane import ReceiverPlane as ReceiverPlane
from ._slope import SlopeBias as SlopeBias
from ._sum import Bias as Bias
