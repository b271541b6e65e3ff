"""Pre-filtering: blurs the shadow map once, instead of filtering compares for each receiver.

Depths cannot be blurred before the compare; the moments that a pre-filtered map stores can. The blur is separable. Each
texel is weighted by the integral of the kernel over it, so the blur grows smoothly with its radius. Everything beyond
the border counts as depth 1, which is lit, and shadows near the border are blurred across it.
"""

import abc
import math
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..._misc import as_float, concrete, sums_along, take
from ..._types import DepthMap, Resolution, Scalar, TexelMap, Visibility
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from ..kernels import INTEGRALS, Shape, weight_between
from ._abstract import AbstractFilter

# Upper bound on the reduction of light bleeding.
_MAX_BLEEDING = 0.99


def radius_limit(radius: float | Scalar, max_radius: float | None) -> float:
    """Upper bound on a kernel's radius, rounded up to half texels; `radius` itself if `max_radius` is left out."""
    return max(1.0, math.ceil(2 * float(radius) if max_radius is None else 2 * max_radius) / 2)


def check_radius(name: str, radius: Scalar, max_radius: float) -> None:
    """**Raises** `ValueError` if `radius` is known and negative or above `max_radius`."""
    known = concrete(radius)
    if known is not None and not 0 <= known <= max_radius:
        raise ValueError(
            f"the {name}'s radius is {known} texels; expected 0 to max_radius = {max_radius:g}: give a larger "
            "max_radius"
        )


def check_kernel(name: str, kernel: str) -> None:
    """**Raises** `ValueError` for an unknown kernel."""
    if kernel not in INTEGRALS:
        raise ValueError(f"the {name}'s kernel is {kernel!r}; expected one of {', '.join(INTEGRALS)}")


def check_number(name: str, what: str, value: Scalar, low: float, high: float) -> None:
    """**Raises** `ValueError` if `value` is known and outside [`low`, `high`]."""
    known = concrete(value)
    if known is not None and not low <= known <= high:
        raise ValueError(f"the {name}'s {what} is {known}; expected {low:g} to {high:g}")


class Blur(eqx.Module):
    """A separable blur of a map.

    - `radius`: in texels, clamped to `max_radius`. Up to half a texel, nothing is blurred.
    - `max_radius`: upper bound on `radius`.
    - `kernel`: its shape.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Shape = eqx.field(static=True)

    @property
    def reach(self) -> int:
        """How many texels on each side of a texel the blur reads."""
        return math.ceil(self.max_radius - 0.5)

    @property
    def margin(self) -> int:
        """How many texels a blurred map is wider on each side than the map. Its outermost texels hold the value beyond
        the border."""
        return self.reach + 1

    @property
    def weights(self) -> Float[Array, " k"]:
        """The weights of the texels in a row; the middle one is at the kernel's centre."""
        offset = jnp.arange(-self.reach, self.reach + 1, dtype=self.radius.dtype)
        return weight_between(self.kernel, jnp.minimum(self.radius, self.max_radius), offset - 0.5, offset + 0.5)

    def __call__(self, values: Float[Array, "*n h w"], beyond: Scalar) -> Float[Array, "*n H W"]:
        """`values` blurred, `margin` texels wider on each side; `beyond` is the value outside the border."""
        around = [(0, 0)] * (values.ndim - 2) + [(self.reach + self.margin,) * 2] * 2
        wide = jnp.pad(values, around, constant_values=beyond)
        weights = self.weights
        return sums_along(sums_along(wide, weights, values.ndim - 1), weights, values.ndim - 2)


