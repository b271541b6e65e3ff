"""Percentage-closer filtering with a tent instead of a box."""

from typing import ClassVar

from ..._arithmetic import at_most
from ...settings.filters import Tent as Settings
from .._shader import ShaderPart
from ..kernels import AbstractRow, SeparableRow
from ._sized import AbstractSizedFilter


class Tent(AbstractSizedFilter):
    """The mean of compares with all texels around the receiver, weighted by a tent.

    The tent moves and grows smoothly: the weight of each texel is the integral of the tent over it. Visibility then has
    a continuous derivative along the map. The derivative under a box has jumps.

    - `radius`: the distance from the tent's peak to its edge, in texels.
    - `max_radius`: upper bound on `radius`, in texels; the number of taps grows with its square. Defaults to `radius`,
        or to 8 if `radius` is traced; rounded up to a half texel.

    **Raises** `ValueError` if `radius` is above `max_radius`.
    """

    settings: ClassVar = Settings

    def row(self) -> AbstractRow:
        return SeparableRow(self.max_radius, at_most(self.radius, self.max_radius), "tent")

    def shader(self) -> ShaderPart:
        return self.shader_of("filters/_tent.glsl")
