"""Exponential shadow maps (Annen et al., "Exponential Shadow Maps", Graphics Interface 2008)."""

import equinox as eqx
import jax.numpy as jnp

from ..._misc import as_float
from ..._types import Scalar, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ._abstract import AbstractFilter
from ._prefilter import (
    MAX_BLEEDING,
    Blur,
    Kernel,
    blurred_moments,
    check_kernel,
    check_number,
    check_radius,
    linear_depth,
    radius_limit,
    reduce_light_bleeding,
)

_NAME = "exponential shadow map"
# e^-80 is still a normal number in 32 bits; e^-88 is not.
_MAX_EXPONENT = 80.0


class ExponentialShadowMap(AbstractFilter):
    """Visibility is min(1, exp(k (z_m - z_r))), whose factor of the map's depth is blurred apart from the receiver's.

    It is right where no depth round a receiver is greater than its own, as on a planar receiver; elsewhere, the blur's
    few deep texels light it. The compare is not asked, for visibility is smooth already; a bias moves the receiver as
    ever, but that it follows the receiver's plane has no effect.

    - `radius`: of the blur, in texels.
    - `max_radius`: the largest radius that can be asked for, in texels. It defaults to `radius`, and is
        rounded up to a half texel.
    - `kernel`: of the blur; all shapes end at the radius.
    - `exponent`: k, for linear depth that runs from 0 at the light's near plane to 1 at its far plane; in [0, 80].
        Light reaches about 1 / k behind an occluder.
    - `light_bleeding`: visibility up to this becomes 0 and the rest is stretched; in [0, 0.99].

    **Raises** `ValueError` if a number is out of its range, or `kernel` is unknown.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Kernel = eqx.field(static=True)
    exponent: Scalar
    light_bleeding: Scalar

    def __init__(
        self,
        radius: float | Scalar = 2.5,
        max_radius: float | None = None,
        kernel: Kernel = "box",
        exponent: float | Scalar = 80.0,
        light_bleeding: float | Scalar = 0.0,
    ):
        self.radius = as_float(radius)
        self.max_radius = radius_limit(radius, max_radius)
        self.kernel = kernel
        self.exponent = as_float(exponent)
        self.light_bleeding = as_float(light_bleeding)

    def __check_init__(self):
        check_radius(_NAME, self.radius, self.max_radius)
        check_kernel(_NAME, self.kernel)
        check_number(_NAME, "exponent", self.exponent, 0.0, _MAX_EXPONENT)
        check_number(_NAME, "light_bleeding", self.light_bleeding, 0.0, MAX_BLEEDING)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        blur = Blur(self.radius, self.max_radius, self.kernel)
        # Relative to the far plane, exponentials neither overflow nor vanish.
        below_far = lambda z: (jnp.exp(self.exponent * (z - 1)),)
        (stored,) = blurred_moments(shadow_map, lookup, below_far, blur)
        excess = jnp.log(stored) + self.exponent * (1 - linear_depth(shadow_map, lookup.depth))
        return reduce_light_bleeding(jnp.exp(jnp.minimum(excess, 0)), self.light_bleeding)
