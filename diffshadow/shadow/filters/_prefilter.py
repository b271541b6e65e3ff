"""Pre-filtering: blurs the shadow map once, instead of filtering compares for each receiver.

Depths cannot be blurred before the compare. Moments, which a pre-filtered map stores, can. Everything beyond the border
counts as depth 1, which is lit. Shadows near the border are blurred across it.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_number
from ..._types import AsScalar, DepthMap, Scalar, Visibility
from ...settings.filters import Prefiltered as Settings
from ...settings.filters import Shape
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import Constant, ShaderPart, number, numbers, text_of
from ..kernels import Blur, bilinear_fetch, check_radius, limit_radius
from ._abstract import AbstractFilter


def linear_depth(shadow_map: ShadowMap, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Window `depth` as distance along the light's axis, from 0 at the near plane to 1 at the far plane, clamped."""
    view = shadow_map.view
    # Depths out of range can be behind the eye. Rounding may keep the empty far plane from being exactly 1.
    inside = (depth >= 0) & (depth < 1)
    fraction = (view.eye_depth(jnp.where(inside, depth, 0.5)) - view.near) / (view.far - view.near)
    return jnp.where(inside, jnp.clip(fraction, 0, 1), jnp.where(depth < 0, 0.0, 1.0))


def chebyshev(mean: DepthMap, variance: DepthMap, receiver: DepthMap) -> Visibility:
    """Chebyshev's one-tailed bound on the fraction of a distribution with this mean and variance that is at `receiver`
    or beyond.

    `variance` must be positive.
    """
    # p = σ² / (σ² + (z - μ)²) where z > μ, else 1
    behind = jnp.maximum(receiver - mean, 0)
    return variance / (variance + behind * behind)


def reduce_light_bleeding(visibility: Visibility, amount: Scalar) -> Visibility:
    """Visibility up to `amount` becomes 0, and the rest is stretched (Lauritzen, GPU Gems 3, ch. 8).

    A loose bound leaves light in shadows. This removes the light, and narrows penumbrae.
    """
    return jnp.clip((visibility - amount) / (1 - amount), 0, 1)


class AbstractPrefiltered(AbstractFilter):
    """A filter that blurs moments of the map's depth. A bound on each receiver's visibility follows from the moments.
    Depths are linear here, from 0 at the light's near plane to 1 at its far plane. Blurred maps are fetched bilinearly.
    `compare` is ignored, because the bound is already smooth. A bias moves the receiver, but a receiver plane depth
    bias has no effect.

    - `radius`, `max_radius`, `kernel`: as in `Blur`. `max_radius` defaults to `radius`, or to 8 if `radius` is traced,
        and is rounded up to a half texel.
    - `light_bleeding`: as in `reduce_light_bleeding`.
    """

    settings: ClassVar = Settings

    radius: AsScalar = eqx.field(converter=as_number, default=Settings.radius)
    max_radius: float | Any = eqx.field(static=True, default=None)
    kernel: Shape = eqx.field(static=True, default=Settings.kernel)
    light_bleeding: AsScalar = eqx.field(converter=as_number, default=Settings.light_bleeding, kw_only=True)

    def __post_init__(self):
        limit_radius(self)

    def _check_rules(self):
        check_radius(self)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        blur = self._blur
        moments_at = lambda depth: self.moments(linear_depth(shadow_map, depth))
        found = shadow_map.silhouettes
        of_map = moments_at(shadow_map.depth) if found is None else found.mean_of(moments_at, shadow_map.depth)
        of_nothing = self.moments(jnp.ones((), of_map[0].dtype))
        fetch = bilinear_fetch(shadow_map.resolution, lookup.texel, lookup.layer, blur.margin)
        moments = tuple(fetch(blur(values, beyond)) for values, beyond in zip(of_map, of_nothing, strict=True))
        bound = self.bound(moments, linear_depth(shadow_map, lookup.depth))
        return reduce_light_bleeding(bound, self.light_bleeding)

    def shader_of(self, *constants: Constant, files: tuple[str, ...]) -> ShaderPart:
        """The shader's part with these constants. Its functions `shadow_moments` and `shadow_bound` are in `files` of
        `shadow`. It reads the texture `moments`, which the functions `shadow_blur_rows` and `shadow_blur_columns`
        draw."""
        blur = self._blur
        each = (
            Constant("LIGHT_BLEEDING", number(self.light_bleeding), "visibility up to which receivers are dark"),
            Constant("BLUR_MARGIN", blur.margin, "how many texels moments are wider than the map on each side"),
            Constant("BLUR_TEXELS", 2 * blur.reach + 1, "along a row or a column, that a blur reads"),
            Constant("BLUR", numbers(blur.weights), "their weights"),
        )
        text = text_of("filters/_distance.glsl", *files, "filters/_prefilter.glsl")
        return ShaderPart((*each, *constants), text, ("moments",))

    @property
    def _blur(self) -> Blur:
        return Blur(self.radius, self.max_radius, self.kernel)

    @abc.abstractmethod
    def moments(self, depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        """The moments of a depth, which the blurred maps store."""

    @abc.abstractmethod
    def bound(self, moments: tuple[DepthMap, ...], receiver: DepthMap) -> Visibility:
        """Upper bound on the visibility of `receiver`, given the blurred `moments`."""
