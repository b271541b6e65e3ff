"""Slope-scaled bias: it grows with the slope of the receiver."""

from typing import ClassVar

import equinox as eqx

from ..._arithmetic import as_number, at_least, at_most
from ..._types import AsOptional, AsScalar
from ...settings.biases import Bias as Settings
from ...settings.biases import BiasUnit, SlopeProfile
from .._receiver import Receiver
from .._shader import ShaderBias, ShaderPart, constants_of
from ._abstract import AbstractBias, BiasTerms, in_depth, shader_of_length
from ._features import FEATURES, Feature


class SlopeBias(AbstractBias):
    """Slope-scaled bias, `clip(value · profile, least, most)`.

    - `value`: the bias along the light's axis, in `unit`.
    - `profile`: `"tangent"`, the norm of the receiver's depth slope in the map. With square texels and a directional
      light, it is tan θ, where θ is the angle between normal and light. Nearest look-ups on a plane need a `value` from
      1/2 (sloped along an axis of the map) to 1/√2 (along a diagonal) texels. Or `"one_minus_cosine"`, 1 - cos θ, which
      is bounded and therefore too small for the steepest receivers.
    - `least`, `most`: bounds of the bias, in `unit`; `None` for no bound.
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
        profile = self._feature.of(receiver)
        bias = at_most(at_least(self.value * profile, self.least), self.most)
        return BiasTerms(in_depth(bias, self.unit, receiver))

    @property
    def _feature(self) -> Feature:
        return FEATURES["slope" if self.profile == "tangent" else self.profile]

    def shader(self, prefix: str = "") -> ShaderBias:
        unit = "texels" if self.unit == "texels" else "window depth"
        constants = constants_of(
            (f"{prefix}SLOPE_BIAS", self.value, f"times the profile {self.profile}, in {unit}"),
            (f"{prefix}LEAST_SLOPE_BIAS", self.least, f"its least, in {unit}"),
            (f"{prefix}MOST_SLOPE_BIAS", self.most, f"its most, in {unit}"),
        )
        length = f"SHADOW_{prefix}SLOPE_BIAS * ({self._feature.shader})"
        if self.least is not None:
            length = f"max({length}, SHADOW_{prefix}LEAST_SLOPE_BIAS)"
        if self.most is not None:
            length = f"min({length}, SHADOW_{prefix}MOST_SLOPE_BIAS)"
        return ShaderBias(ShaderPart(constants, ""), (shader_of_length(length, self.unit),))
