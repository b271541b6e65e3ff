"""Bias: what keeps a surface from shadowing itself.

A texel stores one depth for a patch of surface, so a slanted receiver lies partly behind its own depth: acne. Every
bias here is measured in texels, the width of a shadow-map texel at the receiver, which is the natural unit of that
error: the same numbers serve at any scale, distance and map resolution.
"""

import abc
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._misc import as_float
from .._types import Scalar, VectorMap
from ._receiver import Receiver

# Steeper than this (89.4°) the slope of a receiver is taken as this: grazing light would ask for an infinite bias.
_MAX_TANGENT = 100.0

Profile = Literal["sine", "constant", "one_minus_cosine"]


class BiasTerms(eqx.Module):
    """What a bias does to a look-up; the terms of several add up.

    - `displacement`: (h, w, 3), how far the point moves before it is projected, in world units.
    - `depth`: (h, w), how much nearer to the light it is taken to be, in window depth.
    """

    displacement: VectorMap
    depth: Float[Array, "h w"]

    def __add__(self, other: "BiasTerms") -> "BiasTerms":
        return BiasTerms(self.displacement + other.displacement, self.depth + other.depth)


class AbstractBias(eqx.Module):
    """A way to keep receivers clear of their own depth."""

    @abc.abstractmethod
    def __call__(self, receiver: Receiver) -> BiasTerms:
        """What the bias does at each receiver."""


class ConstantBias(AbstractBias):
    """The same everywhere. `value` is in texels along the light's axis.

    On a plane with depth slopes `g_x` and `g_y` along the map's axes, nearest look-ups need `(|g_x| + |g_y|) / 2`.
    """

    value: Scalar = eqx.field(converter=as_float)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return _depth_only(receiver, self.value * receiver.depth_per_texel)


class SlopeBias(AbstractBias):
    """In proportion to the receiver's slope, `value · tan θ`, θ between normal and light. `value` is in texels.

    Under a directional light, nearest look-ups on a plane need between 1/2 (slanted along an axis of the map) and 1/√2
    (along a diagonal). Aside from a spot light's axis the map's own slope differs from tan θ, and more may be needed.
    """

    value: Scalar = eqx.field(converter=as_float)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return _depth_only(receiver, self.value * _tangent(receiver.cosine) * receiver.depth_per_texel)


class NormalOffset(AbstractBias):
    """Looks up at a point moved out along the normal, by `value` texels times a profile of the angle θ to the light.

    - `profile`: `"sine"` sin θ, `"constant"` 1, or `"one_minus_cosine"` 1 - cos θ.
    """

    value: Scalar = eqx.field(converter=as_float)
    profile: Profile = eqx.field(static=True, default="sine")

    def __call__(self, receiver: Receiver) -> BiasTerms:
        cosine = jnp.clip(receiver.cosine, 0, 1)
        match self.profile:
            case "sine":
                profile = _sine(cosine)
            case "constant":
                profile = jnp.ones_like(cosine)
            case "one_minus_cosine":
                profile = 1 - cosine
        length = self.value * receiver.texel * profile
        return BiasTerms(receiver.normal * length[..., None], jnp.zeros_like(length))


class Bias(AbstractBias):
    """Constant bias, slope bias and normal offset together; each a number of texels, or a module of its own."""

    constant: AbstractBias
    slope: AbstractBias
    normal_offset: AbstractBias

    def __init__(self, constant: Any = 0.0, slope: Any = 0.0, normal_offset: Any = 0.0):
        self.constant = constant if isinstance(constant, AbstractBias) else ConstantBias(constant)
        self.slope = slope if isinstance(slope, AbstractBias) else SlopeBias(slope)
        self.normal_offset = normal_offset if isinstance(normal_offset, AbstractBias) else NormalOffset(normal_offset)

    def __call__(self, receiver: Receiver) -> BiasTerms:
        return self.constant(receiver) + self.slope(receiver) + self.normal_offset(receiver)


def _depth_only(receiver: Receiver, depth: Float[Array, "h w"]) -> BiasTerms:
    return BiasTerms(jnp.zeros_like(receiver.position), depth)


def _sine(cosine: Float[Array, "h w"]) -> Float[Array, "h w"]:
    squared = 1 - cosine * cosine
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def _tangent(cosine: Float[Array, "h w"]) -> Float[Array, "h w"]:
    cosine = jnp.clip(cosine, 1 / _MAX_TANGENT, 1)
    return _sine(cosine) / cosine
