"""Four bilinear taps."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..._arithmetic import as_number
from ..._types import AsScalar, Visibility
from ...settings.filters import FourTap as Settings
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import Constant, ShaderPart, number, text_of
from ..kernels import mean_of_taps
from ..patterns import Pattern
from ._abstract import AbstractFilter


class FourTap(AbstractFilter):
    """The mean of four bilinear compares at the corners (±radius, ±radius), `radius` in texels: 16 texels in all."""

    settings: ClassVar = Settings

    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        corners = Pattern(jnp.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])[:, None, None])
        return mean_of_taps(shadow_map, lookup, compare, self.radius, corners, "bilinear")

    def shader(self) -> ShaderPart:
        radius = Constant("RADIUS", number(self.radius), "of the corners along each axis, in texels")
        return ShaderPart((radius,), text_of("kernels/_taps.glsl", "filters/_four_tap.glsl"))
