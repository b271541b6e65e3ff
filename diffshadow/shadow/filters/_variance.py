"""Variance shadow maps (Donnelly & Lauritzen, "Variance Shadow Maps", I3D 2006)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_number
from ..._types import AsScalar, DepthMap, Visibility
from ...settings.filters import VarianceShadowMap as Settings
from .._shader import Constant, ShaderPart, number
from ._prefilter import AbstractPrefiltered, chebyshev


class VarianceShadowMap(AbstractPrefiltered):
    """The map stores depth and its square, blurred. Chebyshev's inequality bounds visibility from above. The bound is
    exact for one planar occluder over a planar receiver. If occluders overlap, light bleeds into their shadows.

    - `radius`: radius of the blur, in texels.
    - `max_radius`: upper bound on `radius`, in texels. Defaults to `radius`, or to 8 if `radius` is traced; rounded up
        to a half texel.
    - `kernel`: kernel of the blur; all shapes end at the radius.
    - `least_variance`: lower bound on the variance of linear depth, which runs from 0 at the light's near plane to 1 at
        its far plane. It hides rounding errors and acne, and blurs contact shadows.
    - `light_bleeding`: visibility up to this value becomes 0, and the rest is stretched.
    """

    settings: ClassVar = Settings

    least_variance: AsScalar = eqx.field(converter=as_number, default=Settings.least_variance, kw_only=True)

    def moments(self, depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        # Relative to the middle of the range, where squares lose the fewest digits.
        return depth - 0.5, (depth - 0.5) ** 2

    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        mean, square = moments
        return chebyshev(mean, jnp.maximum(square - mean * mean, self.least_variance), receiver - 0.5)

    def shader(self) -> ShaderPart:
        least = Constant("LEAST_VARIANCE", number(self.least_variance), "of linear depth")
        return self.shader_of(least, files=("filters/_chebyshev.glsl", "filters/_variance.glsl"))
