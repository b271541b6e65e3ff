"""Constant bias (Williams 1978)."""

from typing import ClassVar

import equinox as eqx

from ..._arithmetic import as_number
from ..._types import AsScalar
from ...settings.biases import Bias as Settings
from ...settings.biases import BiasUnit
from .._receiver import Receiver
from .._shader import Constant, ShaderBias, ShaderPart, number
from ._abstract import AbstractBias, BiasTerms, in_depth, shader_of_length


class ConstantBias(AbstractBias):
    """A bias that is the same everywhere.

    - `value`: the bias along the light's axis, in `unit`. On a plane with depth slopes `g_x` and `g_y` along the map's
        axes, nearest look-ups need `(|g_x| + |g_y|) / 2` texels.
    - `unit`: `"texels"`, or `"depth"` for window depth. A value in window depth suits one scene, light and map only.
    """

    settings: ClassVar = Settings
    part: ClassVar = "constant"

    value: AsScalar = eqx.field(converter=as_number)
    unit: BiasUnit = eqx.field(static=True, default=Settings.unit)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return BiasTerms(in_depth(self.value, self.unit, receiver))

    def shader(self, prefix: str = "") -> ShaderBias:
        unit = "texels" if self.unit == "texels" else "window depth"
        constant = Constant(f"{prefix}CONSTANT_BIAS", number(self.value), f"along the light's axis, in {unit}")
        return ShaderBias(ShaderPart((constant,), ""), (shader_of_length(f"SHADOW_{constant.name}", self.unit),))
