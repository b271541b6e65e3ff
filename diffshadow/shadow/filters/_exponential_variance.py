"""Exponential variance shadow maps (Lauritzen & McCool, "Layered Variance Shadow Maps", Graphics Interface 2008)."""

import equinox as eqx
import jax.numpy as jnp

from ..._misc import as_float
from ..._types import DepthMap, Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ._abstract import AbstractFilter
from ._prefilter import (
    MAX_BLEEDING,
    Blur,
    Kernel,
    blurred_moments,
    chebyshev,
    check_kernel,
    check_number,
    check_radius,
    linear_depth,
    radius_limit,
    reduce_light_bleeding,
)

_NAME = "exponential variance shadow map"
# e^84, the square of the largest warped depth, is still a number in 32 bits.
_MAX_EXPONENT = 42.0
# A second moment e^30 times the receiver's square bounds nothing any more; below, its square does not overflow.
_MAX_LOG_MOMENT = 30.0


class ExponentialVarianceShadowMap(AbstractFilter):
    """Variance shadow maps of two warps of depth, e^(c₊ w) and -e^(-c₋ w) with w = 2z - 1; visibility is the lesser of
    both bounds.

    The first warp leaves less light behind overlapping occluders, the second on receivers that deeper ones surround.
    The compare is not asked, for visibility is smooth already; a bias moves the receiver as ever, but that it follows
    the receiver's plane has no effect.

    - `radius`: of the blur, in texels.
    - `max_radius`: the largest radius that can be asked for, in texels. It defaults to `radius`, and is
        rounded up to a half texel.
    - `kernel`: of the blur; all shapes end at the radius.
    - `positive_exponent`, `negative_exponent`: c₊ and c₋, for linear depth z that runs from 0 at the light's near plane
        to 1 at its far plane; more than 0, and at most 42.
    - `least_variance`: floor on the variance of linear depth, which the warps scale by their slope at the receiver;
        more than 0.
    - `light_bleeding`: visibility up to this becomes 0 and the rest is stretched; in [0, 0.99].

    **Raises** `ValueError` if a number is out of its range, or `kernel` is unknown.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Kernel = eqx.field(static=True)
    positive_exponent: Scalar
    negative_exponent: Scalar
    least_variance: Scalar
    light_bleeding: Scalar

    def __init__(
        self,
        radius: float | Scalar = 2.5,
        max_radius: float | None = None,
        kernel: Kernel = "box",
        positive_exponent: float | Scalar = 40.0,
        negative_exponent: float | Scalar = 5.0,
        least_variance: float | Scalar = 1e-6,
        light_bleeding: float | Scalar = 0.0,
    ):
        self.radius = as_float(radius)
        self.max_radius = radius_limit(radius, max_radius)
        self.kernel = kernel
        self.positive_exponent = as_float(positive_exponent)
        self.negative_exponent = as_float(negative_exponent)
        self.least_variance = as_float(least_variance)
        self.light_bleeding = as_float(light_bleeding)

    def __check_init__(self):
        check_radius(_NAME, self.radius, self.max_radius)
        check_kernel(_NAME, self.kernel)
        check_number(_NAME, "positive_exponent", self.positive_exponent, 1e-3, _MAX_EXPONENT)
        check_number(_NAME, "negative_exponent", self.negative_exponent, 1e-3, _MAX_EXPONENT)
        check_number(_NAME, "least_variance", self.least_variance, 1e-12, 1.0)
        check_number(_NAME, "light_bleeding", self.light_bleeding, 0.0, MAX_BLEEDING)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        blur = Blur(self.radius, self.max_radius, self.kernel)
        exponents = (self.positive_exponent, -self.negative_exponent)

        def warped(z):
            upper, lower = (jnp.exp(c * (2 * z - 1)) for c in exponents)
            return upper, upper * upper, lower, lower * lower

        moments = blurred_moments(shadow_map, lookup, warped, blur)
        receiver = 2 * linear_depth(shadow_map, lookup.depth) - 1
        upper, lower = (
            self._bound(c, mean, square, receiver)
            for c, mean, square in zip(exponents, moments[::2], moments[1::2], strict=True)
        )
        return reduce_light_bleeding(jnp.minimum(upper, lower), self.light_bleeding)

    def _bound(self, exponent: Scalar, mean: DepthMap, square: DepthMap, receiver: DepthMap) -> Visibility:
        """Chebyshev's bound for the warp with this exponent, in units of the receiver's own warped depth."""
        relative = lambda moment, power: jnp.exp(
            jnp.minimum(jnp.log(moment) - power * exponent * receiver, _MAX_LOG_MOMENT)
        )
        mean, square = relative(mean, 1), relative(square, 2)
        # The warp of w = 2z - 1 has the slope 2c times itself.
        least = 4 * exponent * exponent * self.least_variance
        variance = jnp.maximum(square - mean * mean, least)
        sign = jnp.sign(exponent)
        return chebyshev(sign * mean, variance, sign * jnp.ones_like(mean))
