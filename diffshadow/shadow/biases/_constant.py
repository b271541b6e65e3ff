"""Constant bias (Williams 1978)."""

import equinox as eqx

from ..._checks import check_choice, check_not_negative
from ..._misc import as_float
from ..._types import Scalar
from .._receiver import Receiver
from ._abstract import UNIT_NAMES, AbstractBias, BiasTerms, BiasUnit, in_depth


class ConstantBias(AbstractBias):
    """The same everywhere.

    - `value`: along the light's axis, in `unit`. On a plane with depth slopes `g_x` and `g_y` along the map's axes,
        nearest look-ups need `(|g_x| + |g_y|) / 2` texels.
    - `unit`: `"texels"`, or `"depth"` for window depth. A value in window depth suits one scene, light and map only.

    **Raises** `ValueError` if `value` is negative or not finite.
    """

    value: Scalar = eqx.field(converter=as_float)
    unit: BiasUnit = eqx.field(static=True, default="texels")

    def __check_init__(self):
        check_choice("the constant bias's unit", self.unit, ("texels", "depth"))
        check_not_negative("the constant bias", self.value, UNIT_NAMES[self.unit])

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return BiasTerms(in_depth(self.value, self.unit, receiver))
