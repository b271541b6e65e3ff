"""Slope-scaled bias: it grows with the slope of the receiver."""

from typing import Literal

import equinox as eqx

from ..._checks import check_choice, check_not_negative
from ..._misc import as_float, at_least, at_most, concrete
from ..._types import Scalar
from .._receiver import Receiver
from ._abstract import (
    UNIT_NAMES,
    AbstractBias,
    BiasTerms,
    BiasUnit,
    in_depth,
    optional_float,
)
from ._features import FEATURES

SlopeProfile = Literal["tangent", "one_minus_cosine"]


class SlopeBias(AbstractBias):
    """Slope-scaled bias, `clip(value · profile, least, most)`.

    - `value`: along the light's axis, in `unit`.
    - `profile`: `"tangent"`, the norm of the receiver's depth slope in the map. With square texels and a directional
        light it is tan θ, θ being the angle between normal and light. Nearest look-ups on a plane need a `value` from
        1/2 (sloped along an axis of the map) to 1/√2 (along a diagonal) texels. Or `"one_minus_cosine"`, 1 - cos θ,
        which is bounded and therefore too small for the steepest receivers.
    - `least`, `most`: bounds of the bias, in `unit`; none for no bound.
    - `unit`: `"texels"`, or `"depth"` for window depth. `SlopeBias(0.05, "one_minus_cosine", least=0.005,
        unit="depth")` is the common bias of shader tutorials. To convert such values to texels, divide them by the
        window depth per texel, `view.texel_size(distance, resolution) · view.depth_slope(distance)`.

    **Raises** `ValueError` if a number is negative or not finite, or `least` is above `most`.
    """

    value: Scalar = eqx.field(converter=as_float)
    profile: SlopeProfile = eqx.field(static=True, default="tangent")
    least: Scalar | None = eqx.field(converter=optional_float, default=None)
    most: Scalar | None = eqx.field(converter=optional_float, default=None)
    unit: BiasUnit = eqx.field(static=True, default="texels")

    def __check_init__(self):
        check_choice("the slope bias's profile", self.profile, ("tangent", "one_minus_cosine"))
        check_choice("the slope bias's unit", self.unit, ("texels", "depth"))
        check_not_negative("the slope bias", self.value, UNIT_NAMES[self.unit])
        check_not_negative("the slope bias's least", self.least, UNIT_NAMES[self.unit])
        check_not_negative("the slope bias's most", self.most, UNIT_NAMES[self.unit])
        if self.least is None or self.most is None:
            return
        least, most = concrete(self.least), concrete(self.most)
        if least is not None and most is not None and least > most:
            raise ValueError(f"the slope bias's least is {least}, above its most, {most}; expected least <= most")

    def __call__(self, receiver: Receiver) -> BiasTerms:
        profile = FEATURES["slope" if self.profile == "tangent" else self.profile].of(receiver)
        bias = at_most(at_least(self.value * profile, self.least), self.most)
        return BiasTerms(in_depth(bias, self.unit, receiver))
