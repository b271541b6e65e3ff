"""Exponential shadow maps (Annen et al., "Exponential Shadow Maps", Graphics Interface 2008)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_number
from ..._types import AsScalar, DepthMap, Visibility
from ...settings.filters import ExponentialShadowMap as Settings
from .._shader import Constant, ShaderPart, number
from ._prefilter import AbstractPrefiltered


class ExponentialShadowMap(AbstractPrefiltered):
    """Visibility is min(1, exp(k (z_m - z_r))): the factor exp(k z_m) is stored in the map and blurred.

    It is correct if no depth around a receiver is greater than the receiver's, for example on a planar receiver.
    Otherwise, a few deeper texels under the blur are enough to light it.

    - `radius`: radius of the blur, in texels.
    - `max_radius`: upper bound on `radius`, in texels. Defaults to `radius`, or to 8 if `radius` is traced; rounded up
        to a half texel.
    - `kernel`: kernel of the blur; all shapes end at the radius.
    - `exponent`: k, for linear depth from 0 at the light's near plane to 1 at its far plane. Light leaks to about 1 / k
        behind an occluder.
    - `light_bleeding`: visibility up to this value becomes 0, and the rest is stretched.
    """

    settings: ClassVar = Settings

    exponent: AsScalar = eqx.field(converter=as_number, default=Settings.exponent, kw_only=True)

    def moments(self, depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        # Relative to the far plane, so that exponentials neither overflow nor underflow.
        return (jnp.exp(self.exponent * (depth - 1)),)

    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        (stored,) = moments
        return jnp.exp(jnp.minimum(jnp.log(stored) + self.exponent * (1 - receiver), 0))

    def shader(self) -> ShaderPart:
        exponent = Constant("EXPONENT", number(self.exponent), "per linear depth")
        return self.shader_of(exponent, files=("filters/_exponential.glsl",))
