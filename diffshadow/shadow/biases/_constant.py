"""Constant bias (Williams 1978)."""

from typing import ClassVar

import equinox as eqx

from ..._arithmetic import as_number
from ..._types import AsScalar
from ...settings.biases import Bias as Settings
from ...settings.biases import BiasUnit
from .._receiver import Receiver
from ._abstract import AbstractBias, BiasTerms, in_depth


class ConstantBias(AbstractBias):
    """The same everywhere.

    - `value`: along the light's axis, in `unit`. On a plane with depth slopes `g_x` and `g_y` along the map's axes,
        nearest look-ups need `(|g_x| + |g_y|) / 2` texels.
    - `unit`: `"texels"`, or `"depth"` for window depth. A value in window depth suits one scene, light and map only.
    """

    settings: ClassVar = Settings
    part: ClassVar = "constant"

    value: AsScalar = eqx.field(converter=as_number)
    unit: BiasUnit = eqx.field(static=True, default=Settings.unit)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return BiasTerms(in_depth(self.value, self.unit, receiver))
