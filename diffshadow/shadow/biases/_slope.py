"""Slope-scaled bias: it grows with the slope of the receiver."""

from typing import ClassVar

import equinox as eqx

from ..._arithmetic import as_number, at_least, at_most
from ..._types import AsOptional, AsScalar
from ...settings.biases import Bias as Settings
from ...settings.biases import BiasUnit, SlopeProfile
from .._receiver import Receiver
from ._abstract import AbstractBias, BiasTerms, in_depth
from ._features import FEATURES


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

    **Raises** `ValueError` if `least` is above `most`.
    """

    settings: ClassVar = Settings
    part: ClassVar = "slope"

    value: AsScalar = eqx.field(converter=as_number)
    profile: SlopeProfile = eqx.field(static=True, default=Settings.slope_profile)
    least: AsOptional = eqx.field(converter=as_number, default=Settings.slope_least)
    most: AsOptional = eqx.field(converter=as_number, default=Settings.slope_most)
    unit: BiasUnit = eqx.field(static=True, default=Settings.unit)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        profile = FEATURES["slope" if self.profile == "tangent" else self.profile].of(receiver)
        bias = at_most(at_least(self.value * profile, self.least), self.most)
        return BiasTerms(in_depth(bias, self.unit, receiver))
