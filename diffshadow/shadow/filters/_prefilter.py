"""Pre-filtering: blurring what a shadow map holds once, instead of filtering compares for each receiver.

Depths cannot be blurred and then compared; what a pre-filtered map stores instead, such as moments of depth, can. A
blur is separable, and a texel counts in it by the integral of the kernel over that texel, so that it grows smoothly
with its radius. Everything beyond the border counts as depth 1, which is lit, and shadows near the border are blurred
across it.
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

# The largest amount by which light bleeding can be reduced.
_MAX_BLEEDING = 0.99


def radius_limit(radius: float | Scalar, max_radius: float | None) -> float:
    """The largest radius that a kernel can have, rounded up to half texels: `radius` itself, unless given."""
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

    - `radius`: in texels; more than `max_radius` counts as that. Up to half a texel, the map stays as it is.
    - `max_radius`: the largest radius.
    - `kernel`: its shape.
    """

    radius: Scalar
    max_radius: float = eqx.field(static=True)
    kernel: Shape = eqx.field(static=True)

    @property
    def reach(self) -> int:
        """How many texels on each side of one the blur draws from."""
        return math.ceil(self.max_radius - 0.5)

    @property
    def margin(self) -> int:
        """How many texels a blurred map is wider than the map, on each side: beyond, it holds what lies round it."""
        return self.reach + 1

    @property
    def weights(self) -> Float[Array, " k"]:
        """The weights of the texels in a row, the middle one at the kernel's centre."""
        offset = jnp.arange(-self.reach, self.reach + 1, dtype=self.radius.dtype)
        return weight_between(self.kernel, jnp.minimum(self.radius, self.max_radius), offset - 0.5, offset + 0.5)

    def __call__(self, values: Float[Array, "*n h w"], beyond: Scalar) -> Float[Array, "*n H W"]:
        """`values` blurred, `margin` texels wider on each side; `beyond` is what lies round them."""
        around = [(0, 0)] * (values.ndim - 2) + [(self.reach + self.margin,) * 2] * 2
        wide = jnp.pad(values, around, constant_values=beyond)
        weights = self.weights
        return sums_along(sums_along(wide, weights, values.ndim - 1), weights, values.ndim - 2)


def linear_depth(shadow_map: ShadowMap, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Distance along the light's axis as a share of the way from near to far, in [0, 1], of window `depth`."""
    view = shadow_map.view
    # Depths out of range can lie behind the eye. Rounding may part the far plane, where nothing is, from 1.
    inside = (depth >= 0) & (depth < 1)
    share = (view.eye_depth(jnp.where(inside, depth, 0.5)) - view.near) / (view.far - view.near)
    return jnp.where(inside, jnp.clip(share, 0, 1), jnp.where(depth < 0, 0.0, 1.0))


def bilinear_fetch(
    resolution: Resolution, texel: TexelMap, layer: Int[Array, "h w"] | None, margin: int
) -> Callable[[Float[Array, "*l H W"]], DepthMap]:
    """Fetches at `texel` (h, w, 2) from maps that are `margin` texels wider on each side, clamped to what is there."""
    height, width = (size + 2 * margin for size in resolution)

    def split(position: Array, size: int) -> tuple[Array, Array]:
        """The texel to the left of `position`, and the share of the one to the right."""
        # The margin's outermost texels hold what lies beyond, so look-ups may be clamped to them.
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
    """Chebyshev's one-tailed bound: the most that can lie at `receiver` or beyond, of what has this mean and variance.

    `variance` must be positive.
    """
    # p = σ² / (σ² + (z - μ)²) where z > μ, else 1
    behind = jnp.maximum(receiver - mean, 0)
    return variance / (variance + behind * behind)


def reduce_light_bleeding(visibility: Visibility, amount: Scalar) -> Visibility:
    """Visibility up to `amount` becomes 0, and the rest is stretched (Lauritzen, GPU Gems 3, ch. 8).

    A bound that is not tight leaves light in shadows; this takes it away, and narrows penumbrae.
    """
    return jnp.clip((visibility - amount) / (1 - amount), 0, 1)


class AbstractPrefiltered(AbstractFilter):
    """A filter that blurs moments of the map's depth, and bounds the visibility of each receiver by them.

    Depths are linear here, from 0 at the light's near plane to 1 at its far plane. A fetch from the blurred maps is
    bilinear. `compare` is ignored: the bound is already smooth. A bias moves the receiver, but following the receiver's
    plane has no effect.

    - `radius`, `max_radius`, `kernel`: as in `Blur`. `max_radius` defaults to `radius`, and is rounded up to a half
        texel.
    - `light_bleeding`: as in `reduce_light_bleeding`, in [0, 0.99].

    A technique has its `name` for messages, and the `ranges`, both ends included, of the numbers that it adds.
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
        """What the blurred maps hold of a depth."""

    @abc.abstractmethod
    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        """The most light that depths with these `moments` let through to `receiver`."""