def linear_depth(shadow_map: ShadowMap, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Window `depth` as distance along the light's axis, from 0 at the near plane to 1 at the far plane, clamped."""
    view = shadow_map.view
    # Depths out of range can lie behind the eye. Rounding may keep the empty far plane from being exactly 1.
    inside = (depth >= 0) & (depth < 1)
    fraction = (view.eye_depth(jnp.where(inside, depth, 0.5)) - view.near) / (view.far - view.near)
    return jnp.where(inside, jnp.clip(fraction, 0, 1), jnp.where(depth < 0, 0.0, 1.0))


def bilinear_fetch(
    resolution: Resolution, texel: TexelMap, layer: Int[Array, "h w"] | None, margin: int
) -> Callable[[Float[Array, "*l H W"]], DepthMap]:
    """A function that fetches at `texel` (h, w, 2) from maps `margin` texels wider on each side; clamps to the edge."""
    height, width = (size + 2 * margin for size in resolution)

    def split(position: Array, size: int) -> tuple[Array, Array]:
        """The texel to the left of `position`, and the weight of the one to the right."""
        # The margin's outermost texels hold the border's value, so look-ups may be clamped to them.
        position = jnp.clip(position - 0.5 + margin, 0, size - 1)
        left = jnp.minimum(jnp.floor(lax.stop_gradient(position)), size - 2)
        return left.astype(jnp.int32), position - left

    column, right = split(texel[..., 0], width)
    row, above = split(texel[..., 1], height)
    first = row * width + column
    if layer is not None:
        first = first + layer * (height * width)

    def fetch(blurred: Float[Array, "*l H W"]) -> DepthMap:
        row_of_memory = blurred.reshape(-1)
        at = lambda skip: take(row_of_memory, first + skip)
        lower = at(0) * (1 - right) + at(1) * right
        upper = at(width) * (1 - right) + at(width + 1) * right
        return lower * (1 - above) + upper * above

    return fetch


def chebyshev(mean: DepthMap, variance: DepthMap, receiver: DepthMap) -> Visibility:
    """Chebyshev's one-tailed bound: how much of a distribution with this mean and variance is at `receiver` or beyond.

    `variance` must be positive.
    """
    # p = σ² / (σ² + (z - μ)²) where z > μ, else 1
    behind = jnp.maximum(receiver - mean, 0)
    return variance / (variance + behind * behind)


def reduce_light_bleeding(visibility: Visibility, amount: Scalar) -> Visibility:
    """Visibility up to `amount` becomes 0, and the rest is stretched (Lauritzen, GPU Gems 3, ch. 8).

    A loose bound leaves light in shadows; this removes it, and narrows penumbrae.
    """
    return jnp.clip((visibility - amount) / (1 - amount), 0, 1)


class AbstractPrefiltered(AbstractFilter):
    """A filter that blurs moments of the map's depth, and computes from them a bound on each receiver's visibility.

    Depths are linear here, from 0 at the light's near plane to 1 at its far plane. Blurred maps are fetched
    bilinearly. `compare` is ignored: the bound is already smooth. A bias moves the receiver, but a receiver plane depth
    bias has no effect.

    - `radius`, `max_radius`, `kernel`: as in `Blur`. `max_radius` defaults to `radius`, and is rounded up to a half
        texel.
    - `light_bleeding`: as in `reduce_light_bleeding`, in [0, 0.99].

    Subclasses set `name`, for messages, and `ranges`, the closed intervals of the numbers that they add.
    """

    name: ClassVar[str]
    ranges: ClassVar[dict[str, tuple[float, float]]]

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Shape = eqx.field(static=True)
    light_bleeding: Scalar

    def __init__(self, radius: float | Scalar, max_radius: float | None, kernel: Shape, light_bleeding: float | Scalar):
        self.radius = as_float(radius)
        self.max_radius = radius_limit(radius, max_radius)
        self.kernel = kernel
        self.light_bleeding = as_float(light_bleeding)

    def __check_init__(self):
        check_radius(self.name, self.radius, self.max_radius)
        check_kernel(self.name, self.kernel)
        for what, (low, high) in (self.ranges | {"light_bleeding": (0.0, _MAX_BLEEDING)}).items():
            check_number(self.name, what, getattr(self, what), low, high)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        blur = Blur(self.radius, self.max_radius, self.kernel)
        moments_at = lambda depth: self.moments(linear_depth(shadow_map, depth))
        found = shadow_map.silhouettes
        of_map = moments_at(shadow_map.depth) if found is None else found.mean_of(moments_at, shadow_map.depth)
        of_nothing = self.moments(jnp.ones((), of_map[0].dtype))
        fetch = bilinear_fetch(shadow_map.resolution, lookup.texel, lookup.layer, blur.margin)
        moments = tuple(fetch(blur(values, beyond)) for values, beyond in zip(of_map, of_nothing, strict=True))
        bound = self.bound(moments, linear_depth(shadow_map, lookup.depth))
        return reduce_light_bleeding(bound, self.light_bleeding)

    @abc.abstractmethod
    def moments(self, depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        """The moments of a depth, which the blurred maps hold."""

    @abc.abstractmethod
    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        """Upper bound on the visibility of `receiver`, given the blurred `moments`."""
