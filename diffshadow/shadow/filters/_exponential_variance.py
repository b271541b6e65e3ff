"""Exponential variance shadow maps (Lauritzen & McCool, "Layered Variance Shadow Maps", Graphics Interface 2008)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_number
from ..._types import AsScalar, DepthMap, Scalar, Visibility
from ...settings.filters import ExponentialVarianceShadowMap as Settings
from .._shader import Constant, ShaderPart, number
from ._prefilter import AbstractPrefiltered, chebyshev

# Clamp on the log of moments relative to the receiver's. Larger moments leave no bound, and their squares would
# overflow.
_MAX_LOG_MOMENT = 30.0


class ExponentialVarianceShadowMap(AbstractPrefiltered):
    """Variance shadow maps of two warps of depth, e^(c₊ w) and -e^(-c₋ w) with w = 2z - 1; visibility is the smaller of
    the two bounds.

    The positive warp reduces light bleeding behind overlapping occluders. The negative warp reduces it on receivers
    with deeper surfaces around them.

    - `radius`: radius of the blur, in texels.
    - `max_radius`: upper bound on `radius`, in texels. Defaults to `radius`, or to 8 if `radius` is traced; rounded up
        to a half texel.
    - `kernel`: kernel of the blur; all shapes end at the radius.
    - `positive_exponent`, `negative_exponent`: c₊ and c₋, for linear depth z from 0 at the light's near plane to 1 at
        its far plane.
    - `least_variance`: lower bound on the variance of linear depth, which the warps scale by their slope at the
        receiver.
    - `light_bleeding`: visibility up to this value becomes 0, and the rest is stretched.
    """

    settings: ClassVar = Settings

    positive_exponent: AsScalar = eqx.field(converter=as_number, default=Settings.positive_exponent, kw_only=True)
    negative_exponent: AsScalar = eqx.field(converter=as_number, default=Settings.negative_exponent, kw_only=True)
    least_variance: AsScalar = eqx.field(converter=as_number, default=Settings.least_variance, kw_only=True)

    @property
    def _exponents(self) -> tuple[Scalar, Scalar]:
        return self.positive_exponent, -self.negative_exponent

    def moments(self, depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        upper, lower = (jnp.exp(c * (2 * depth - 1)) for c in self._exponents)
        return upper, upper * upper, lower, lower * lower

    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        upper, lower = (
            self._bound_of_warp(c, mean, square, 2 * receiver - 1)
            for c, mean, square in zip(self._exponents, moments[::2], moments[1::2], strict=True)
        )
        return jnp.minimum(upper, lower)

    def _bound_of_warp(self, exponent: Scalar, mean: DepthMap, square: DepthMap, receiver: DepthMap) -> Visibility:
        """Chebyshev's bound for the warp with this exponent, in units of the receiver's warped depth."""
        relative = lambda moment, power: jnp.exp(
            jnp.minimum(jnp.log(moment) - power * exponent * receiver, _MAX_LOG_MOMENT)
        )
        mean, square = relative(mean, 1), relative(square, 2)
        # The derivative of e^(c w) with respect to z, where w = 2z - 1, is 2c e^(c w).
        least = 4 * exponent * exponent * self.least_variance
        variance = jnp.maximum(square - mean * mean, least)
        sign = jnp.sign(exponent)
        return chebyshev(sign * mean, variance, sign * jnp.ones_like(mean))

    def shader(self) -> ShaderPart:
        constants = (
            Constant("POSITIVE_EXPONENT", number(self.positive_exponent), "of the upper warp"),
            Constant("NEGATIVE_EXPONENT", number(self.negative_exponent), "of the lower warp"),
            Constant("LEAST_VARIANCE", number(self.least_variance), "of linear depth"),
            Constant("MAX_LOG_MOMENT", _MAX_LOG_MOMENT, "clamp on the log of moments"),
        )
        return self.shader_of(*constants, files=("filters/_chebyshev.glsl", "filters/_exponential_variance.glsl"))
