"""Moment shadow maps (Peters & Klein, "Moment Shadow Mapping", I3D 2015)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_number, safe_divide, safe_sqrt
from ..._types import AsScalar, DepthMap, Visibility
from ...settings.filters import MomentShadowMap as Settings
from .._shader import Constant, ShaderPart, number
from ._prefilter import AbstractPrefiltered

# Moments of the weights 3/16, 5/8 and 3/16 at -1, 0 and 1: far from the moments of any two depths.
_WELL_CONDITIONED = (0.0, 0.375, 0.0, 0.375)
# Rounding error in float32 of a variance that is 0.
_ROUNDING = 1e-7
# If the leading coefficient of a quadratic is smaller than this, one of its roots counts as infinite.
_ALMOST_LINEAR = 1e-6


class MomentShadowMap(AbstractPrefiltered):
    """The map stores the first four powers of depth, blurred. Visibility is the maximum over all distributions of
    depths with these moments (Hamburger moment problem).

    The bound is exact for two depths in addition to the receiver's own, so light bleeds only with three occluders or
    more.

    - `radius`: radius of the blur, in texels.
    - `max_radius`: upper bound on `radius`, in texels. Defaults to `radius`, or to 8 if `radius` is traced; rounded up
        to a half texel.
    - `kernel`: kernel of the blur; all shapes end at the radius.
    - `moment_bias`: weight with which moments are blended towards a broad distribution's moments, against rounding. A
      larger weight bleeds more light.
    - `light_bleeding`: visibility up to this value becomes 0, and the rest is stretched. The authors recommend 0.02,
      which compensates the moment bias.
    """

    settings: ClassVar = Settings

    moment_bias: AsScalar = eqx.field(converter=as_number, default=Settings.moment_bias, kw_only=True)

    def moments(self, depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        w = 2 * depth - 1
        return w, w * w, w * w * w, w * w * w * w

    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        biased = tuple(
            b + self.moment_bias * (target - b) for b, target in zip(moments, _WELL_CONDITIONED, strict=True)
        )
        return jnp.clip(1 - _least_shadow(biased, 2 * receiver - 1), 0, 1)

    def shader(self) -> ShaderPart:
        constants = (
            Constant("MOMENT_BIAS", number(self.moment_bias), "weight of a broad distribution's moments"),
            Constant("ROUNDING", _ROUNDING, "of a variance that is 0"),
            Constant("ALMOST_LINEAR", _ALMOST_LINEAR, "least leading coefficient of a quadratic"),
        )
        return self.shader_of(*constants, files=("filters/_moments.glsl",))


def _least_shadow(b: tuple[DepthMap, ...], z: DepthMap) -> Visibility:
    """The minimum mass below `z` of all distributions with the moments `b` (algorithm 3 of the paper).

    The distribution with masses at z and two more depths attains the minimum. These depths are the roots of c₁ + c₂ x +
    c₃ x², where B c = (1, z, z²) and B is the Hankel matrix of the moments.
    """
    c1, c2, c3, largest = _solve_hankel(b, z)
    low, high = _roots(c1, c2, c3)
    # The masses at low, z and high add up to 1 and have the mean b₁.
    at_z = 1 / largest
    at_low = (high * (1 - at_z) - b[0] + z * at_z) / (high - low)
    return jnp.where(z < low, 0, jnp.where(z > high, 1 - at_z, at_low))


def _solve_hankel(b: tuple[DepthMap, ...], z: DepthMap) -> tuple[DepthMap, ...]:
    """Solves B c = (1, z, z²) by Cholesky, B = L D Lᵀ. Returns c and (1, z, z²) · c."""
    b1, b2, b3, b4 = b
    d22 = jnp.maximum(b2 - b1 * b1, _ROUNDING)
    l32_d22 = b3 - b1 * b2
    l32 = l32_d22 / d22
    d33 = jnp.maximum(b4 - b2 * b2 - l32 * l32_d22, _ROUNDING)
    # Solve L y = (1, z, z²), then Lᵀ c = D⁻¹ y.
    y2 = z - b1
    y3 = z * z - b2 - l32 * y2
    c3 = y3 / d33
    c2 = y2 / d22 - l32 * c3
    return 1 - c2 * b1 - c3 * b2, c2, c3, 1 + y2 * y2 / d22 + y3 * y3 / d33


def _roots(c1: DepthMap, c2: DepthMap, c3: DepthMap) -> tuple[DepthMap, DepthMap]:
    """Both roots of c₁ + c₂ x + c₃ x², which are real. The smaller root comes first."""
    # A root at infinity has no mass on either side.
    c3 = jnp.where(jnp.abs(c3) < _ALMOST_LINEAR, _ALMOST_LINEAR, c3)
    root = safe_sqrt(c2 * c2 - 4 * c1 * c3)
    # Adding terms of the same sign avoids cancellation. The other root follows from the product c₁ / c₃.
    q = -(c2 + jnp.where(c2 < 0, -root, root)) / 2
    one, other = q / c3, safe_divide(c1, q)
    # Keeps the roots distinct despite rounding.
    low = jnp.minimum(one, other)
    return low, jnp.maximum(jnp.maximum(one, other), low + _ROUNDING)
