"""Variance shadow maps (Donnelly & Lauritzen, "Variance Shadow Maps", I3D 2006)."""

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
    chebyshev,
    check_kernel,
    check_number,
    check_radius,
    linear_depth,
    radius_limit,
    reduce_light_bleeding,
)

_NAME = "variance shadow map"


class VarianceShadowMap(AbstractFilter):
    """The map holds depth and its square, blurred; Chebyshev's inequality bounds visibility from above.

    The bound is exact for one planar occluder over a planar receiver. Where occluders overlap, light bleeds into their
    shadows. The compare is not asked, for visibility is smooth already; a bias moves the receiver as ever, but that it
    follows the receiver's plane has no effect.

    - `radius`: of the blur, in texels.
    - `max_radius`: the largest radius that can be asked for, in texels. It defaults to `radius`, and is
        rounded up to a half texel.
    - `kernel`: of the blur; all shapes end at the radius.
    - `least_variance`: floor on the variance of linear depth, which runs from 0 at the light's near plane to 1 at its
        far plane; more than 0. It hides rounding and acne, and blurs contacts.
    - `light_bleeding`: visibility up to this becomes 0 and the rest is stretched; in [0, 0.99].

    **Raises** `ValueError` if a number is out of its range, or `kernel` is unknown.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Kernel = eqx.field(static=True)
    least_variance: Scalar
    light_bleeding: Scalar

    def __init__(
        self,
        radius: float | Scalar = 2.5,
        max_radius: float | None = None,
        kernel: Kernel = "box",
        least_variance: float | Scalar = 1e-6,
        light_bleeding: float | Scalar = 0.0,
    ):
        self.radius = as_float(radius)
        self.max_radius = radius_limit(radius, max_radius)
        self.kernel = kernel
        self.least_variance = as_float(least_variance)
        self.light_bleeding = as_float(light_bleeding)

    def __check_init__(self):
        check_radius(_NAME, self.radius, self.max_radius)
        check_kernel(_NAME, self.kernel)
        check_number(_NAME, "least_variance", self.least_variance, 1e-12, 1.0)
        check_number(_NAME, "light_bleeding", self.light_bleeding, 0.0, MAX_BLEEDING)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        blur = Blur(self.radius, self.max_radius, self.kernel)
        # About the middle of the range, squares lose the fewest digits.
        centred = lambda z: (z - 0.5, (z - 0.5) ** 2)
        mean, square = blurred_moments(shadow_map, lookup, centred, blur)
        variance = jnp.maximum(square - mean * mean, self.least_variance)
        bound = chebyshev(mean, variance, linear_depth(shadow_map, lookup.depth) - 0.5)
        return reduce_light_bleeding(bound, self.light_bleeding)
